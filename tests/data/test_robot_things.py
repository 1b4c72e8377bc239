"""What a robot sees of doors, stairs, objects and pillars, beside the planes."""

import dataclasses

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import furnished
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.data.robot import NOTHING, STRONG, THING_STRENGTHS, TRAINING, VIEWS, in_pieces, view
from sg3d_jax.data.robot_effects import RobotConfig
from sg3d_jax.data.robot_things import ThingsConfig, is_surface, seen_things
from sg3d_jax.data.synthetic import make_scene
from sg3d_jax.scene.graph import observed_of, parts_first
from sg3d_jax.scene.validate import validate_graph
from tests.own_world import PILLAR, own_world
from tests.seen_rooms import assert_same_graph, wholes

ROOM = FURNISHED_ONTOLOGY.label_of("room")
OBJECT = FURNISHED_ONTOLOGY.label_of("object")


@pytest.fixture(scope="module")
def homes():
    return [make_scene(furnished.O_F, 0, index) for index in range(12)]


@pytest.fixture(scope="module")
def city():
    return make_scene(furnished.O_C, 0, 1)


def seen_of(graph, config, seed=0):
    """The things of a graph all of whose planes are seen."""
    rng = np.random.default_rng(seed)
    return seen_things(graph, np.flatnonzero(is_surface(graph)), config, rng)


def test_with_nothing_amiss_a_furnished_graph_is_seen_as_it_is(homes, city):
    for graph in (*homes, city, own_world()):
        assert_same_graph(view(graph, RobotConfig(), 0, 0).graph, graph)


@pytest.mark.parametrize("name", ["robot", "strong", "mild", "bare"])
def test_every_view_of_a_furnished_graph_is_a_sound_graph_of_its_concepts(name, homes, city):
    for index, graph in enumerate((*homes, city)):
        seen = view(graph, VIEWS[name], 0, index)
        for each in (seen.graph, in_pieces(seen)):
            validate_graph(each, name)
            assert (np.diff(each.nodes.label) >= 0).all()
            assert each.nodes.label.max() == graph.nodes.label.max()


@pytest.mark.parametrize("name", ["robot", "mild", "strong"])
def test_a_bare_view_has_the_same_planes_and_rooms_and_nothing_else_that_is_observed(name, homes):
    for index, graph in enumerate(homes):
        full, bare = (view(graph, VIEWS[each], 0, index) for each in (name, f"{name}_bare"))
        for field in full.graph.nodes._fields:
            rows = (is_surface(each.graph) | ~each.graph.nodes.observed for each in (full, bare))
            with_things, without = (
                getattr(each.graph.nodes, field)[row]
                for each, row in zip((full, bare), rows, strict=True)
            )
            npt.assert_array_equal(with_things, without)
        assert is_surface(bare.graph)[bare.graph.nodes.observed].all()


def test_things_are_seen_where_a_plane_of_a_room_of_theirs_is(homes):
    config = RobotConfig(unvisited=0.6)
    lost = 0
    for index, graph in enumerate(homes):
        pairs, seen = parts_first(graph), view(graph, config, 0, index)
        in_rooms = pairs[graph.nodes.label[pairs[:, 1]] == ROOM]
        shown = {*in_rooms[np.isin(in_rooms[:, 0], seen.stretches.plane), 1].tolist()}
        rooms_of = {
            node: {*in_rooms[in_rooms[:, 0] == node, 1].tolist()}
            for node in np.flatnonzero(graph.nodes.observed & ~is_surface(graph)).tolist()
        }
        assert {*seen.things.node.tolist()} == {n for n, of in rooms_of.items() if of & shown}
        lost += len(rooms_of) - len(seen.things.node)
    assert lost > 50


def test_things_belong_to_what_stays_of_what_they_belong_to(homes):
    alone = 0
    for index, graph in enumerate(homes):
        seen = view(graph, RobotConfig(missing=0.6), 1, index)
        rooms = {*map(tuple, seen.graph.nodes.position[seen.graph.nodes.label == ROOM].tolist())}
        before, after = wholes(graph), wholes(seen.graph)
        first = int(is_surface(seen.graph).sum())
        for row, node in enumerate(seen.things.node.tolist(), first):
            assert after[row] == before[node] & rooms
            alone += not after[row]
    assert alone > 0


def test_things_are_missed_doubled_displaced_and_mistaken_as_often_as_stated(city):
    graph = city
    for seed in range(3):
        things = seen_of(graph, ThingsConfig(missing=0.3), seed)
        total = len(seen_of(graph, ThingsConfig()).node)
        assert abs(len(things.node) / total - 0.7) < 0.12
        doubled = seen_of(graph, ThingsConfig(doubled=0.3), seed)
        assert abs(len(doubled.node) / total - 1.3) < 0.12
        away = np.linalg.norm(doubled.position - graph.nodes.position[doubled.node], axis=1)
        again = np.append(False, np.diff(doubled.node) == 0)
        assert not away[~again].any()
        assert ((away[again] >= 0.1) & (away[again] <= 0.6)).all()
        noisy = seen_of(graph, ThingsConfig(position_noise=0.2, width_noise=0.1), seed)
        off = noisy.position - graph.nodes.position[noisy.node]
        npt.assert_allclose(off.std(axis=0), [0.2, 0.2, 0.06], rtol=0.25)
        npt.assert_allclose(
            np.log(noisy.width / graph.nodes.width[noisy.node]).std(), 0.1, rtol=0.3
        )
        wrong = seen_of(graph, ThingsConfig(mistaken=0.25), seed)
        true, objects = graph.nodes.kind[wrong.node], graph.nodes.label[wrong.node] == OBJECT
        assert abs((wrong.kind != true)[objects].mean() - 0.25) < 0.12
        assert not wrong.kind[~objects].any()
        assert ((wrong.kind[objects] >= 1) & (wrong.kind[objects] <= 14)).all()


def test_a_mixture_has_views_without_things_and_none_beyond_its_strongest():
    drawn = [TRAINING.draw_things(np.random.default_rng(seed)) for seed in range(400)]
    bare = np.array([each == NOTHING for each in drawn])
    assert abs(bare.mean() - TRAINING.bare) < 0.06
    for name in THING_STRENGTHS:
        values = np.array([getattr(each, name) for each in drawn])[~bare]
        most = getattr(TRAINING.strongest.things, name)
        assert 0.9 * most < values.max() <= most
        assert getattr(STRONG.things, name) <= most
        assert (values == 0).any()


def test_things_without_a_kind_are_seen_too():
    graph = own_world()
    config = dataclasses.replace(STRONG, things=ThingsConfig(mistaken=1.0, position_noise=0.1))
    seen = observed_of(view(graph, config, 0, 0).graph)
    assert (seen.nodes.label == PILLAR).sum() == 2
    assert not seen.nodes.kind.any()


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"missing": 1.2}, r"missing is 1\.2, expected 0 to 1"),
        ({"mistaken": -0.1}, r"mistaken is -0\.1, expected 0 to 1"),
        ({"width_noise": -1.0}, "width_noise is -1, expected zero or more"),
        ({"doubled_offset": (0.4, 0.1)}, r"doubled_offset is \(0\.4, 0\.1\), expected 0 <= least"),
    ],
)
def test_settings_that_no_things_can_be_seen_with_are_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        ThingsConfig(**wrong)
