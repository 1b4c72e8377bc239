"""What changes in a map while a robot drives: of what is observed, and of the graph above it."""

from typing import Final, NamedTuple

from sg3d_jax.scene.graph import SceneGraph

# What becomes of a grown node beside coming, changing and going.
SHRUNK: Final = "shrunk"  # it lost parts
SPLIT: Final = "split"  # some of its parts are those of other nodes now
MERGED: Final = "merged"  # it has the parts of nodes that are gone
EVENTS: Final = (SHRUNK, SPLIT, MERGED)


class Changes(NamedTuple):
    """What one update is told. Ids of observed nodes are the caller's, of grown ones the map's."""

    observed: SceneGraph | None = None  # host graph of observed nodes that are new, or have moved
    ids: tuple[int | str, ...] = ()  # of these, in order
    removed: tuple[int | str, ...] = ()  # observed nodes that are gone
    merged: tuple[tuple[int | str, int | str], ...] = ()  # observed: the one that is gone, its heir
    confirmed: tuple[int, ...] = ()  # grown nodes that stay as they are
    forbidden: tuple[int, ...] = ()  # grown nodes that are not, and do not come again
    think: bool = False  # whether the whole map is drawn again where nothing else is to be


class GrownNode(NamedTuple):
    """A grown node of a map, as it is after an update."""

    id: int  # never given twice
    label: int  # its concept
    position: tuple[float, float, float]  # metres
    observed: tuple[int | str, ...]  # ids of the observed nodes that are part of it, sorted as told
    parts: tuple[int, ...]  # ids of the grown nodes that are part of it, ascending
    age: int  # updates since it came
    confidence: float  # 0 to 1


class Event(NamedTuple):
    """What became of a grown node that went on."""

    kind: str  # one of EVENTS
    id: int  # of the node
    others: tuple[int, ...]  # SPLIT: of those that have its parts now; MERGED: of those it has them


class GraphChanges(NamedTuple):
    """What an update did to the graph."""

    added: tuple[GrownNode, ...]
    changed: tuple[GrownNode, ...]  # place, parts or confidence; not those that only aged
    removed: tuple[int, ...]
    events: tuple[Event, ...]
    remarks: tuple[str, ...]  # what was mended on the way in, or could not be; a sentence each
