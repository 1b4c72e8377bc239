"""As the robot drives: a map that changes with what is observed, update by update.

An update takes in what is new, has moved, or is gone; finds the region that it touches; has a model
draw that again, given what stays around it; and takes over what is due (`infer/revision`). All else
stays bit for bit, and what goes on keeps its id. What moved as one, such as by the closing of a
loop, takes along what stands above it, and nothing is drawn again.

An update without changes thinks: the whole map is drawn again, and what is so drawn twice in a row
is taken over.

A session is a pytree and an update a pure function: the same changes give the same map, bit for
bit. The part on the device runs in a few buckets of fixed size, however large the map.

Source: paper, Sec. "Conclusion" (real-time robotics as the next step). The rest is ours.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.grow import HALTED, grow_lanes
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.confidence import likely
from sg3d_jax.infer.intake import taken_in
from sg3d_jax.infer.lanes import root_key
from sg3d_jax.infer.region import Region, region_of, whole_region
from sg3d_jax.infer.revision import Banned, Map, Tracks, followed, observed_below, revised
from sg3d_jax.scene.changes import (
    MERGED,
    SHRUNK,
    SPLIT,
    Changes,
    Event,
    GraphChanges,
    GrownNode,
)
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
from sg3d_jax.scene.padding import bucket, centre_of_observed, moved_by, stack, unpad
from sg3d_jax.scene.validate import check_observed

LEAST: Final = 96  # nodes of the smallest bucket that regions are grown in
ROOM: Final = 20  # nodes that may come at least
GREW: Final = 0.3  # metres by which a piece may grow or shrink at an end and be the same
APART: Final = 0.15  # metres by which parts of a whole may move apart and leave it as it was
MOST_STEPS: Final = 500  # blocks of a region
TURNED: Final = 45.0  # degrees by which a piece may turn and be the same


class Session(NamedTuple):
    """The state of a map; `begin` gives the first."""

    observed: SceneGraph  # host graph of what is observed, as it was told
    ids: tuple[int | str, ...]  # the caller's, of these
    pieces: Pieces  # what they are cut into, in rows of `observed`
    known: Map  # the pieces, and what has grown above them
    banned: tuple[tuple[int, frozenset[int | str]], ...]  # label and ids of what was forbidden
    updates: int  # so far
    next_id: int  # of the next node that grows
    seed: int  # with the number of the update, fixes what is drawn
    remarks: tuple[str, ...]  # on what is observed


class _Told(NamedTuple):
    """What is observed after changes."""

    observed: SceneGraph
    ids: tuple[int | str, ...]
    heir: Mapping[int | str, int | str]  # of ids that were merged into others


class _Carried(NamedTuple):
    """A map over the pieces of now."""

    known: Map
    fresh: np.ndarray  # bool[n], observed nodes that are new, or others than they were
    stirred: np.ndarray  # bool[n], wholes that have lost parts, or whose parts have moved apart


def begin(ontology: Ontology, seed: int = 0) -> Session:
    """Returns the session of an empty map.

    Args:
      ontology: the concepts, `model.ontology`.
      seed: of all that is drawn.
    """
    empty = make_graph([], np.zeros((0, 3)), ontology=ontology)
    pieces = Pieces(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0))
    numbers = [np.zeros(0, np.int64) for _ in range(4)]
    tracks = Tracks(*numbers, np.zeros((0, ontology.num_concepts), np.int64), np.zeros(0, bool))
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
      changes: what has changed; nothing to have the whole map drawn again.

    Returns:
      The map now, and how its graph differs from the one before.

    Raises:
      ValueError: one sentence that names the update, the id and what was expected: an id that is
        unknown or told twice, an observed node that is none.
    """
    number = session.updates + 1
    where = f"update {number}"
    told = _told(session, changes, where)
    intake = taken_in(told.observed, where, least=0)
    cut = cut_observed(intake.graph)
    pieces = cut._replace(owner=intake.source[cut.owner])
    session, banned = _decided(session, changes, where)
    known, fresh, stirred = _carried(session, told, pieces, of_pieces(intake.graph, cut))
    for _, ids in banned[len(banned) - len(changes.forbidden) :]:
        fresh[list(_rows(ids, told.ids, pieces))] = True
    remarks = [remark for remark in intake.remarks if remark not in session.remarks]
    next_id, key = session.next_id, jax.random.fold_in(root_key(session.seed), number)
    if len(pieces.owner) > 1:
        graph, firm = known.graph, known.tracks.firm
        is_touched = fresh.any() or stirred.any()
        region = region_of(graph, fresh, stirred, firm) if is_touched else whole_region(graph, firm)
        drawn = _drawn(model, params, graph, region, key)
        if drawn is None:
            remarks.append(f"{where}: what was drawn did not come to its end, and was left")
        else:
            rows = [Banned(label, _rows(ids, told.ids, pieces)) for label, ids in banned]
            known = revised(known, region, drawn, fresh, stirred, number, next_id, rows)
            next_id = max(next_id, 1 + int(known.tracks.id.max(initial=-1)))
    after = Session(
        told.observed,
        told.ids,
        pieces,
        known,
        banned,
        number,
        next_id,
        session.seed,
        intake.remarks,
    )
    return after, _differences(session, after, tuple(remarks))


def graph_of(session: Session) -> SceneGraph:
    """Returns the graph of a map: what is observed, bit for bit as it was told, then what grew."""
    return joined(session.known.graph, session.pieces, session.observed)


def ids_of(session: Session) -> list[int | str]:
    """Returns the ids of the nodes of `graph_of`: the caller's, and such as "room-12"."""
    names, tracks = ontology_of(session.observed).names, session.known.tracks
    labels = session.known.graph.nodes.label
    grown = np.flatnonzero(tracks.id >= 0)
    return [*session.ids, *(f"{names[labels[row]]}-{tracks.id[row]}" for row in grown)]


def nodes_of(session: Session) -> dict[int, GrownNode]:
    """Returns the grown nodes of a map by their ids."""
    graph, tracks = session.known.graph, session.known.tracks
    parts: list[list[int]] = [[] for _ in graph.nodes.label]
    for part, whole in parts_first(graph).tolist():
        parts[whole].append(part)
    sure = likely(tracks.held, tracks.drawn)
    nodes = {}
    for row in np.flatnonzero(tracks.id >= 0).tolist():
        grown = [int(tracks.id[part]) for part in parts[row] if tracks.id[part] >= 0]
        owners = {int(session.pieces.owner[part]) for part in parts[row] if tracks.id[part] < 0}
        nodes[int(tracks.id[row])] = GrownNode(
            id=int(tracks.id[row]),
            label=int(graph.nodes.label[row]),
            position=tuple(graph.nodes.position[row].tolist()),
            observed=tuple(session.ids[owner] for owner in sorted(owners)),
            parts=tuple(sorted(grown)),
            age=session.updates - int(tracks.born[row]),
            confidence=1.0 if tracks.firm[row] else round(float(sure[row]), 4),
        )
    return nodes


def _told(session: Session, changes: Changes, where: str) -> _Told:
    """Returns what is observed after changes, and checks them."""
    plural = ontology_of(session.observed).observed_plural
    new = changes.observed
    count = 0 if new is None else len(new.nodes.label)
    if len(changes.ids) != count:
        raise ValueError(f"{where}: {count} {plural} with {len(changes.ids)} ids, expected as many")
    if len({*changes.ids}) != count:
        twice = next(one for one in changes.ids if changes.ids.count(one) > 1)
        raise ValueError(f"{where}: the id {twice!r} is told twice, expected once")
    gone = [*changes.removed, *(one for one, _ in changes.merged)]
    heirs = {*session.ids, *changes.ids} - {*gone}
    for one in gone:
        if one not in session.ids:
            raise ValueError(f"{where}: {one!r} is gone, but was not there, expected a known id")
    for one, heir in changes.merged:
        if heir not in heirs:
            raise ValueError(f"{where}: {one!r} is merged into {heir!r}, expected a known id")
    staying = [row for row, one in enumerate(session.ids) if one not in {*gone, *changes.ids}]
    observed = subgraph(session.observed, np.array(staying, int))
    if new is not None:
        if ontology_of(new) != ontology_of(observed) or not np.all(new.nodes.observed):
            raise ValueError(f"{where}: expected {plural} alone, of the concepts of the map")
        observed = _together(observed, new)
    if len(observed.nodes.label) > 1:
        check_observed(observed, where)
    ids = (*(session.ids[row] for row in staying), *changes.ids)
    return _Told(observed, ids, dict(changes.merged))


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
) -> tuple[Session, tuple[tuple[int, frozenset[int | str]], ...]]:
    """Returns the map with what its user has decided, and all that is banned."""
    graph, tracks = session.known.graph, session.known.tracks
    row_of = {int(one): row for row, one in enumerate(tracks.id) if one >= 0}
    for one in (*changes.confirmed, *changes.forbidden):
        if one not in row_of:
            raise ValueError(f"{where}: there is no grown node {one!r}, expected one of the map")
    firm = tracks.firm.copy()
    firm[[row_of[one] for one in changes.confirmed]] = True
    forbidden = [row_of[one] for one in changes.forbidden]
    firm[forbidden] = False
    if not forbidden:
        return session._replace(known=Map(graph, tracks._replace(firm=firm))), session.banned
    part_of = np.zeros((len(firm), len(firm)), bool)
    part_of[tuple(parts_first(graph).T)] = True
    banned = [
        (
            int(graph.nodes.label[row]),
            frozenset(
                session.ids[session.pieces.owner[below]]
                for below in observed_below(part_of, graph.nodes.label, part_of[:, row])
            ),
        )
        for row in forbidden
    ]
    left = np.delete(np.arange(len(firm)), forbidden)
    known = Map(
        subgraph(graph, left), Tracks(*(field[left] for field in tracks._replace(firm=firm)))
    )
    return session._replace(known=known), (*session.banned, *banned)


def _carried(session: Session, told: _Told, pieces: Pieces, now: SceneGraph) -> _Carried:
    """Returns the map over the pieces of now; what moved as one takes its wholes along.

    Args:
      session: the map so far, over the pieces of before.
      told: what is observed now.
      pieces: of it.
      now: host graph of the pieces.
    """
    graph, tracks = session.known.graph, session.known.tracks
    num_before, num_now = len(session.pieces.owner), len(pieces.owner)
    num_grown = len(graph.nodes.label) - num_before
    old, is_same = _matched(session, told, pieces, now)
    place = np.full(num_before, -1)
    place[old[old >= 0]] = np.flatnonzero(old >= 0)
    place = np.concatenate([place, num_now + np.arange(num_grown)])
    label = graph.nodes.label[num_before:]
    pairs = parts_first(graph)
    stirred = np.zeros(num_now + num_grown, bool)
    stirred[place[pairs[place[pairs[:, 0]] < 0, 1]]] = True
    staying = pairs[place[pairs[:, 0]] >= 0]
    made = extended(now, label, graph.nodes.position[num_before:], place[staying])
    total = len(made.nodes.label)
    part_of, earlier = np.zeros((total, total), bool), np.zeros((total, 3))
    part_of[tuple(place[staying].T)] = True
    earlier[:num_now][old >= 0] = graph.nodes.position[old[old >= 0]]
    earlier[num_now:] = graph.nodes.position[num_before:]
    position, moves_along = made.nodes.position.copy(), np.zeros(total, bool)
    normal = np.zeros((num_now, 2))
    normal[old >= 0] = graph.nodes.normal[old[old >= 0], :2]
    for whole in np.flatnonzero(part_of[:num_now].any(axis=0)):
        parts = np.flatnonzero(part_of[:num_now, whole] & is_same)
        if not len(parts):
            continue
        before, after = earlier[parts], now.nodes.position[parts]
        if np.array_equal(before, after):
            continue
        turn = _turn(normal[parts], now.nodes.normal[parts, :2])
        fitted = (before - before.mean(axis=0)) @ turn.T + after.mean(axis=0)
        position[whole] = (earlier[whole] - before.mean(axis=0)) @ turn.T + after.mean(axis=0)
        stirred[whole] |= np.abs(fitted - after).max() > APART
        moves_along[whole] = True
    upper = ~part_of[:num_now].any(axis=0) & (np.arange(total) >= num_now)
    position = followed(
        earlier, position, part_of, part_of, made.nodes.label, ontology_of(made), upper
    )
    carried = [
        np.concatenate([_of_pieces(field[:num_before], old, fill), field[num_before:]])
        for field, fill in zip(tracks, (-1, 0, 0, 0, 0, False), strict=True)
    ]
    graph = made._replace(nodes=made.nodes._replace(position=position))
    return _Carried(Map(graph, Tracks(*carried)), np.pad(~is_same, (0, num_grown)), stirred)


def _of_pieces(field: np.ndarray, old: np.ndarray, fill: int | bool) -> np.ndarray:
    """Returns what is known of pieces by what they were; `fill` for those that are new."""
    carried = np.full((len(old), *field.shape[1:]), fill, field.dtype)
    carried[old >= 0] = field[old[old >= 0]]
    return carried


def _matched(
    session: Session, told: _Told, pieces: Pieces, now: SceneGraph
) -> tuple[np.ndarray, np.ndarray]:
    """Finds what each piece was before.

    Pieces of one owner are compared along it: where it stands, if it has grown, and with respect to
    its middle if it has kept its width, and so has only moved.

    Returns:
      int[k], its row among the pieces of before, -1 if it is new; bool[k], whether it has kept its
      ends and its direction.
    """
    before, row_of = session.known.graph, {one: row for row, one in enumerate(told.ids)}
    ids = [session.ids[owner] for owner in session.pieces.owner]
    heirs = np.array([row_of.get(told.heir.get(one, one), -1) for one in ids], int)
    new, old = np.nonzero(pieces.owner[:, None] == heirs[None])
    owner, previous = pieces.owner[new], session.pieces.owner[old]
    kept_width = told.observed.nodes.width[owner] == session.observed.nodes.width[previous]
    kept_width &= np.array([one not in told.heir for one in ids], bool)[old]
    normal, normal_before = now.nodes.normal[new, :2], before.nodes.normal[old, :2]
    origin = np.where(kept_width[:, None], told.observed.nodes.position[owner], 0.0)[:, :2]
    origin_before = np.where(kept_width[:, None], session.observed.nodes.position[previous], 0.0)
    at = _along(normal, now.nodes.position[new, :2] - origin)
    axis = np.where(kept_width[:, None], normal_before, normal)
    at_before = _along(axis, before.nodes.position[old, :2] - origin_before[:, :2])
    half, half_before = now.nodes.width[new] / 2, before.nodes.width[old] / 2
    ends = np.stack([at - half, at + half]) - np.stack(
        [at_before - half_before, at_before + half_before]
    )
    shared = np.minimum(at + half, at_before + half_before) - np.maximum(
        at - half, at_before - half_before
    )
    shared = np.where((half == 0) & (half_before == 0), 1.0, shared)
    same = (np.abs(ends) <= GREW).all(axis=0)
    same &= np.sum(normal * normal_before, axis=1) >= np.where(
        normal_before.any(axis=1), np.cos(np.radians(TURNED)), 0.0
    )
    match, is_same = np.full(len(pieces.owner), -1), np.zeros(len(pieces.owner), bool)
    taken: set[int] = set()
    for pair in np.argsort(-shared, kind="stable").tolist():
        if shared[pair] > 0 and match[new[pair]] < 0 and int(old[pair]) not in taken:
            match[new[pair]], is_same[new[pair]] = old[pair], same[pair]
            taken.add(int(old[pair]))
    return match, is_same


def _along(normal: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Returns how far offsets go along vertical planes, float[m], metres."""
    return normal[:, 0] * offset[:, 1] - normal[:, 1] * offset[:, 0]


def _turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Returns the rotation about the vertical, float[3, 3], that turns directions best."""
    cross = np.sum(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    angle = np.arctan2(cross, np.sum(before * after))
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _rows(ids: frozenset[int | str], told: tuple[int | str, ...], pieces: Pieces) -> frozenset[int]:
    """Returns the pieces of some observed nodes."""
    return frozenset(row for row, owner in enumerate(pieces.owner) if told[owner] in ids)


def _drawn(
    model: Flagg, params: Params, graph: SceneGraph, region: Region, key: Key[Array, ""]
) -> SceneGraph | None:
    """Returns a region with what a model grows on it; None if it does not come to an end."""
    given = subgraph(graph, region.rows)
    centre, num_given = centre_of_observed(given), len(region.rows)
    capacity = bucket(max(LEAST, num_given + ROOM, int(1.8 * given.nodes.observed.sum()) + 8))
    graphs, steps = stack([moved_by(given, -centre)], capacity), jnp.zeros(1, jnp.int32)
    grown = grow_lanes(model, params, key[None], graphs, steps, MOST_STEPS, False)
    if int(grown.halt_reason[0]) != HALTED:
        return None
    drawn = unpad(jax.tree.map(lambda leaf: np.asarray(leaf)[0], grown.graph))
    pairs = parts_first(drawn)
    return extended(
        given,
        drawn.nodes.label[num_given:],
        np.asarray(drawn.nodes.position, np.float64)[num_given:] + centre,
        pairs[(pairs >= num_given).any(axis=1)],
    )


def _differences(before: Session, after: Session, remarks: tuple[str, ...]) -> GraphChanges:
    """Returns how the graph of a map differs from an earlier one."""
    old, new = nodes_of(before), nodes_of(after)
    both = [one for one in old if one in new]
    changed = [one for one in both if old[one]._replace(age=0) != new[one]._replace(age=0)]
    return GraphChanges(
        added=tuple(node for one, node in new.items() if one not in old),
        changed=tuple(new[one] for one in changed),
        removed=tuple(one for one in old if one not in new),
        events=tuple(_events(old, new, both)),
        remarks=remarks,
    )


def _events(
    old: Mapping[int, GrownNode], new: Mapping[int, GrownNode], both: Sequence[int]
) -> Iterator[Event]:
    """Yields what became of nodes that went on."""

    def members(node: GrownNode) -> set[tuple[int, int | str]]:
        return {(0, one) for one in node.observed} | {(1, one) for one in node.parts}

    came = [node for one, node in new.items() if one not in old]
    went = [node for one, node in old.items() if one not in new]
    for one in both:
        was, now = members(old[one]), members(new[one])
        label = new[one].label
        if lost := was - now:
            others = [node.id for node in came if node.label == label and members(node) & lost]
            yield Event(SPLIT if others else SHRUNK, one, tuple(others))
        others = [node.id for node in went if node.label == label and members(node) & (now - was)]
        if others:
            yield Event(MERGED, one, tuple(others))
