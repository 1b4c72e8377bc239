"""As the robot drives: a map that changes with what is observed, update by update.

An update takes in what is new, has moved, or is gone; finds the region that it touches; has a model
draw that again, given what stays around it; and takes over what is due (`infer/revision`). All else
stays bit for bit, and what goes on keeps its id. What moved as one, such as by the closing of a
loop, takes along what stands above it, and nothing is drawn again.

Where nothing is touched, an update that is asked to think has the whole map drawn again, and what
is so drawn twice in a row is taken over; what is drawn as it is stands where all such draws have it
in the mean. That is for when the robot stands, or is done.

A session is a pytree and an update a pure function: the same changes give the same map, bit for
bit. Its arrays are as long as the map has nodes, on the host: ids, pieces and what goes on as what
are sets and matches of a few rows, which a padded array would make no faster. What is compiled is
the growing of a region alone, in a few buckets of fixed size, however large the map; `warm_up`
compiles them ahead.

Source: paper, Sec. "Conclusion" (real-time robotics as the next step). The rest is ours.
"""

from collections.abc import Iterator, Mapping, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple, SupportsIndex

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.grow import HALTED, Grown, grow_lanes
from sg3d_jax.flagg.step import Flagg, check_grows
from sg3d_jax.infer.arguments import check_finite, whole_number
from sg3d_jax.infer.confidence import likely
from sg3d_jax.infer.continuity import Seen, carried
from sg3d_jax.infer.devices import num_workers
from sg3d_jax.infer.intake import taken_in
from sg3d_jax.infer.lanes import as_here, root_key
from sg3d_jax.infer.placement import placed
from sg3d_jax.infer.region import Region, region_of, whole_region
from sg3d_jax.infer.revision import Map, Tracks, revised, without
from sg3d_jax.metrics.calibration import observed_below
from sg3d_jax.scene.changes import MERGED, SHRUNK, SPLIT, Changes, Event, GraphChanges, GrownNode
from sg3d_jax.scene.cut import Pieces, cut_observed, joined, of_pieces
from sg3d_jax.scene.graph import (
    SceneGraph,
    extended,
    features_of,
    make_graph,
    ontology_of,
    parts_first,
    subgraph,
)
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import (
    NODE_CAPACITIES,
    Capacity,
    bucket,
    centre_of_observed,
    moved_by,
    stack,
    unpad,
)
from sg3d_jax.scene.validate import check_observed, validate_graph

LEAST: Final = 96  # nodes of the smallest bucket that regions are grown in
SPARE: Final = 20  # nodes that may come at least
IN_ALL: Final = 1.8  # nodes of a complete graph, a node that is observed
MOST_STEPS: Final = 500  # blocks of a region

Id = int | str


class Session(NamedTuple):
    """The state of a map; `begin` gives the first."""

    observed: SceneGraph  # host graph of what is observed, as it was told
    ids: tuple[Id, ...]  # the caller's, of these
    pieces: Pieces  # what they are cut into, in rows of `observed`
    known: Map  # the pieces, and what has grown above them
    banned: tuple[tuple[int, frozenset[Id]], ...]  # label and ids of what was forbidden
    updates: int  # so far
    next_id: int  # of the next node that grows
    seed: int  # with the number of the update, fixes what is drawn
    remarks: tuple[str, ...]  # on what is observed


def begin(ontology: Ontology, seed: SupportsIndex = 0) -> Session:
    """Returns the session of an empty map.

    Args:
      ontology: the concepts, `model.ontology`.
      seed: of all that is drawn, 0 or more.

    Raises:
      ValueError: the seed is no such number.
    """
    seed = whole_number("the seed", seed, least=0)
    empty = make_graph([], np.zeros((0, 3)), ontology=ontology)
    pieces = Pieces(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0))
    number = np.zeros(0, np.int64)
    tracks = Tracks(
        *(number, number, number, number),
        astray=np.zeros((0, ontology.num_concepts), np.int64),
        firm=np.zeros(0, bool),
        due=np.zeros(0, bool),
        grew=np.zeros((0, 2)),
    )
    return Session(empty, (), pieces, Map(empty, tracks), (), 0, 0, seed, ())


def update(
    model: Flagg, params: Params, session: Session, changes: Changes
) -> tuple[Session, GraphChanges]:
    """Takes changes into a map.

    Args:
      model: grows; weights that were trained on graphs with nodes missing anywhere
        (`FlaggConfig.any_cuts`) suit best.
      params: its parameters.
      session: the map so far.
      changes: what has changed, or that the map is to be thought over.

    Returns:
      The map now, and how its graph differs from the one before.

    Raises:
      ValueError: one sentence that names the update, the id and what was expected: an id that is
        unknown or told twice, an observed node that is none; a model that does not grow, parameters
        that are none of it.
    """
    check_grows(model, params)
    number = session.updates + 1
    where = f"update {number}"
    changes = _in_plain_ids(changes, where)
    heir = dict(changes.merged)
    observed, ids = _told(session, changes, where)
    known, banned = _decided(session, changes, where)
    intake = taken_in(observed, where, may_be_few=True)
    cut = cut_observed(intake.graph)
    pieces = cut._replace(owner=intake.source[cut.owner])
    before = Seen(session.observed, session.ids, session.pieces)
    now = Seen(observed, ids, pieces)
    known = carried(known, before, now, of_pieces(intake.graph, cut), heir)
    after = Session(
        *(observed, ids, pieces, known, banned, number),
        next_id=session.next_id,
        seed=session.seed,
        remarks=intake.remarks,
    )
    remarks = [remark for remark in intake.remarks if remark not in session.remarks]
    region = _region(known, changes.think)
    if region is not None:
        drawn = _drawn(model, params, after, region)
        if drawn is None:
            remarks.append(f"{where}: what was drawn did not come to its end, and was left")
        else:
            after = _revised(after, region, drawn, {*changes.ids})
    return after, _differences(session, after, heir, remarks)


def warm_up(model: Flagg, params: Params, num_observed: int) -> None:
    """Compiles ahead, side by side, what updates of maps up to a size need.

    Args:
      model: grows.
      params: its parameters.
      num_observed: nodes that are observed at most, where one that is cut counts as its pieces.

    Raises:
      ValueError: a map of so many exceeds the largest bucket, the model does not grow, or the
        parameters are not finite.
    """
    check_grows(model, params)
    check_finite(params)
    largest = bucket(_size(int(IN_ALL * num_observed), num_observed))
    capacities = [bucket(size) for size in NODE_CAPACITIES if LEAST <= size <= largest.nodes]
    observed = np.flatnonzero(model.ontology.is_observed)[[0, 0]]
    given = make_graph(observed, np.zeros((2, 3)), ontology=model.ontology)

    def compiled(capacity: Capacity) -> None:
        _grown(model, params, (0, 0), given, capacity, MOST_STEPS)  # ends with the first block
        placed(model, params, given, 2, capacity)

    with ThreadPoolExecutor(num_workers()) as pool:
        list(pool.map(as_here(compiled), capacities))


def graph_of(session: Session) -> SceneGraph:
    """Returns the graph of a map: what is observed, bit for bit as it was told, then what grew."""
    return joined(session.known.graph, session.pieces, session.observed)


def ids_of(session: Session) -> list[Id]:
    """Returns the ids of the nodes of `graph_of`: the caller's, and such as "room-12"."""
    names, tracks = ontology_of(session.observed).names, session.known.tracks
    labels = session.known.graph.nodes.label
    grown = np.flatnonzero(tracks.id >= 0)
    return [*session.ids, *(f"{names[labels[row]]}-{tracks.id[row]}" for row in grown)]


def nodes_of(session: Session) -> dict[int, GrownNode]:
    """Returns the grown nodes of a map by their ids."""
    graph, tracks = session.known
    label, number = graph.nodes.label.tolist(), tracks.id.tolist()
    born, firm, owner = tracks.born.tolist(), tracks.firm.tolist(), session.pieces.owner.tolist()
    parts: dict[int, list[int]] = {row: [] for row, one in enumerate(number) if one >= 0}
    for part, whole in parts_first(graph).tolist():
        parts[whole].append(part)
    pairs = list(zip(tracks.held.tolist(), tracks.drawn.tolist(), strict=True))
    sure = {pair: round(float(likely([pair[0]], pair[1])[0]), 4) for pair in {*pairs}}
    nodes = {}
    for row, of_row in parts.items():
        owners = sorted({owner[part] for part in of_row if number[part] < 0})
        nodes[number[row]] = GrownNode(
            id=number[row],
            label=label[row],
            position=tuple(graph.nodes.position[row].tolist()),
            observed=tuple(session.ids[one] for one in owners),
            parts=tuple(sorted(number[part] for part in of_row if number[part] >= 0)),
            age=session.updates - born[row],
            confidence=1.0 if firm[row] else sure[pairs[row]],
        )
    return nodes


def _in_plain_ids(changes: Any, where: str) -> Changes:
    """Returns changes whose ids are Python's own numbers and strings, as JSON wants them.

    Raises:
      ValueError: they are none.
    """
    if not isinstance(changes, Changes):
        held = type(changes).__name__
        raise ValueError(f"{where}: the changes are a {held}, expected Changes of sg3d_jax.scene")

    def plain(ids: Any) -> tuple[Any, ...]:
        return tuple(one.item() if isinstance(one, np.generic) else one for one in ids)

    return changes._replace(
        ids=plain(changes.ids),
        removed=plain(changes.removed),
        merged=tuple(plain(pair) for pair in changes.merged),
        confirmed=plain(changes.confirmed),
        forbidden=plain(changes.forbidden),
    )


def _told(session: Session, changes: Changes, where: str) -> tuple[SceneGraph, tuple[Id, ...]]:
    """Returns what is observed after changes, and its ids; what has moved keeps its place."""
    _check_ids(session, changes, where)
    plural, new = ontology_of(session.observed).observed_plural, changes.observed
    gone = {*changes.removed, *(one for one, _ in changes.merged)}
    row_of = {one: row for row, one in enumerate(session.ids)}
    observed, count = session.observed, len(session.ids)
    if new is not None and len(changes.ids):
        if ontology_of(new) != ontology_of(observed) or not np.all(new.nodes.observed):
            raise ValueError(f"{where}: expected {plural} alone, of the concepts of the map")
        validate_graph(new, where, rules=False)
        observed = _together(observed, new)
        row_of |= {one: count + row for row, one in enumerate(changes.ids)}
    ids = tuple(one for one in row_of if one not in gone)
    observed = subgraph(observed, np.array([row_of[one] for one in ids], int))
    if len(ids) > 1:
        check_observed(observed, where)
    return observed, ids


def _check_ids(session: Session, changes: Changes, where: str) -> None:
    """Refuses ids that are unknown, told twice or gone twice."""
    plural = ontology_of(session.observed).observed_plural
    count = 0 if changes.observed is None else len(changes.observed.nodes.label)
    if len(changes.ids) != count:
        raise ValueError(f"{where}: {count} {plural} with {len(changes.ids)} ids, expected as many")
    gone = (*changes.removed, *(one for one, _ in changes.merged))
    for ids, said in ((changes.ids, "told"), (gone, "gone")):
        if len({*ids}) != len(ids):
            twice = next(one for one in ids if ids.count(one) > 1)
            raise ValueError(f"{where}: {twice!r} is {said} twice, expected once")
    known, told = {*session.ids}, {*changes.ids}
    for one in gone:
        if one in told:
            raise ValueError(f"{where}: {one!r} is both told and gone, expected one of it")
        if one not in known:
            raise ValueError(f"{where}: {one!r} is gone, but was not there, expected a known id")
    staying = (known | told).difference(gone)
    for one, heir in changes.merged:
        if heir not in staying:
            raise ValueError(f"{where}: {one!r} is merged into {heir!r}, expected an id that stays")


def _together(one: SceneGraph, other: SceneGraph) -> SceneGraph:
    """Returns the nodes of two host graphs, without edges."""
    both = [
        np.concatenate([np.asarray(getattr(graph.nodes, name)) for graph in (one, other)])
        for name in ("label", "position")
    ]
    features = {
        name: np.concatenate([array, np.asarray(features_of(other)[name])])
        for name, array in features_of(one).items()
    }
    return make_graph(*both, **features, ontology=ontology_of(one))


def _decided(
    session: Session, changes: Changes, where: str
) -> tuple[Map, tuple[tuple[int, frozenset[Id]], ...]]:
    """Returns the map with what its user has decided, and all that is banned."""
    graph, tracks = session.known
    label = graph.nodes.label
    row_of = {one: row for row, one in enumerate(tracks.id.tolist()) if one >= 0}
    for one in (*changes.confirmed, *changes.forbidden):
        if one not in row_of:
            raise ValueError(f"{where}: there is no grown node {one!r}, expected one of the map")
    firm, due = tracks.firm.copy(), tracks.due.copy()
    firm[[row_of[one] for one in changes.confirmed]] = True
    forbidden = [row_of[one] for one in changes.forbidden]
    heir, banned = dict(changes.merged), list(session.banned)
    for row in forbidden:
        below = np.flatnonzero(observed_below(graph)[row])  # observed nodes come first
        due[below] = True
        ids = frozenset(session.ids[owner] for owner in session.pieces.owner[below])
        banned.append((int(label[row]), ids))
    known = Map(graph, tracks._replace(firm=firm, due=due))
    return without(known, forbidden), tuple(
        (kind, frozenset(heir.get(one, one) for one in ids)) for kind, ids in banned
    )


def _region(known: Map, think: bool) -> Region | None:
    """Returns what is to be drawn again: what is due, or all if nothing happens; None for none."""
    graph, tracks = known
    if np.sum(graph.nodes.observed) < 2:
        return None
    if tracks.due.any():
        return region_of(graph, tracks.due, tracks.firm)
    return whole_region(graph, tracks.firm) if think else None


def _drawn(model: Flagg, params: Params, session: Session, region: Region) -> SceneGraph | None:
    """Returns a region with what a model grows on it; None if it does not come to an end."""
    given = subgraph(session.known.graph, region.rows)
    centre, num_given = centre_of_observed(given), len(region.rows)
    size = _size(num_given, int(given.nodes.observed.sum()))
    if size > NODE_CAPACITIES[-1]:
        return None
    numbers, capacity = (session.seed, session.updates), bucket(size)
    grown = _grown(model, params, numbers, moved_by(given, -centre), capacity)
    if grown.halt_reason != HALTED:
        return None
    drawn = unpad(grown.graph)
    pairs = parts_first(drawn)
    graph = extended(
        given,
        drawn.nodes.label[num_given:],
        np.asarray(drawn.nodes.position, np.float64)[num_given:] + centre,
        pairs[(pairs >= num_given).any(axis=1)],
    )
    return placed(model, params, graph, num_given, capacity)


def _size(num_given: int, num_observed: int) -> int:
    """Returns how many nodes a region may have once it has grown.

    Args:
      num_given: nodes that it is given.
      num_observed: those of them that are observed.
    """
    return max(LEAST, num_given + SPARE, int(IN_ALL * num_observed) + 8)


def _grown(
    model: Flagg,
    params: Params,
    numbers: tuple[int, int],
    given: SceneGraph,
    capacity: Capacity,
    steps: int = 0,
) -> Grown:
    """Grows a centred host graph; returns it padded, on the host.

    Args:
      model: grows.
      params: its parameters.
      numbers: the seed, and the number of the update.
      given: what there is.
      capacity: the bucket.
      steps: of `MOST_STEPS`, those that it has had.
    """
    seed, update = numbers
    key = jax.random.fold_in(root_key(seed), update)
    graphs, before = stack([given], capacity), jnp.full(1, steps, jnp.int32)
    grown = grow_lanes(model, params, key[None], graphs, before, MOST_STEPS, False)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], grown)


def _revised(session: Session, region: Region, drawn: SceneGraph, told: Set[int | str]) -> Session:
    """Returns a map with what it takes over of a draw; of what is told, each piece is its own."""
    owner, present = [session.ids[row] for row in session.pieces.owner], {*session.ids}
    banned = {(label, ids & present) for label, ids in session.banned}

    def is_banned(label: int, pieces: frozenset[int]) -> bool:
        return (label, frozenset(owner[row] for row in pieces)) in banned

    _, first, which = np.unique(session.pieces.owner, return_index=True, return_inverse=True)
    is_told = np.array([name in told for name in owner], bool)
    known = revised(
        *(session.known, region, drawn, session.updates, session.next_id),
        is_banned=is_banned if banned else None,
        piece_of=np.where(is_told, np.arange(len(owner)), first[which]),
    )
    next_id = max(session.next_id, 1 + int(known.tracks.id.max(initial=-1)))
    return session._replace(known=known, next_id=next_id)


def _differences(
    before: Session, after: Session, heir: Mapping[Id, Id], remarks: Sequence[str]
) -> GraphChanges:
    """Returns how the graph of a map differs from an earlier one."""
    old, new = nodes_of(before), nodes_of(after)
    both = [one for one in old if one in new]
    changed = [one for one in both if old[one]._replace(age=0) != new[one]._replace(age=0)]
    return GraphChanges(
        added=tuple(node for one, node in new.items() if one not in old),
        changed=tuple(new[one] for one in changed),
        removed=tuple(one for one in old if one not in new),
        events=tuple(_events(old, new, changed, heir)),
        remarks=tuple(remarks),
    )


def _events(
    old: Mapping[int, GrownNode],
    new: Mapping[int, GrownNode],
    changed: Sequence[int],
    heir: Mapping[Id, Id],
) -> Iterator[Event]:
    """Yields what became of nodes that went on; what was merged into a part is not lost."""

    def members(node: GrownNode) -> set[tuple[bool, Id]]:
        observed = {(True, heir.get(one, one)) for one in node.observed}
        return observed | {(False, one) for one in node.parts}

    came = [(node, members(node)) for one, node in new.items() if one not in old]
    went = [(node, members(node)) for one, node in old.items() if one not in new]
    for one in changed:
        label, was, now = new[one].label, members(old[one]), members(new[one])
        if lost := was - now:
            others = [node.id for node, held in came if node.label == label and held & lost]
            yield Event(SPLIT if others else SHRUNK, one, tuple(others))
        others = [node.id for node, held in went if node.label == label and held & (now - was)]
        if others:
            yield Event(MERGED, one, tuple(others))
