import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.baselines.edge_classifier import ECL, ECLConfig, ECSquare, ECSquareConfig
from sg3d_jax.baselines.edge_features import Scales
from sg3d_jax.baselines.midi_oracle import MiDiOracle, MiDiOracleConfig
from sg3d_jax.flagg.grow import DEFAULT_MAX_STEPS, grow_lanes
from sg3d_jax.flagg.placement import Placement
from sg3d_jax.infer import complete as completing
from sg3d_jax.infer import lanes
from sg3d_jax.infer.complete import Completion, complete, complete_each
from sg3d_jax.infer.lanes import growth_capacity
from sg3d_jax.infer.placement import placed
from sg3d_jax.io.planes import planes
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.graph import SceneGraph, observed_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph
from sg3d_jax.train.weights import load_weights
from tests.growing_rooms import MODEL, NEVER, stop_at
from tests.tiny_run import untrained_weights
from tests.two_rooms import NUM_PLANES, STATISTICS, moved, on_device, random_params, two_rooms
from tests.unchecked import unchecked

SCENE = two_rooms()
SCALES = Scales(1.0, 5.0, 10.0)
CLASSIFIERS = (
    ECSquare(ECSquareConfig(heads=2, width=4, decoder=(8,)), SCALES),
    ECL(ECLConfig(node_width=4, heads=2, edge_width=5, decoder=(8,), readout_width=6), SCALES),
)


class Credulous(RelaxedTransformer):
    """A network that takes what it sees for the truth."""

    def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
        return jax.nn.one_hot(label, self.num_concepts), jax.nn.one_hot(edges, 2), position


class Oracle(MiDiOracle):
    @property
    def network(self):
        return Credulous(8, 8, 1, 2, 2, self.ontology.num_concepts)


ORACLE = Oracle(
    MiDiOracleConfig(*(8, 1, 2, 8, 8, 1, 2), diffusion_steps=3, sampling_steps=3, resamplings=0),
    STATISTICS,
)


@pytest.fixture(autouse=True)
def _no_check_of_key_reuse():
    """JAX takes a vmapped loop over keys for their reuse."""
    with jax.debug_key_reuse(False):
        yield


def first_planes(count: int) -> SceneGraph:
    return subgraph(observed_of(SCENE), np.arange(count))


def same(one: Completion, other: Completion) -> bool:
    """Whether two samples are the same; how sure they are is told by those beside them, too."""
    fields = ("graph", "halt_reason", "steps", "source")
    pairs = ([getattr(each, field) for field in fields] for each in (one, other))
    return all(jax.tree.leaves(jax.tree.map(np.array_equal, *pairs)))


def sure_params(model):
    """Returns parameters of an edge classifier that is sure of some pairs."""
    params = random_params(model.init, on_device(SCENE))
    return jax.tree.map(lambda leaf: 2 * np.asarray(leaf), params)


def test_scenes_of_one_bucket__are_compiled_once():
    grow_lanes.clear_cache()
    counts = (8, 7, 6)  # the bucket of 24 nodes, and twice that of 16 below
    for scenes in ([first_planes(count) for count in counts], [first_planes(8)] * 40):
        complete(MODEL, stop_at(6), scenes, candidates=1)
    complete(MODEL, stop_at(6), scenes[:1], candidates=1, max_steps=7)
    assert grow_lanes._cache_size() == 1
    complete(MODEL, stop_at(6), [first_planes(3), first_planes(8), first_planes(2)])
    assert grow_lanes._cache_size() == 2


@pytest.mark.parametrize(
    ("params", "max_steps", "reason"),
    [(stop_at(13), DEFAULT_MAX_STEPS, "HALTED"), (NEVER, 1, "MAX_STEPS")],
)
def test_growing__ends_for_each_of_its_reasons(params, max_steps, reason):
    [[grown]] = complete(MODEL, params, [SCENE], max_steps=max_steps)
    num_new = len(grown.graph.nodes.label) - NUM_PLANES
    assert grown.halt_reason == reason
    assert grown.steps <= num_new <= 2 * grown.steps
    if reason == "HALTED":
        assert num_new in (5, 6)
    else:
        assert grown.steps == max_steps


def test_halting__goes_before_the_limit_on_steps():
    [[grown]] = complete(MODEL, stop_at(9), [SCENE], max_steps=1)
    assert grown.halt_reason == "HALTED"


def test_grown_graphs__have_their_planes_and_part_of_edges_and_nothing_else():
    [[grown]] = complete(MODEL, stop_at(13), [SCENE])
    graph, num_nodes = grown.graph, len(grown.graph.nodes.label)
    validate_graph(graph, "grown")
    assert (graph.nodes.label[NUM_PLANES:] == ROOM).all()
    assert len(undirected_edges(graph, PROXIMITY)) == 0
    expected = [(plane, room) for plane in (0, 1) for room in range(NUM_PLANES, num_nodes)]
    np.testing.assert_array_equal(undirected_edges(graph, PART_OF), expected)


@pytest.mark.parametrize("offset", [(0, 0, 0), (5e6 + 0.123456789, -5e6, 100.0)])
def test_planes__come_back_bit_for_bit_wherever_the_building_stands(offset):
    scene = moved(SCENE, 0.3, offset)
    [[grown]] = complete(MODEL, stop_at(11), [scene])
    observed = observed_of(scene).nodes
    for found, given in zip(grown.graph.nodes, observed, strict=True):
        assert found.dtype == given.dtype
        np.testing.assert_array_equal(found[:NUM_PLANES], given)
    away = grown.graph.nodes.position[NUM_PLANES:] - observed.position.mean(axis=0)
    assert 1e-3 < np.abs(away).max() <= 1


def test_only_the_planes_of_a_scene__are_looked_at():
    [[whole]] = complete(MODEL, stop_at(13), [SCENE])
    [[planes]] = complete(MODEL, stop_at(13), [observed_of(SCENE)])
    assert same(whole, planes)


def test_results__come_in_the_order_of_the_scenes_with_as_many_samples_as_asked():
    counts = [8, 3, 6, 2, 8]
    scenes = [first_planes(count) for count in counts]
    grown = complete(MODEL, stop_at(10), scenes, samples=3)
    assert [len(samples) for samples in grown] == [3] * 5
    for count, samples in zip(counts, grown, strict=True):
        for one in samples:
            assert (one.graph.nodes.label == PLANE).sum() == count
        places = [one.graph.nodes.position[count] for one in samples]
        assert len(np.unique(places, axis=0)) == 3


def test_a_sample__does_not_depend_on_the_batch_it_is_grown_in():
    scenes = [first_planes(count) for count in (8, 3, 6, 2, 7)]
    expected = complete(MODEL, stop_at(12), scenes, seed=7)
    alone = complete(MODEL, stop_at(12), scenes[:1], seed=7)
    assert same(alone[0][0], expected[0][0])
    for one, other in zip(
        complete(MODEL, stop_at(12), scenes, seed=7, lanes=2), expected, strict=True
    ):
        assert same(one[0], other[0])


def test_seeds__give_other_graphs():
    one, other = (complete(MODEL, stop_at(12), [SCENE], seed) for seed in (0, 1))
    assert not same(one[0][0], other[0][0])


@pytest.mark.parametrize("num_planes", [2, 40, 200])
def test_capacity__has_room_for_eight_new_nodes_and_four_for_every_five_planes(num_planes):
    capacity = growth_capacity(num_planes)
    assert capacity.nodes >= 1.8 * num_planes + 7
    assert capacity.edges >= 20 * num_planes


@pytest.mark.parametrize("model", CLASSIFIERS, ids=["square", "l"])
@pytest.mark.parametrize("offset", [(0, 0, 0), (5e6 + 0.123456789, -5e6, 100.0)])
def test_planes__come_first_in_what_edge_classifiers_find(model, offset):
    scene = moved(SCENE, 0.3, offset)
    [[found]] = complete(model, sure_params(model), [scene])
    validate_graph(found.graph, "found")
    for mine, given in zip(found.graph.nodes, observed_of(scene).nodes, strict=True):
        assert mine.dtype == given.dtype
        np.testing.assert_array_equal(mine[:NUM_PLANES], given)
    new = found.graph.nodes.label[NUM_PLANES:]
    assert len(new)
    assert new.tolist() == sorted(new.tolist(), key=(WALL, ROOM).index)
    assert (found.halt_reason, found.steps) == ("ONE_SHOT", 1)


def test_what_edge_classifiers_find__does_not_depend_on_what_it_is_found_with():
    scenes = [first_planes(count) for count in (8, 3, 6, 2, 7)]
    model, params = CLASSIFIERS[1], sure_params(CLASSIFIERS[1])
    together = complete(model, params, scenes, seed=7, samples=2)
    alone = complete(model, params, scenes[:1], seed=7)
    assert [len(samples) for samples in together] == [2] * 5
    assert same(alone[0][0], together[0][0])
    for scene, samples in zip(scenes, together, strict=True):
        for one in samples:
            assert (one.graph.nodes.label == PLANE).sum() == len(scene.nodes.label)


def test_one_shot_samples__do_not_depend_on_the_batch_and_shift_with_the_scene():
    params = random_params(ORACLE.init, on_device(SCENE))
    few = subgraph(SCENE, np.r_[:NUM_PLANES, 11], edges=False)  # the floor alone
    far = moved(SCENE, offset=(30, -20, 2))
    together = complete(ORACLE, params, [SCENE, few, far], seed=4, samples=2)
    [alone] = complete(ORACLE, params, [SCENE], seed=4, samples=2)
    for one, other in zip(together[0], alone, strict=True):
        assert same(one, other)
    assert not np.array_equal(alone[0].graph.nodes.position, alone[1].graph.nodes.position)
    for scene, samples in zip((SCENE, few, far), together, strict=True):
        for completion in samples:
            assert len(completion.graph.nodes.label) == len(scene.nodes.label)
            planes = completion.graph.nodes.position[: (scene.nodes.label == PLANE).sum()]
            np.testing.assert_array_equal(planes, scene.nodes.position[scene.nodes.label == PLANE])


def test_a_scene_without_anything_but_planes__is_refused_by_an_oracle():
    params = {"encoder": jnp.zeros(()), "denoiser": jnp.zeros(())}
    with pytest.raises(ValueError, match=r"^scene 1: has planes alone, expected a complete graph"):
        complete(ORACLE, params, [SCENE, observed_of(SCENE)])


def test_of_several_candidates__what_most_have_is_kept(monkeypatch):
    asked = []

    def last(graphs, num_given):
        asked.append((len(graphs), num_given))
        return graphs[-1], len(graphs) - 1

    monkeypatch.setattr(completing, "consensus", last)
    monkeypatch.setattr(completing, "ROUND", 3)
    scenes = [first_planes(8), first_planes(5)]
    kept = complete(MODEL, stop_at(11), scenes, samples=2, candidates=3)
    drawn = complete(MODEL, stop_at(11), scenes, samples=6)
    assert asked[:4] == [(3, 8), (3, 8), (3, 5), (3, 5)]
    for of_kept, of_drawn in zip(kept, drawn, strict=True):
        assert len(of_kept) == 2
        for one, index in zip(of_kept, (2, 5), strict=True):
            # The stand-in keeps the last of one, too, so that the others are as they were drawn.
            assert same(one, of_drawn[index])
            np.testing.assert_array_equal(one.node_confidence, of_drawn[index].node_confidence)


def test_what_is_kept__stands_where_a_placement_says():
    model = dataclasses.replace(MODEL, placement=Placement(4, 2, 1))
    places = random_params(model.placement.init, on_device(SCENE))
    params = stop_at(11)._replace(placement=places)
    scenes, options = [observed_of(SCENE)], {"samples": 2, "candidates": 2}
    [found], [drawn] = (
        complete(one, params, scenes, **options, cut="never") for one in (model, MODEL)
    )
    for one, other in zip(found, drawn, strict=True):
        expected = placed(model, params, other.graph, NUM_PLANES).nodes.position
        np.testing.assert_allclose(one.graph.nodes.position, expected, atol=1e-5)
        assert np.abs(expected - other.graph.nodes.position).max() > 0.01


def test_no_more_are_drawn_once_most_are_alike(monkeypatch):
    """By default, of one sample: eight at most. The first scene needs two rounds, the other one."""
    asked = []

    def settled(graphs, num_given):
        asked.append((len(graphs), num_given))
        return len(graphs) >= {8: 4, 5: 2}[num_given]

    monkeypatch.setattr(completing, "are_settled", settled)
    [[one], [other]] = complete(MODEL, stop_at(11), [first_planes(8), first_planes(5)])
    assert sorted(asked) == [(2, 5), (2, 8), (4, 8)]  # whichever scene is done first
    [[alone]] = complete(MODEL, stop_at(11), [first_planes(8)])
    assert same(one, alone)
    assert (one.node_confidence[NUM_PLANES:] < 1).all()
    assert other.node_confidence is not None
    monkeypatch.setattr(completing, "are_settled", lambda graphs, num_given: False)
    kept = []
    monkeypatch.setattr(
        completing, "consensus", lambda *of_all: kept.append(of_all) or (of_all[0][0], 0)
    )
    complete(MODEL, stop_at(11), [first_planes(8)])
    assert len(kept[0][0]) == 8


def test_lanes_are_for_as_many_graphs_as_are_drawn_at_once(monkeypatch):
    asked = set()
    monkeypatch.setattr(lanes, "num_lanes", lambda capacity, count: asked.add(count) or 1)
    complete(MODEL, stop_at(11), [SCENE] * 3, samples=2, candidates=3)  # of which two come first
    assert asked == {12}


@pytest.mark.parametrize(
    ("reasons", "voters"),
    [
        (("CAPACITY", "HALTED", "MAX_STEPS"), [1]),
        (("HALTED", "REPEATED", "HALTED"), [0, 2]),
        (("CAPACITY", "CAPACITY", "MAX_STEPS"), [0, 1, 2]),
    ],
)
def test_a_candidate_that_did_not_come_to_its_end__has_no_vote(reasons, voters, monkeypatch):
    draw, seen, voted = completing._drawn, [], []

    def cut_off(*arguments):
        [drawn] = yield from draw(*arguments)
        codes = map(completing.HALT_REASONS.index, reasons)
        seen.extend(one._replace(halt_reason=code) for one, code in zip(drawn, codes, strict=True))
        return [seen]

    def first(graphs, num_given):
        voted.extend(graphs)
        return graphs[0], 0

    monkeypatch.setattr(completing, "are_settled", lambda graphs, num_given: False)
    monkeypatch.setattr(completing, "_drawn", cut_off)
    monkeypatch.setattr(completing, "consensus", first)
    [[made]] = complete(MODEL, stop_at(11), [SCENE], candidates=3)
    assert all(one is seen[row].graph for one, row in zip(voted, voters, strict=True))
    assert made.halt_reason == reasons[voters[0]]


def test_nodes_and_edges__are_sure_as_far_as_samples_agree():
    [[alone]] = complete(MODEL, stop_at(11), [SCENE], candidates=1)
    assert alone.node_confidence is None
    assert alone.edge_confidence is None
    for options in ({"samples": 4}, {"candidates": 4}):
        for made in complete(MODEL, stop_at(11), [SCENE], **options)[0]:
            assert made.node_confidence.shape == made.graph.nodes.label.shape
            assert made.edge_confidence.shape == (len(undirected_edges(made.graph, PART_OF)),)
            assert (made.node_confidence[:NUM_PLANES] == 1).all()
            assert (made.node_confidence[NUM_PLANES:] < 1).all()
            # Every sample has a room of the first two planes.
            assert made.node_confidence[NUM_PLANES] > 0.9


def test_what_was_given_and_grown__is_named_by_concept():
    known = subgraph(SCENE, np.r_[0:8, 9])  # the planes and a room
    [[completion]] = complete(MODEL, stop_at(13), [known], keep=True)
    assert {name: rows.tolist() for name, rows in completion.observed.items()} == {
        "plane": [*range(8)]
    }
    assert {name: rows.tolist() for name, rows in completion.kept.items()} == {"room": [8]}
    assert list(completion.grown) == ["room"]
    assert completion.grown["room"].tolist() == [*range(9, len(completion.graph.nodes.label))]
    [[completion]] = complete(MODEL, stop_at(13), [known])
    assert completion.kept == {}
    assert completion.grown["room"][0] == 8


def test_a_scene_too_large_for_any_bucket__is_refused_by_name():
    many = planes(
        np.random.default_rng(0).uniform(0, 90, (1200, 3)),
        np.tile([[1.0, 0.0, 0.0]], (1200, 1)),
        np.ones(1200),
    )
    with pytest.raises(ValueError, match=r"^scene 1: there are 1200 planes, .* at most 1133"):
        complete(MODEL, NEVER, [SCENE, many])


@pytest.mark.parametrize("option", ["samples", "candidates", "lanes"])
def test_numbers_below_one__are_refused(option):
    with pytest.raises(ValueError, match=f"{option} is 0, expected at least 1"):
        complete(MODEL, NEVER, [SCENE], **{option: 0})
    with pytest.raises(ValueError, match=f"{option} is -1, expected at least 1"):
        complete(MODEL, NEVER, [SCENE], **{option: -1})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 1.5}, r"the seed is 1\.5, a float, expected a whole number, at least 0"),
        ({"seed": -1}, "the seed is -1, expected at least 0"),
        (
            {"seed": jax.random.key(3)},
            "the seed is Array.*, a PRNGKeyArray, expected a whole number, at least 0",
        ),
        ({"samples": 1.5}, r"samples is 1\.5, a float, expected a whole number, at least 1"),
        ({"lanes": "2"}, "lanes is '2', a str, expected a whole number, at least 1"),
        ({"max_steps": 0}, "max_steps is 0, expected 1 to 2147483647"),
        ({"max_steps": 2**31}, "max_steps is 2147483648, expected 1 to 2147483647"),
        ({"names": ["a"]}, "there are 1 names of 2 scenes, expected as many"),
        ({"numbers": [5]}, "there are 1 numbers of 2 scenes, expected as many"),
        ({"numbers": [1, -1]}, "a number of a scene is -1, expected 0 to 4294967295"),
    ],
)
def test_what_is_no_argument__is_refused_before_anything_is_begun(options, message):
    with unchecked(), pytest.raises(ValueError, match=f"^{message}$"):
        complete_each(MODEL, NEVER, [SCENE, SCENE], **options)


def test_whole_numbers_of_any_library__are_taken():
    expected = complete(MODEL, stop_at(11), [SCENE], 3, samples=2, max_steps=50)
    options = {"samples": jnp.int8(2), "max_steps": np.uint64(50), "lanes": np.array(1)}
    for one, other in zip(
        complete(MODEL, stop_at(11), [SCENE], jnp.int32(3), **options)[0], expected[0], strict=True
    ):
        assert same(one, other)


@pytest.mark.parametrize("kind", ["float32", "float16", "bfloat16"])
def test_parameters_that_are_not_finite__are_refused(kind):
    params = stop_at(11)._replace(fill={"a": jnp.zeros(2), "b": [jnp.full(3, jnp.nan, kind)]})
    with pytest.raises(ValueError, match=r"^the parameters fill/b/0 are not all finite, expected"):
        complete_each(MODEL, params, [SCENE])


@pytest.mark.parametrize("model", [MODEL, ORACLE])
def test_parameters_that_are_none__are_refused(model):
    with pytest.raises(ValueError, match=r"^the parameters are (None|a NoneType), expected"):
        complete_each(model, None, [SCENE])


def test_parameters_of_another_model__are_refused():
    with pytest.raises(ValueError, match=r"^the parameters .* have the shape .* of this model$"):
        complete(CLASSIFIERS[1], sure_params(CLASSIFIERS[0]), [SCENE])


def test_weights_that_are_loaded_twice__are_compiled_once(tmp_path):
    """Whatever takes the model as static, as growing does, and the parameters as arrays."""
    path = untrained_weights(tmp_path, "midi")
    compiled = jax.jit(lambda model, params: params, static_argnums=0)
    for _ in range(2):
        trained = load_weights(path)
        compiled(trained.model, trained.params)
    assert compiled._cache_size() == 1
