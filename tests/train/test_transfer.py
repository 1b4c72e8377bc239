"""Weights of some concepts in a model of others: it computes the same of what both know."""

import dataclasses
import functools

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.flagg.halt import Halt
from sg3d_jax.flagg.kinds import Kinds
from sg3d_jax.flagg.placement import Placement
from sg3d_jax.nn.apply import apply
from sg3d_jax.scene.graph import features_of, make_graph, undirected_edges
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF, PROXIMITY
from sg3d_jax.train.methods import build_model
from sg3d_jax.train.transfer import transferred
from tests.furnished_rooms import OBJECT, furnished_rooms
from tests.tiny_run import MODELS, read_config, untrained_model
from tests.two_rooms import STATISTICS, on_device, random_params, two_rooms

PLACES = np.array([FURNISHED_ONTOLOGY.label_of(name) for name in PAPER_ONTOLOGY.names])
LABEL = np.array([2, 1])  # of a block
EDGES = np.zeros((2, 2 + 16), np.int32)
EDGES[[0, 1], [4, 6]] = 1
said = jax.jit(apply, static_argnums=0)
carry = jax.jit(transferred, static_argnums=(1, 3))


def relabelled(graph):
    """Returns a graph of the paper's concepts as one of furnished scenes."""
    return make_graph(
        PLACES[graph.nodes.label],
        graph.nodes.position,
        **features_of(graph),
        part_of=undirected_edges(graph, PART_OF),
        proximity=undirected_edges(graph, PROXIMITY),
        ontology=FURNISHED_ONTOLOGY,
    )


def told(model, params, graph, label):
    """Returns all that a model says of a graph and of a block of two nodes, labels first."""
    fill, block, time = params.fill, np.ones(2, bool), np.float32(9)
    known = said(model.fill.encoder, fill["encoder"], graph)
    if "denoiser" in fill:
        inputs = known, np.zeros(3, "f"), block, label, EDGES, np.ones((2, 3), "f"), time
        others = said(model.fill.network, fill["denoiser"], *inputs)
    else:
        drawn = said(model.fill.topology, fill["topology"], known, block, label, EDGES, time)
        inputs = known, label, EDGES == 1, EDGES.astype("f"), time
        others = *drawn, said(model.fill.lengths, fill["distance"], *inputs)
    judged = judgements(model.insert, model.halt, params.insert, params.halt, graph)
    return *others, known.nodes, *judged


@functools.partial(jax.jit, static_argnums=(0, 1))
def judgements(insert, halt, params_of_insert, params_of_halt, graph):
    return insert.logits(params_of_insert, graph), halt.logit(params_of_halt, graph)


@pytest.mark.parametrize("method", ["midi", "fd4"])
def test_a_model_says_the_same_of_concepts_that_it_knew(method):
    model, flagg = untrained_model(method), read_config("test").flagg
    statistics = STATISTICS._replace(label=(0.1,) * FURNISHED_ONTOLOGY.num_concepts)
    other = build_model(MODELS[method], flagg, statistics, FURNISHED_ONTOLOGY)
    graph, again = on_device(two_rooms()), on_device(relabelled(two_rooms()))
    params = random_params(model.init, graph)
    fresh = random_params(other.init, again, seed=1)
    carried = carry(params, PAPER_ONTOLOGY, fresh, FURNISHED_ONTOLOGY)
    label, *expected = told(model, params, graph, LABEL)
    found, *others = told(other, carried, again, PLACES[LABEL])
    npt.assert_allclose(np.asarray(found)[:, PLACES], label, atol=1e-5)
    for one, same in zip(others, expected, strict=True):
        npt.assert_allclose(one, same, atol=1e-5)
    assert found.shape[1] == FURNISHED_ONTOLOGY.num_concepts
    jax.tree.map(npt.assert_array_equal, carried.kinds, fresh.kinds)  # it had no such module


def test_where_grown_nodes_stand_is_learnt_anew():
    places = Placement(4, 2, 1)
    one, other = (
        {"placement": random_params(places.init, graph, seed=seed)}
        for seed, graph in enumerate([on_device(two_rooms()), on_device(furnished_rooms())])
    )
    carried = carry(one, PAPER_ONTOLOGY, other, FURNISHED_ONTOLOGY)
    jax.tree.map(npt.assert_array_equal, carried, other)
    jax.tree.map(npt.assert_array_equal, carry({}, PAPER_ONTOLOGY, one, PAPER_ONTOLOGY), one)


def with_kinds(*kinds):
    """Returns the concepts of furnished scenes with other kinds of objects."""
    concepts = list(FURNISHED_ONTOLOGY.concepts)
    concepts[OBJECT] = dataclasses.replace(concepts[OBJECT], kinds=kinds)
    return dataclasses.replace(FURNISHED_ONTOLOGY, concepts=tuple(concepts))


def graph_of(ontology):
    return on_device(furnished_rooms()._replace(globals=ontology))


def test_kinds_of_what_is_observed_go_by_their_names():
    known, ontology = with_kinds("bed", "desk"), with_kinds("bed", "lamp", "desk")
    params = random_params(Halt(4, 1).init, graph_of(known))
    fresh = random_params(Halt(4, 1).init, graph_of(ontology), seed=1)
    carried = carry(params, known, fresh, ontology)
    before, after = (
        np.asarray(of["params"]["gine"]["nodes"]["kernel"]) for of in (params, carried)
    )
    npt.assert_array_equal(after[-3], before[-2])
    npt.assert_array_equal(after[-2], np.zeros(4))  # nothing is known of lamps
    npt.assert_array_equal(after[-1], before[-1])
    npt.assert_array_equal(after[:-3], before[:-2])


def test_kinds_of_what_is_grown_go_by_their_places():
    known, concepts = FURNISHED_ONTOLOGY, list(FURNISHED_ONTOLOGY.concepts)
    room = concepts[known.label_of("room")]
    concepts[known.label_of("room")] = dataclasses.replace(room, kinds=(*room.kinds, "attic"))
    ontology = dataclasses.replace(known, concepts=tuple(concepts))
    params, fresh = (
        {"kinds": random_params(Kinds(4, 1, of).init, graph_of(of), seed=seed)}
        for seed, of in enumerate((known, ontology))
    )
    (kernel, bias), (new_kernel, new_bias), (_, fresh_bias) = (
        [np.asarray(of["kinds"]["params"]["logits"][name]) for name in ("kernel", "bias")]
        for of in (params, carry(params, known, fresh, ontology), fresh)
    )
    npt.assert_array_equal(new_kernel[:, :12], kernel)
    npt.assert_array_equal(new_bias[:12], bias)
    npt.assert_array_equal(new_bias[12], fresh_bias[12])


def test_a_layer_of_another_width_is_refused():
    graph = graph_of(FURNISHED_ONTOLOGY)
    params, fresh = (random_params(Halt(width, 1).init, graph) for width in (4, 6))
    with pytest.raises(ValueError, match=r"'\] is \[.*4\], expected \[.*6\]$"):
        transferred(params, FURNISHED_ONTOLOGY, fresh, FURNISHED_ONTOLOGY)


def test_a_module_that_only_one_has_is_refused():
    params = random_params(Halt(4, 1).init, graph_of(FURNISHED_ONTOLOGY))
    one, both = {"halt": params}, {"halt": params, "insert": params}
    for given, fresh in ((one, both), (both, one)):
        with pytest.raises(
            ValueError, match=r"^\['insert'\].* is of one model alone, expected the"
        ):
            transferred(given, FURNISHED_ONTOLOGY, fresh, FURNISHED_ONTOLOGY)
