"""Views of graphs: what a robot sees, and what of the truth it still shows."""

import dataclasses

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import robot
from sg3d_jax.data.robot import (
    MILD,
    STRONG,
    TRAINING,
    VIEWS,
    RobotConfig,
    RobotMixture,
    in_pieces,
    raw_planes,
    view,
)
from sg3d_jax.scene.graph import (
    make_graph,
    observed_of,
    parts_first,
    subgraph,
    undirected_edges,
)
from sg3d_jax.scene.ontology import CITY, FLOOR, PLANE, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph
from tests.own_world import ONTOLOGY, own_world
from tests.seen_rooms import assert_same_graph, row_of_planes, views, wholes
from tests.unchecked import unchecked

PLANES, *OTHERS = ONTOLOGY.concepts
WITHOUT_WIDTHS = dataclasses.replace(
    ONTOLOGY, concepts=(dataclasses.replace(PLANES, features=("normal",)), *OTHERS)
)

# --- views ---


def test_with_nothing_amiss_the_graph_is_seen_as_it_is(floors, cities):
    for graph in (*floors, *cities):
        assert_same_graph(view(graph, RobotConfig(), 0, 0).graph, graph)


@pytest.mark.parametrize("name", VIEWS)
def test_every_view_is_a_sound_graph_up_to_the_same_concept(name, floors, cities):
    for seen in views([*floors[:8], *cities[:2]], VIEWS[name]):
        for graph in (seen.graph, in_pieces(seen)):
            validate_graph(graph, name)
            assert (graph.nodes.label == PLANE).sum() >= 2
            assert graph.nodes.label.max() == seen.complete.nodes.label.max()
            assert not undirected_edges(graph, 0).size
            assert (np.diff(graph.nodes.label) >= 0).all()


def test_a_view_depends_on_seed_index_and_number_alone(floors):
    graph = floors[3]
    drawn = view(graph, STRONG, 5, 3, 2).graph
    assert_same_graph(view(graph, STRONG, 5, 3, 2).graph, drawn)
    for seed, index, number in ((6, 3, 2), (5, 4, 2), (5, 3, 3), (5, 3, 0)):
        other = view(graph, STRONG, seed, index, number).graph
        assert other.nodes.width[:4].tolist() != drawn.nodes.width[:4].tolist()


def test_a_view_turns_with_its_graph(floors):
    """Position noise is along x and y, so it is left out."""
    config = dataclasses.replace(
        STRONG, position_noise=0.0, merged=0.7, doubled=0.2, clutter=0.3, unvisited=0.3
    )
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    for index, graph in enumerate(floors):
        nodes = graph.nodes
        moved = graph._replace(
            nodes=nodes._replace(
                position=nodes.position @ turn.T + [40.0, -7.0, 1.5],
                normal=nodes.normal @ turn.T,
            )
        )
        one, other = view(graph, config, 1, index).graph, view(moved, config, 1, index).graph
        npt.assert_allclose(
            one.nodes.position @ turn.T + [40.0, -7.0, 1.5], other.nodes.position, atol=1e-9
        )
        npt.assert_allclose(one.nodes.normal @ turn.T, other.nodes.normal, atol=1e-9)
        npt.assert_allclose(one.nodes.width, other.nodes.width, atol=1e-9)
        npt.assert_array_equal(parts_first(one), parts_first(other))


def test_a_mixture_has_clean_views_and_strong_ones_and_is_never_beyond_its_strongest():
    drawn = [TRAINING.draw(np.random.default_rng(seed)) for seed in range(600)]
    for name in robot.STRENGTHS:
        values = np.array([getattr(config, name) for config in drawn])
        most = getattr(TRAINING.strongest, name)
        on = 1 / 3 if name in TRAINING.seldom else 2 / 3  # the mean of the root of a uniform number
        assert values.max() <= most
        assert values.max() > 0.9 * most
        assert abs((values > 0).mean() - on) < 0.07
    amiss = [sum(getattr(config, name) > 0 for name in robot.STRENGTHS) for config in drawn]
    assert {0, 10} <= {*amiss}
    assert {config.shortened_by for config in drawn} == {TRAINING.strongest.shortened_by}


def test_the_strongest_of_the_training_is_somewhat_stronger_than_strong():
    for name in robot.STRENGTHS:
        assert getattr(TRAINING.strongest, name) >= getattr(STRONG, name) >= getattr(MILD, name)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"missing": 1.2}, r"missing is 1\.2, expected 0 to 1"),
        ({"unvisited": -0.1}, r"unvisited is -0\.1, expected 0 to 1"),
        ({"height_noise": -1.0}, r"height_noise is -1, expected zero or more"),
        ({"merged_gap": np.inf}, r"merged_gap is inf, expected zero or more"),
        ({"shortened_by": (0.4, 0.1)}, r"shortened_by is \(0\.4, 0\.1\), expected .* <= 1"),
        ({"shortened_by": (0.4, 1.5)}, r"shortened_by is \(0\.4, 1\.5\), expected .* <= 1"),
        ({"split_gap": (-0.1, 1.0)}, r"split_gap is \(-0\.1, 1\), expected 0 <= least"),
    ],
)
def test_settings_that_nothing_can_be_seen_with_are_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        RobotConfig(**wrong)


def test_a_graph_of_other_concepts_and_one_of_which_nothing_is_left_are_refused(floors):
    bare = own_world()._replace(globals=WITHOUT_WIDTHS)
    with pytest.raises(ValueError, match=r"graph 7: its concepts are .*, expected planes with a"):
        view(bare, STRONG, 0, 7)
    for others in (0.0, 1.0):
        config = RobotConfig(missing=1.0, merged=others, split=others, clutter=others)
        with pytest.raises(ValueError, match="graph 7: nothing is left of it in 100 views"):
            view(floors[0], config, 0, 7)


def test_a_view_without_a_room_is_drawn_again():
    graph = row_of_planes(3.0)
    config = RobotConfig(missing=0.6)  # no two of four planes in half of the draws
    for index in range(40):
        assert (view(graph, config, 0, index).graph.nodes.label == ROOM).sum() == 1


# --- truth ---


def expected_truth(each):
    """Returns which nodes of the complete graph stay, and the edges of the view, by loops."""
    graph, seen = each.complete, each.stretches.seen.tolist()
    shown = [set() for _ in range(int(each.graph.nodes.observed.sum()))]
    for row, plane in zip(seen, each.stretches.plane.tolist(), strict=True):
        shown[row].add(plane)
    surfaces = []  # sets of planes of the graph
    for planes in filter(None, shown):
        touched = [surface for surface in surfaces if surface & planes]
        surfaces = [surface for surface in surfaces if not surface & planes]
        surfaces.append(planes.union(*touched))
    pairs = parts_first(graph).tolist()
    stays = []
    for node in range(len(graph.nodes.label)):
        parts = {part for part, whole in pairs if whole == node}
        if graph.nodes.label[node] in (WALL, ROOM):
            sides = sum(bool(surface & parts) for surface in surfaces)
            if parts and sides >= min(2, len(parts)):
                stays.append(node)
        elif parts & set(stays):
            stays.append(node)
    place = {node: len(shown) + index for index, node in enumerate(stays)}
    edges = {
        (row, place[whole])
        for row, planes in enumerate(shown)
        for part, whole in pairs
        if part in planes and whole in place
    }
    edges |= {(place[part], place[whole]) for part, whole in pairs if part in place}
    return stays, edges


# Parts of merged planes, some of them twice: surfaces are found through several planes.
PIECEMEAL = RobotConfig(missing=0.4, merged=1.0, merged_gap=5.0, split=1.0, doubled=0.5)


@pytest.mark.parametrize("config", [TRAINING, VIEWS["missing"], VIEWS["path"], PIECEMEAL])
def test_the_truth_is_what_two_surfaces_tell_of(config, floors, cities):
    for each in views([*floors, *cities], config, seed=4):
        stays, edges = expected_truth(each)
        rest = np.flatnonzero(~each.graph.nodes.observed)
        npt.assert_array_equal(each.graph.nodes.label[rest], each.complete.nodes.label[stays])
        assert {tuple(pair) for pair in parts_first(each.graph).tolist()} == edges
        low = each.complete.nodes.label[stays] < FLOOR
        npt.assert_array_equal(
            each.graph.nodes.position[rest][low], each.complete.nodes.position[stays][low]
        )


def without(graph, *planes):
    """Returns the view of a graph of which some planes are missing, by luck."""
    wanted = np.setdiff1d(np.flatnonzero(graph.nodes.observed), planes)
    drawn = (view(graph, RobotConfig(missing=0.3), 0, index) for index in range(2000))
    with unchecked():
        return next(each for each in drawn if np.array_equal(each.stretches.plane, wanted))


def test_a_wall_or_a_room_with_one_plane_goes_and_its_plane_stays():
    graph = row_of_planes(3.0, 2.0)  # planes 1 and 4 are the wall
    one_side = without(graph, 1).graph
    assert (one_side.nodes.label == WALL).sum() == 0
    assert (one_side.nodes.label == ROOM).sum() == 2
    one_left = without(graph, 4, 6, 7).graph  # plane 5 of the second room is left
    assert (one_left.nodes.label == ROOM).sum() == 1
    assert wholes(one_left)[4] == set()
    two_left = without(graph, 6, 7).graph
    assert (two_left.nodes.label == ROOM).sum() == 2


def test_a_wall_of_two_sides_stays_if_both_are_seen():
    """Planes 0 and 4 look the same way, plane 1 the other: two surfaces of one side do not tell."""
    graph = row_of_planes(3.0, 2.0)
    pairs = np.concatenate([parts_first(graph), [[0, 8]]])
    features = {"normal": graph.nodes.normal, "width": graph.nodes.width}
    graph = make_graph(graph.nodes.label, graph.nodes.position, **features, part_of=pairs)
    npt.assert_array_equal(graph.nodes.normal[[0, 4]], -graph.nodes.normal[[1, 1]])
    assert (without(graph, 0).graph.nodes.label == WALL).sum() == 1
    assert (without(graph, 1).graph.nodes.label == WALL).sum() == 0


def test_parts_of_one_plane_are_one_side_and_a_room_that_had_one_plane_stays():
    graph = row_of_planes(3.0)
    lone = subgraph(graph, [0, 2, 4, 5])  # two planes, the room and the floor
    only = make_graph(
        lone.nodes.label,
        lone.nodes.position,
        normal=lone.nodes.normal,
        width=lone.nodes.width,
        part_of=[[0, 2], [2, 3]],
    )
    assert_same_graph(view(only, RobotConfig(), 0, 0).graph, only)
    split = RobotConfig(split=1.0, missing=0.7)
    for index in range(60):  # two parts of one plane do not make a room of four
        planes = view(graph, split, 0, index).stretches.plane
        assert len(set(planes.tolist())) >= 2


def test_a_floor_moves_with_its_rooms_and_what_is_above_with_the_floors(cities):
    moved = 0
    for each in views(cities, RobotConfig(unvisited=0.5)):
        graph, seen = each.complete, each.graph
        stays, _ = expected_truth(each)
        pairs = parts_first(graph).tolist()
        place = dict(zip(stays, np.flatnonzero(~seen.nodes.observed), strict=True))
        for node in stays:
            if graph.nodes.label[node] < FLOOR:
                continue
            before = [part for part, whole in pairs if whole == node]
            after = [place[part] for part in before if part in place]
            old, new = graph.nodes.position[before], seen.nodes.position[after]
            shift = seen.nodes.position[place[node]] - graph.nodes.position[node]
            npt.assert_allclose(shift[:2], (new.mean(axis=0) - old.mean(axis=0))[:2], atol=1e-9)
            npt.assert_allclose(shift[2], new[:, 2].max() - old[:, 2].max(), atol=1e-9)
            moved += np.abs(shift).max() > 0.1
        assert seen.nodes.label.max() == CITY
    assert moved > 6


# --- pieces ---


def rooms_of(graph):
    """Returns, by the place of each room, where its planes are."""
    rooms = {}
    for part, whole in parts_first(graph).tolist():
        if graph.nodes.label[part] == PLANE and graph.nodes.label[whole] == ROOM:
            place = tuple(graph.nodes.position[whole].round(6).tolist())
            rooms.setdefault(place, set()).add(tuple(graph.nodes.position[part].round(1).tolist()))
    return rooms


def test_pieces_of_merged_planes_are_the_planes_of_their_rooms():
    """Without noise every wall that abuts is found, so that the floor comes back."""
    graph = row_of_planes(3.0, 2.0, 4.0)
    seen = view(graph, RobotConfig(merged=1.0), 0, 0)
    assert (seen.graph.nodes.label == PLANE).sum() == 8
    pieces = in_pieces(seen)
    assert rooms_of(pieces) == rooms_of(graph)
    npt.assert_array_equal(pieces.nodes.label, graph.nodes.label)
    npt.assert_allclose(np.sort(pieces.nodes.width), np.sort(graph.nodes.width), atol=1e-6)


def test_nearly_all_merged_floors_come_back_in_pieces(floors):
    same = [
        {room: len(planes) for room, planes in rooms_of(in_pieces(each)).items()}
        == {room: len(planes) for room, planes in rooms_of(each.complete).items()}
        for each in views(floors, RobotConfig(merged=1.0))
    ]
    assert np.mean(same) > 0.8


def test_pieces_of_planes_that_are_not_cut_have_the_truth_of_the_view(floors):
    for each in views(floors, MILD):
        pieces = in_pieces(each)
        if (pieces.nodes.label == PLANE).sum() == (each.graph.nodes.label == PLANE).sum():
            assert_same_graph(pieces, each.graph)


def test_a_plane_that_shares_its_piece_is_lost_to_its_room():
    """Nothing stands between the two rooms' lower sides, so they are never told apart."""
    graph = row_of_planes(3.0, 1.0)
    graph.nodes.width[[0, 1, 4, 5]] = 0.3
    seen = view(graph, RobotConfig(merged=1.0), 0, 0)
    assert (seen.graph.nodes.label == PLANE).sum() == 6
    assert [len(places) for places in wholes(seen.graph)[:3]] == [1, 2, 2]
    rooms = rooms_of(in_pieces(seen))
    assert [len(planes) for _, planes in sorted(rooms.items())] == [4, 2]  # by x


def test_a_piece_on_which_nothing_is_seen_belongs_to_nothing():
    seen = view(row_of_planes(3.0, 2.0), RobotConfig(merged=1.0), 0, 0)
    kept = seen.stretches.plane != 2  # the lower side of the first room; with it merges plane 6
    fewer = seen._replace(stretches=type(seen.stretches)(*(each[kept] for each in seen.stretches)))
    before, after = rooms_of(in_pieces(seen)), rooms_of(in_pieces(fewer))
    first, second = sorted(before)
    assert before[first] - after[first] == {(1.5, 0.0, 0.0)}
    assert after[second] == before[second]


# --- raw planes ---


def test_a_share_of_the_raw_planes_leans_and_levelling_gives_the_view(floors):
    leaning = []
    for index, graph in enumerate(floors):
        seen = view(graph, STRONG, 0, index).graph
        raw, level = raw_planes(seen, 0, index).nodes, observed_of(seen).nodes
        npt.assert_allclose(np.linalg.norm(raw.normal, axis=1), 1, atol=1e-12)
        flat = raw.normal[:, :2] / np.linalg.norm(raw.normal[:, :2], axis=1, keepdims=True)
        npt.assert_allclose(flat, level.normal[:, :2], atol=1e-12)
        npt.assert_array_equal(raw.position, level.position)
        leaning += np.degrees(np.arcsin(np.abs(raw.normal[:, 2]))).tolist()
    leaning = np.array(leaning)
    assert leaning.max() <= 15
    assert leaning[leaning > 0].min() >= 2
    assert abs((leaning > 0).mean() - 0.15) < 0.06


def test_a_mixture_of_nothing_is_the_graph(floors):
    assert_same_graph(view(floors[0], RobotMixture(RobotConfig()), 0, 0).graph, floors[0])
