"""The synthetic floors: rules, statistics and likeness to the authors' own."""

import dataclasses
import functools
import gzip
import json
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from sg3d_jax.data import synthetic
from sg3d_jax.data.synthetic import S_F, S_F_SQUARE, SyntheticConfig, make_scene
from sg3d_jax.scene.concepts import CONCEPTS, FLOOR, PART_OF, PLANE, ROOM, WALL
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.validate import validate_graph

SHARED = Path(__file__).parents[3] / "shared" / "data"
CONFIGS = {"S-F-square": S_F_SQUARE, "S-F": S_F}
# Mean |V|, part-of edges, planes, rooms and walls of 400 graphs of the original generator.
REFERENCE = {
    "S-F-square": (23.81, 27.2, 14.72, 3.68, 4.41),
    "S-F": (29.87, 35.0, 18.84, 3.88, 6.16),
}
REFERENCE_GRAPHS = 400

configs = st.sampled_from([S_F_SQUARE, S_F])
indices = st.integers(0, 10**6)


@functools.cache
def sample(name: str) -> list[SceneGraph]:
    return [make_scene(CONFIGS[name], 1, index) for index in range(400)]


def children(graph: SceneGraph, parent: int, child: int) -> list[np.ndarray]:
    """Returns the nodes of one concept below each node of another."""
    label = graph.nodes.label
    ends = np.stack([graph.senders, graph.receivers], axis=-1)
    downwards = ends[(label[ends] == (parent, child)).all(axis=1)]
    return [downwards[downwards[:, 0] == node, 1] for node in np.flatnonzero(label == parent)]


def counts(graph: SceneGraph) -> list[int]:
    per_concept = np.bincount(graph.nodes.label, minlength=len(CONCEPTS))
    return [
        len(graph.nodes.label),
        len(graph.senders) // 2,
        *per_concept[[PLANE, ROOM, WALL]].tolist(),
    ]


def assert_same(one: SceneGraph, other: SceneGraph) -> None:
    np.testing.assert_array_equal(one.senders, other.senders)
    np.testing.assert_array_equal(one.receivers, other.receivers)
    for mine, theirs in zip(one.nodes, other.nodes, strict=True):
        np.testing.assert_array_equal(mine, theirs)


# --- what always holds ---


@given(configs, indices, indices)
@settings(deadline=None, max_examples=60)
def test_scene_is_a_sound_graph_of_one_connected_floor(config, seed, index):
    graph = make_scene(config, seed, index)
    validate_graph(graph, "scene")
    label = graph.nodes.label
    assert (np.diff(label) >= 0).all(), "planes, walls, rooms, floor in this order"
    assert (label == FLOOR).sum() == 1
    edges = (np.ones(len(graph.senders)), (graph.senders, graph.receivers))
    components, _ = connected_components(coo_array(edges, shape=(len(label), len(label))))
    assert components == 1
    np.testing.assert_allclose(np.linalg.norm(graph.nodes.normal[label == PLANE], axis=1), 1)
    assert (graph.nodes.position[:, 2] == 0).all()
    assert (graph.nodes.normal[:, 2] == 0).all()


@given(configs, indices)
@settings(deadline=None, max_examples=60)
def test_rooms_have_4_6_or_7_planes_of_their_own_and_walls_2_of_different_rooms(config, index):
    graph = make_scene(config, 0, index)
    rooms, walls = children(graph, ROOM, PLANE), children(graph, WALL, PLANE)
    assert {len(planes) for planes in rooms} <= {4, 6, 7}
    num_planes = (graph.nodes.label == PLANE).sum()
    assert sorted(np.concatenate(rooms)) == list(range(num_planes))
    room_of = {plane: room for room, planes in enumerate(rooms) for plane in planes}
    for planes in walls:
        assert len(planes) == 2
        assert room_of[planes[0]] != room_of[planes[1]]


@given(configs, indices)
@settings(deadline=None, max_examples=30)
def test_walls_and_floor_are_the_mean_of_their_children(config, index):
    graph = make_scene(config, 0, index)
    position, label = graph.nodes.position, graph.nodes.label
    for parent, child in ((WALL, PLANE), (FLOOR, ROOM)):
        means = [position[nodes].mean(axis=0) for nodes in children(graph, parent, child)]
        np.testing.assert_allclose(
            position[label == parent].reshape(-1, 3), np.reshape(means, (-1, 3))
        )


@given(indices)
@settings(deadline=None, max_examples=30)
def test_rectangles_are_closed_and_do_not_overlap(index):
    plan = synthetic.draw_plan(S_F_SQUARE, np.random.default_rng(index))
    corners = plan.ends.reshape(-1, 4, 2, 2)
    np.testing.assert_allclose(
        corners[:, :, 0], np.roll(corners, -1, axis=1)[:, :, 1][:, [3, 0, 1, 2]][:, [1, 2, 3, 0]]
    )
    low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
    start, end = np.maximum(low[:, None], low), np.minimum(high[:, None], high)
    overlap = (end - start > 1e-9).all(axis=-1)
    assert (overlap == np.eye(len(low), dtype=bool)).all()
    np.testing.assert_allclose(plan.centre, (low + high) / 2)
    inwards = (plan.centre[plan.room] - plan.ends.mean(axis=1)) * plan.normal
    assert (inwards.sum(axis=1) > 0).all()
    assert (plan.normal[plan.wall].sum(axis=1) == 0).all(), "planes of a wall face each other"


@given(configs, indices, indices)
@settings(deadline=None, max_examples=10)
def test_scene_depends_on_config_seed_and_index_alone(config, seed, index):
    assert_same(make_scene(config, seed, index), make_scene(config, seed, index))
    other = make_scene(config, seed, index + 1)
    assert not np.array_equal(other.nodes.position, make_scene(config, seed, index).nodes.position)


# --- the rules, against a direct cell-by-cell implementation ---


def packed_cell_by_cell(config: SyntheticConfig, rng: np.random.Generator) -> np.ndarray:
    """Fills the grid as the paper's authors do: room numbers from 1, holes -1."""
    grid = np.zeros(rng.integers(*config.grid_cells, size=2, endpoint=True), int)
    low, high = config.room_cells
    number = 0
    for x, y in np.ndindex(grid.shape):
        if grid[x, y]:
            continue
        free_x = next((k for k, cell in enumerate(grid[x:, y]) if cell), len(grid) - x)
        free_y = next((k for k, cell in enumerate(grid[x, y:]) if cell), grid.shape[1] - y)
        size = np.minimum([free_x, free_y], rng.integers(low, high, size=2, endpoint=True))
        number += min(size) >= low
        grid[x : x + size[0], y : y + size[1]] = number if min(size) >= low else -1
    return grid


@given(configs, indices)
@settings(deadline=None, max_examples=10)
def test_skyline_packing_and_walls_are_those_of_the_cell_by_cell_scan(config, seed):
    grid = packed_cell_by_cell(config, np.random.default_rng(seed))
    rooms = [np.argwhere(grid == number) for number in range(1, grid.max() + 1)]
    first, size = synthetic.pack_rooms(config, np.random.default_rng(seed))
    np.testing.assert_array_equal(first, [cells.min(axis=0) for cells in rooms])
    np.testing.assert_array_equal(first + size, [cells.max(axis=0) + 1 for cells in rooms])

    walls = {}
    for x, y in np.ndindex(grid.shape):
        for side, neighbour in ((0, grid[x + 1 :, y][:1]), (1, grid[x, y + 1 :][:1])):
            a, b = grid[x, y], neighbour[0] if len(neighbour) else -1
            if a > 0 and b > 0 and a != b:
                walls.setdefault((a, b), [4 * (a - 1) + side, 4 * (b - 1) + side + 2])
    plan = synthetic.draw_plan(config, np.random.default_rng(seed))
    assert plan.wall.tolist() == list(walls.values())


def test_facing_planes_are_half_a_wall_thickness_apart():
    config = dataclasses.replace(S_F_SQUARE, wall_thickness=(0.18, 0.18))
    plan = synthetic.draw_plan(config, np.random.default_rng(3))
    offset = np.diff(plan.ends.mean(axis=1)[plan.wall], axis=1)[:, 0]
    normal = plan.normal[plan.wall[:, 0]]
    np.testing.assert_allclose(np.abs((offset * normal).sum(axis=1)), 0.09)


def test_turning_keeps_distances_and_turns_normals():
    still, turned = (
        make_scene(dataclasses.replace(S_F, rotate=rotate), 0, 5).nodes for rotate in (False, True)
    )
    assert not np.allclose(still.position, turned.position)
    for vectors in (lambda nodes: nodes.position, lambda nodes: nodes.normal):
        products = [vectors(nodes) @ nodes.position.T for nodes in (still, turned)]
        np.testing.assert_allclose(*products, atol=1e-12)


def test_angles_of_turned_floors_are_uniform():
    normals = [graph.nodes.normal[0] for graph in sample("S-F-square")]
    angles = [np.arctan2(normal[1], normal[0]) / (2 * np.pi) % 1 for normal in normals]
    assert stats.kstest(angles, "uniform").pvalue > 1e-3


# --- merging ---


def rectangles(first: list, size: list) -> synthetic.Plan:
    """Returns the plan of given rectangles, in metres, without space between them."""
    first, size = np.array(first, float), np.array(size, float)
    outward = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    centre, left = first + size / 2, np.roll(outward, -1, axis=0)
    middle = centre[:, None] + outward * size[:, None] / 2
    reach = left * size[:, None] / 2
    ends = np.stack([middle + reach, middle - reach], axis=2).reshape(-1, 2, 2)
    return synthetic.Plan(
        ends=ends,
        normal=np.tile(-outward, (len(first), 1)),
        width=np.abs(np.diff(ends, axis=1)).sum(axis=(1, 2)),
        room=np.repeat(np.arange(len(first)), 4),
        centre=centre,
        wall=np.zeros((0, 2), int),
    )


def three_rooms() -> synthetic.Plan:
    """A wide room (6 x 2) below a narrow one (4 x 2, left) and a third (2 x 2, right)."""
    plan = rectangles([(0, 0), (0, 2), (4, 2)], [(6, 2), (4, 2), (2, 2)])
    return plan._replace(wall=np.array([[1, 4 + 3], [1, 8 + 3], [4 + 0, 8 + 2]]))


def merge_first_wall(plan: synthetic.Plan, stale_width: bool) -> synthetic.Plan:
    """Merges over wall 0 only."""

    class OnlyFirst(np.random.Generator):
        def random(self, size: int) -> np.ndarray:
            return np.array([0.0] + [1.0] * (size - 1))

    return synthetic.merge_rooms(plan, 0.5, stale_width, OnlyFirst(np.random.PCG64(0)))


def test_merging_two_rectangles_gives_an_l_of_six_planes():
    plan = merge_first_wall(three_rooms(), stale_width=False)
    assert np.bincount(plan.room).tolist() == [6, 4]
    lengths = np.linalg.norm(np.diff(plan.ends, axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(plan.width, lengths)
    expected = {((6, 0), (6, 2)), ((4, 2), (6, 2)), ((4, 2), (4, 4)), ((0, 4), (4, 4))}
    expected |= {((0, 0), (0, 4)), ((0, 0), (6, 0))}
    merged = plan.ends[plan.room == 0].round(9).astype(int)
    assert {tuple(sorted(map(tuple, ends))) for ends in merged.tolist()} == expected


def test_merging_drops_the_wall_and_keeps_the_others():
    plan = merge_first_wall(three_rooms(), stale_width=True)
    centres = plan.ends.mean(axis=1)[plan.wall].tolist()
    assert sorted(centres) == [[[4, 3], [4, 3]], [[5, 2], [5, 2]]]


def test_centroid_of_a_merged_room_is_the_mean_of_eight_planes():
    plan = merge_first_wall(three_rooms(), stale_width=True)
    wide = [(6, 1), (5, 2), (3, 0)]  # the shortened plane counts where it is now
    narrow = [(4, 3), (2, 4), (2, 2)]  # the removed plane counts too
    fused = [(0, 2)]
    fragments = [(0, 1), (0, 3)]  # one of the fused planes still counts where it was
    candidates = [np.mean([*wide, *narrow, *fused, old], axis=0) for old in fragments]
    assert any(np.allclose(plan.centre[0], candidate) for candidate in candidates)


def test_a_wall_between_planes_without_other_walls_is_not_merged():
    plan = rectangles([(0, 0), (0, 2)], [(4, 2), (4, 2)])._replace(wall=np.array([[1, 7]]))
    merged = synthetic.merge_rooms(plan, 1.0, True, np.random.default_rng(0))
    assert len(merged.room) == 8


def test_stale_width_changes_the_width_of_fused_planes_only():
    fresh_config = dataclasses.replace(S_F, stale_width=False)
    stale = np.concatenate([graph.nodes.width for graph in sample("S-F")])
    fresh = [make_scene(fresh_config, 1, index) for index in range(len(sample("S-F")))]
    for one, other in zip(fresh, sample("S-F"), strict=True):
        np.testing.assert_array_equal(one.nodes.position, other.nodes.position)
    widths = np.concatenate([graph.nodes.width for graph in fresh])
    label = np.concatenate([graph.nodes.label for graph in fresh])
    share = np.mean((stale != widths)[label == PLANE])
    assert 0.055 < share < 0.075  # 6.5 % in the published set


# --- statistics ---


@pytest.mark.parametrize("name", CONFIGS)
def test_means_agree_with_the_original_generator(name):
    table = np.array([counts(graph) for graph in sample(name)])
    error = table.std(axis=0) * np.sqrt(1 / len(table) + 1 / REFERENCE_GRAPHS)
    assert (np.abs(table.mean(axis=0) - REFERENCE[name]) < 4 * error).all()


def test_39_percent_of_the_rooms_of_s_f_are_merged():
    sizes = [len(planes) for graph in sample("S-F") for planes in children(graph, ROOM, PLANE)]
    assert np.mean(np.array(sizes) > 4) == pytest.approx(0.39, abs=0.03)


@pytest.mark.parametrize("name", CONFIGS)
def test_floors_of_one_room_and_no_wall_occur(name):
    sizes = [len(graph.nodes.label) for graph in sample(name)]
    assert min(sizes) == 6


def test_a_scene_takes_less_than_a_fiftieth_of_the_original_time():
    start = time.process_time()
    for index in range(50):
        make_scene(S_F, 2, index)
    assert (time.process_time() - start) / 50 < 0.17 / 50


def read_originals(name: str) -> list[SceneGraph]:
    path = SHARED / f"original_{name}.json.gz"
    if not path.exists():
        pytest.skip("needs the authors' graphs")
    graphs = []
    for graph in json.loads(gzip.decompress(path.read_bytes())):
        nodes = sorted(graph["nodes"], key=lambda node: CONCEPTS.index(node["label"]))
        slot = {node["id"]: index for index, node in enumerate(nodes)}
        graphs.append(
            make_graph(
                [CONCEPTS.index(node["label"]) for node in nodes],
                [node["position"] for node in nodes],
                [node["normal"] or (0, 0, 0) for node in nodes],
                [node["width"] or 0 for node in nodes],
                [[slot[one], slot[other]] for one, other in graph["edges"]],
            )
        )
    return graphs


def features(graph: SceneGraph) -> dict[str, float]:
    """One number a graph and property, so that graphs are independent samples."""
    nodes = graph.nodes
    planes = nodes.label == PLANE
    position, width = nodes.position[planes], nodes.width[planes]
    walls, rooms = children(graph, WALL, PLANE), children(graph, ROOM, PLANE)
    gap = [np.linalg.norm(np.diff(position[pair], axis=0)) for pair in walls]
    offset = nodes.position[nodes.label == ROOM] - [position[room].mean(axis=0) for room in rooms]
    _, walls_of_plane = np.unique(np.concatenate(walls) if walls else [], return_counts=True)
    return {
        "nodes": len(nodes.label),
        "planes": planes.sum(),
        "walls": len(walls),
        "rooms": len(rooms),
        "edges": len(undirected_edges(graph, PART_OF)),
        "least width": width.min(),
        "mean width": width.mean(),
        "greatest width": width.max(),
        "spread": np.sqrt(position.var(axis=0).sum()),
        "distance from origin": np.linalg.norm(nodes.position[nodes.label == FLOOR]),
        "planes of the greatest room": max(map(len, rooms)),
        "share of merged rooms": np.mean([len(room) > 4 for room in rooms]),
        "room off its planes": np.round(np.linalg.norm(offset, axis=1).max(), 4),
        "least wall gap": min(gap, default=0),
        "mean wall gap": np.mean(gap or 0),
        "walls of the busiest plane": max(walls_of_plane, default=0),
        "angle": np.round(np.arctan2(*nodes.normal[0, :2]) % (np.pi / 2), 4),
    }


@pytest.mark.parametrize("name", CONFIGS)
def test_graphs_are_indistinguishable_from_the_authors(name):
    ours = [features(graph) for graph in sample(name)]
    theirs = [features(graph) for graph in read_originals(name)]
    for feature in ours[0]:
        columns = ([graph[feature] for graph in graphs] for graphs in (ours, theirs))
        assert stats.ks_2samp(*columns).pvalue > 0.01, feature


@pytest.mark.parametrize("name", CONFIGS)
def test_graphs_are_jointly_indistinguishable_from_the_authors(name):
    theirs = [list(features(graph).values()) for graph in read_originals(name)]
    ours = [list(features(graph).values()) for graph in sample(name)]
    table = np.array(theirs + ours)
    table = (table - table.mean(axis=0)) / np.where(table.std(axis=0) > 0, table.std(axis=0), 1)
    distance = cdist(table, table)

    def energy(members: np.ndarray) -> float:
        """Returns the energy distance between the members and the others."""
        weight = np.where(members, 1 / members.sum(), -1 / (~members).sum())
        return -weight @ distance @ weight

    members = np.arange(len(table)) < len(theirs)
    rng = np.random.default_rng(0)
    shuffled = [energy(rng.permutation(members)) for _ in range(300)]
    assert np.mean(np.array(shuffled) >= energy(members)) > 0.01


# --- settings ---


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid_cells": (100, 50)}, "grid_cells"),
        ({"room_cells": (0, 50)}, "room_cells"),
        ({"room_cells": (60, 70)}, "a room to fit"),
        ({"wall_thickness": (0.2, 2.5)}, "wall_thickness"),
        ({"merge_ratio": 1.5}, "merge_ratio"),
    ],
)
def test_settings_that_cannot_be_drawn_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(S_F, **change)
