"""A stand-in for `infer.session`: a room over what is new in every update, and no model at all."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from sg3d_jax.flagg.step import Flagg
from sg3d_jax.scene.changes import SHRUNK, Changes, Event, GraphChanges, GrownNode
from sg3d_jax.scene.graph import SceneGraph, make_graph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE, ROOM

MODEL = object.__new__(Flagg)  # of which nothing but the ontology is asked for
object.__setattr__(MODEL, "fill", SimpleNamespace(ontology=PAPER_ONTOLOGY))
TRAINED = SimpleNamespace(model=MODEL, params=None)


class Session(NamedTuple):
    planes: dict[int | str, tuple[float, ...]]  # position, normal and width
    rooms: dict[int, tuple[int | str, ...]]
    born: dict[int, int]  # update in which each room came
    updates: int
    next_id: int


def begin(ontology: Any, seed: int = 0) -> Session:
    return Session({}, {}, {}, 0, seed)


WARM: list[int] = []  # sizes of maps that were compiled for


def warm_up(model: Any, params: Any, num_observed: int) -> None:
    WARM.append(num_observed)


def update(
    model: Any, params: Any, session: Session, changes: Changes
) -> tuple[Session, GraphChanges]:
    planes, rooms, born = dict(session.planes), dict(session.rooms), dict(session.born)
    gone = {*changes.removed, *(name for name, _ in changes.merged)}
    for name in gone:
        if name not in planes:
            raise ValueError(f"removed: {name!r} is unknown, expected what is in the map")
        del planes[name]
    new = []
    if changes.observed is not None:
        nodes = changes.observed.nodes
        table = np.column_stack([nodes.position, nodes.normal, nodes.width]).tolist()
        new = [name for name in changes.ids if name not in planes]
        planes |= dict(zip(changes.ids, map(tuple, table), strict=True))
    shrunk = [name for name, parts in rooms.items() if gone & {*parts}]
    rooms = {name: tuple(p for p in parts if p not in gone) for name, parts in rooms.items()}
    removed = tuple(name for name, parts in rooms.items() if not parts)
    rooms = {name: parts for name, parts in rooms.items() if parts}
    next_id, updates = session.next_id, session.updates + 1
    if new:
        rooms[next_id], born[next_id] = tuple(new), updates
        next_id += 1
    after = Session(planes, rooms, born, updates, next_id)
    moved = [name for name, parts in rooms.items() if {*changes.ids} & {*parts}]
    grown = {name: _room(after, name) for name in rooms}
    added = tuple(grown[name] for name in rooms if name not in session.rooms)
    changed = tuple(
        grown[name] for name in rooms if name in session.rooms and name in {*shrunk, *moved}
    )
    events = tuple(Event(SHRUNK, name, ()) for name in shrunk if name in rooms)
    return after, GraphChanges(added, changed, removed, events, ("a remark",) if gone else ())


def graph_of(session: Session) -> SceneGraph:
    table = np.array([*session.planes.values()], float).reshape(-1, 7)
    count, rooms = len(table), [_room(session, name) for name in session.rooms]
    row = {name: index for index, name in enumerate(session.planes)}
    edges = [(row[part], count + i) for i, room in enumerate(rooms) for part in room.observed]
    position = np.array([*table[:, :3].tolist(), *(room.position for room in rooms)])
    return make_graph(
        [PLANE] * count + [ROOM] * len(rooms),
        position,
        normal=np.pad(table[:, 3:6], [(0, len(rooms)), (0, 0)]),
        width=np.pad(table[:, 6], (0, len(rooms))),
        part_of=edges,
    )


def ids_of(session: Session) -> list[int | str]:
    return [*session.planes, *(f"room-{name}" for name in session.rooms)]


def nodes_of(session: Session) -> dict[int, GrownNode]:
    return {name: _room(session, name) for name in session.rooms}


def _room(session: Session, name: int) -> GrownNode:
    parts = session.rooms[name]
    place = np.mean([session.planes[part][:3] for part in parts], axis=0).tolist()
    age = session.updates - session.born[name]
    return GrownNode(name, ROOM, tuple(place), parts, (), age, 1 / (1 + len(parts)))


def install(patch: Any = None) -> None:
    """Puts the stand-in where the command line looks for a session, and for weights."""
    from sg3d_jax.train import weights

    module = ModuleType("sg3d_jax.infer.session")
    for function in (begin, warm_up, update, graph_of, ids_of, nodes_of):
        setattr(module, function.__name__, function)
    put = setattr if patch is None else patch.setattr
    put(weights, "load_weights", lambda name: TRAINED)
    put(weights, "with_diffusion_steps", lambda trained, steps: trained)
    if patch is None:
        sys.modules[module.__name__] = module
    else:
        patch.setitem(sys.modules, module.__name__, module)
