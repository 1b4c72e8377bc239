"""Normals, units and widths, judged by one another: true scenes pass, and false ones are told."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from sg3d_jax.data import registry
from sg3d_jax.infer.plausible import (
    flipped_alone,
    layout,
    look_flipped,
    remark_on_size,
    remarks_on_widths,
)
from sg3d_jax.io.json import graph_from_dict
from sg3d_jax.scene.graph import make_graph, observed_of
from sg3d_jax.scene.ontology import PLANE
from tests.own_world import own_world
from tests.two_rooms import planes_of_room

SHARED = Path(__file__).parents[3] / "shared" / "data"


def scenes():
    """Returns floors, and cities."""
    return [observed_of(graph) for name in ("s-f", "s-c") for graph in registry.make(name, 12)]


def changed(graph, size=1.0, flip=False, width=lambda width: width):
    """Returns a graph with other planes; `flip` is one for all, or bool[n]."""
    nodes = graph.nodes
    normal = np.where(
        np.broadcast_to(flip, nodes.width.shape)[:, None], -nodes.normal, nodes.normal
    )
    return make_graph(nodes.label, nodes.position * size, normal, width(nodes.width) * size)


def room(left=0.0, right=4.0, low=0.0, high=3.0, flip=False):
    centroid, normal, width = map(np.array, planes_of_room(left, right, low, high))
    flat = [(0, 0), (0, 1)]
    normal = -normal if flip else normal
    return make_graph([PLANE] * 4, np.pad(centroid, flat), np.pad(normal, flat), width)


def missing(graph, rng, share=0.3):
    nodes, left = graph.nodes, rng.random(len(graph.nodes.label)) >= share
    fields = (nodes.label, nodes.position, nodes.normal, nodes.width)
    return make_graph(*(field[left] for field in fields))


def test_true_scenes_pass():
    for scene in [*scenes(), observed_of(own_world())]:
        planes = layout(scene)
        assert look_flipped(planes) is None
        assert not flipped_alone(planes).any()
        assert remark_on_size(planes, "planes") is None
        assert remarks_on_widths(planes, "planes") == []


@pytest.mark.skipif(not SHARED.is_dir(), reason="recordings of S-Graphs are not here")
def test_recordings_pass():
    with gzip.open(SHARED / "s_graphs_logs.jsonl.gz") as file:
        for line in file:
            planes = layout(observed_of(graph_from_dict(json.loads(line))))
            assert look_flipped(planes) is None
            assert not flipped_alone(planes).any()
            assert remark_on_size(planes, "planes") is None
            assert remarks_on_widths(planes, "planes") == []


@pytest.mark.skipif(not SHARED.is_dir(), reason="floor plans are not here")
def test_floor_plans_pass(tmp_path):
    with gzip.open(SHARED / "floorplans.jsonl.gz", "rt") as file:
        (tmp_path / "plans.jsonl").write_text("".join(list(file)[::30]))
    for graph in registry.import_file("p-f", tmp_path / "plans.jsonl")[0]:
        planes = layout(graph)
        assert look_flipped(planes) is None
        assert not flipped_alone(planes).any()
        assert remark_on_size(planes, "planes") is None
        assert remarks_on_widths(planes, "planes") == []


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_flipped_normals_are_told_from_right_ones_though_planes_are_missing(share):
    rng = np.random.default_rng(0)
    whole = [missing(scene, rng, share) for scene in scenes()]
    assert [look_flipped(layout(scene)) for scene in whole] == [None] * len(whole)
    told = [look_flipped(layout(changed(scene, flip=True))) is not None for scene in whole]
    assert np.mean(told) >= 1 - share / 2


def test_a_room_alone_is_enough_to_tell_flipped_normals_and_two_planes_are_not():
    assert look_flipped(layout(room())) is None
    assert look_flipped(layout(room(flip=True))) == (4, 0)
    nodes = room(flip=True).nodes
    pair = make_graph([PLANE] * 2, nodes.position[:2], nodes.normal[:2], nodes.width[:2])
    assert look_flipped(layout(pair)) is None


def both(*graphs):
    fields = ("label", "position", "normal", "width")
    columns = (np.concatenate([getattr(g.nodes, field) for g in graphs]) for field in fields)
    return make_graph(*columns)


def test_faces_of_a_wall_tell_flipped_normals_like_those_without_anything_behind():
    assert look_flipped(layout(both(room(flip=True), room(4.1, 8.1, flip=True)))) == (8, 0)


@pytest.mark.parametrize(("share", "found", "wrong"), [(0.05, 0.7, 0.0), (0.2, 0.7, 0.001)])
def test_normals_flipped_here_and_there_are_found(share, found, wrong):
    rng, counts = np.random.default_rng(0), np.zeros((2, 2))
    for scene in scenes():
        flipped = rng.random(len(scene.nodes.label)) < share
        told = flipped_alone(layout(changed(scene, flip=flipped)))
        np.add.at(counts, (flipped.astype(int), told.astype(int)), 1)
    of_right, of_flipped = counts[:, 1] / counts.sum(axis=1)
    assert of_flipped >= found
    assert of_right <= wrong


def test_one_plane_of_a_room_alone_is_told_by_its_corners_and_one_of_a_pair_is_not():
    alone = np.arange(4) == 1
    assert flipped_alone(layout(changed(room(), flip=alone))).tolist() == alone.tolist()
    assert not flipped_alone(layout(room())).any()
    nodes = changed(room(), flip=alone).nodes
    pair = make_graph([PLANE] * 2, nodes.position[:2], nodes.normal[:2], nodes.width[:2])
    assert not flipped_alone(layout(pair)).any()


def test_a_wall_in_front_tells_of_a_flipped_plane_where_another_is_flipped_for_sure():
    """Two rooms side by side, of which the planes between them and opposite were seen, or all."""
    nodes = both(room(), room(4.1, 8.1)).nodes
    in_line = np.flatnonzero(nodes.normal[:, 1] == 0)
    fields = (nodes.label, nodes.position, nodes.normal, nodes.width)
    middle = make_graph(*(field[in_line] for field in fields))
    assert not flipped_alone(layout(middle)).any()
    for plane in np.flatnonzero(np.abs(middle.nodes.position[:, 0] - 4.05) < 0.1):
        flipped = changed(middle, flip=np.arange(4) == plane)
        assert not flipped_alone(layout(flipped)).any()
        with_another = both(flipped, changed(room(20.0, 24.0), flip=np.arange(4) == 1))
        assert np.flatnonzero(flipped_alone(layout(with_another))).tolist() == [plane, 5]
    for plane in range(8):
        flipped = changed(both(room(), room(4.1, 8.1)), flip=np.arange(8) == plane)
        assert np.flatnonzero(flipped_alone(layout(flipped))).tolist() == [plane]


def test_a_face_that_is_seen_again_in_place_of_the_other_one_is_not_flipped():
    rooms = both(room(), room(4.1, 8.1))
    nodes = rooms.nodes
    (face,) = np.flatnonzero(nodes.position[:, 0] == 4)
    fields = (nodes.label, nodes.position + np.array([0.11, 0, 0]), nodes.normal, nodes.width)
    again = make_graph(*(field[[face]] for field in fields))
    assert not flipped_alone(layout(both(rooms, again))).any()


def test_planes_of_other_storeys_do_not_face_each_other():
    """Sides of a stairwell, each on another storey: there is nothing opposite."""
    nodes = room(flip=True).nodes
    apart = nodes.position + np.arange(4)[:, None] * [0, 0, 3.0]
    assert look_flipped(layout(make_graph(nodes.label, apart, nodes.normal, nodes.width))) is None


@pytest.mark.parametrize(
    ("factor", "size"),
    [
        (0.001, "a doll's house"),
        (0.01, "a doll's house"),
        (0.1, "a doll's house"),
        (10, "a town"),
        (30, "a town"),
        (100, "a town"),
    ],
)
def test_sizes_of_another_unit_are_said(factor, size):
    for scene in scenes():
        said = remark_on_size(layout(changed(scene, factor)), "planes")
        assert said is not None
        assert said.startswith(f"the planes have the size of {size}, with widths of about ")


def test_a_hall_is_no_town_and_small_rooms_are_no_doll_s_house():
    assert remark_on_size(layout(room(right=26.0, high=19.0)), "planes") is None
    assert remark_on_size(layout(room(right=1.0, high=0.9)), "planes") is None


@pytest.mark.parametrize(
    ("width", "sentence"),
    [
        (lambda w: 0 * w, "have the width 0, which is no extent"),
        (lambda w: 0 * w + 2.5, "have the width 2.5, as if it were not known"),
        (lambda w: 2 * w, "pass through others, as if their widths were too large"),
    ],
)
def test_widths_that_are_none_are_said_once_with_their_count(width, sentence):
    for scene in scenes():
        remarks = remarks_on_widths(layout(changed(scene, width=width)), "planes")
        (remark,) = [remark for remark in remarks if sentence in remark]
        count = len(scene.nodes.label)
        assert f"{count} planes" in remark


def test_a_width_of_zero_is_counted():
    scene = scenes()[0]
    width = np.array(scene.nodes.width)
    width[2:5] = 0
    (remark,) = remarks_on_widths(layout(changed(scene, width=lambda _: width)), "planes")
    assert remark.startswith(f"3 of {len(width)} planes have the width 0")


def test_equal_widths_of_square_rooms_are_true():
    assert remarks_on_widths(layout(both(room(0, 3), room(3.1, 6.1))), "planes") == []


@pytest.mark.parametrize(("height", "said"), [(0.0, 1), (1.4, 1), (2.4, 0)])
def test_planes_of_other_storeys_do_not_pass_through_each_other(height, said):
    position = [[0, 0, 0], [0.5, 0.5, height]]
    crossed = make_graph([PLANE] * 2, position, [[1, 0, 0], [0, 1, 0.0]], [4, 5])
    assert len(remarks_on_widths(layout(crossed), "planes")) == said


def test_nothing_that_is_observed_need_be_a_plane():
    pillars = own_world()
    rows = np.flatnonzero(pillars.nodes.label == 1)
    alone = layout(make_graph([1] * 2, pillars.nodes.position[rows], ontology=pillars.globals))
    assert look_flipped(alone) is None
    assert remark_on_size(alone, "pillars") is None
    assert remarks_on_widths(alone, "pillars") == []
