import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.flagg.ordering import grown_layers, insertion_rank
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import Capacity
from tests import own_world
from tests.two_rooms import CAPACITY, on_device, with_garbage

CONCEPTS = PAPER_ONTOLOGY.names
OTHER_LAYERS = ("plane", "floor", "room", "wall", "building", "city")


def scattered(seed, num_nodes=12):
    """Nodes of all kinds in any order, planes among them."""
    rng = np.random.default_rng(seed)
    label = rng.choice([PLANE, WALL, ROOM, FLOOR], num_nodes)
    position = rng.normal(0, 5, (num_nodes, 3))
    return make_graph(label, position, np.zeros((num_nodes, 3)), np.zeros(num_nodes), [])


def ranks_of(ordering, layers=CONCEPTS):
    @jax.jit
    def ranks(graph, keys):
        return jax.vmap(lambda key: insertion_rank(graph, key, ordering, layers))(keys)

    def of_seed(graph, seed, number=3):
        return np.asarray(ranks(graph, jax.random.split(jax.random.key(seed), number)))

    return of_seed


RANKS = {
    (ordering, layers): ranks_of(ordering, layers)
    for ordering in ("H", "HP")
    for layers in (CONCEPTS, OTHER_LAYERS)
}


@given(seed=st.integers(0, 10_000), num_nodes=st.integers(1, CAPACITY.nodes))
@settings(deadline=None, max_examples=10)
@pytest.mark.parametrize(("ordering", "layers"), list(RANKS))
def test_ranks__number_the_layers_one_after_the_other(ordering, layers, seed, num_nodes):
    graph = scattered(seed, num_nodes)
    label, high = graph.nodes.label, graph.nodes.label != PLANE
    for rank in RANKS[ordering, layers](on_device(graph), seed):
        assert (rank[num_nodes:] == CAPACITY.nodes).all()
        real = rank[:num_nodes]
        assert (real[~high] == -1).all()
        assert sorted(real[high]) == list(range(high.sum()))
        place = np.array([layers.index(concept) for concept in CONCEPTS])
        assert (np.diff(place[label[high]][np.argsort(real[high])]) >= 0).all()


def test_h__is_uniform_inside_a_layer():
    graph = make_graph(
        [WALL, ROOM, ROOM, ROOM], np.zeros((4, 3)), np.zeros((4, 3)), np.zeros(4), []
    )
    rank = RANKS["H", CONCEPTS](on_device(graph), 0, 6000)[:, :4]
    orders, counts = np.unique(rank, axis=0, return_counts=True)
    assert len(orders) == 6
    assert (orders[:, 0] == 0).all()
    np.testing.assert_allclose(counts / 6000, np.full(6, 1 / 6), atol=0.02)


def test_hp__goes_outwards_from_a_random_node_of_each_layer():
    graph = scattered(0)
    label, position = graph.nodes.label, graph.nodes.position
    ranks = RANKS["HP", CONCEPTS](with_garbage(on_device(graph), 0), 1, 400)[:, :12]
    for concept in (WALL, ROOM, FLOOR):
        members = np.flatnonzero(label == concept)
        assert len(members) > 1
        starts = set()
        for rank in ranks:
            order = members[np.argsort(rank[members])]
            distance = np.linalg.norm(position[members] - position[order[0]], axis=-1)
            assert order.tolist() == members[np.argsort(distance)].tolist()
            starts.add(order[0])
        assert starts == set(members)


def test_hp__draws_between_nodes_at_the_same_place():
    graph = make_graph([ROOM, ROOM], np.ones((2, 3)), np.zeros((2, 3)), np.zeros(2), [])
    rank = RANKS["HP", CONCEPTS](on_device(graph), 2, 400)[:, 0]
    np.testing.assert_allclose(np.mean(rank == 0), 0.5, atol=0.1)


def test_concepts_of_every_name_have_a_layer():
    graph = make_graph(range(len(CONCEPTS)), np.zeros((6, 3)), np.zeros((6, 3)), np.zeros(6), [])
    rank = RANKS["H", OTHER_LAYERS](on_device(graph), 3)[0]
    assert [OTHER_LAYERS[1 + place] for place in rank[1:6]] == list(CONCEPTS[1:])
    assert np.issubdtype(rank.dtype, np.integer)


@pytest.mark.parametrize("ordering", ["H", "HP"])
@pytest.mark.parametrize("layers", [(), ("floor", "wall", "flat", "room")])
def test_ranks__are_of_what_grows_in_any_ontology(ordering, layers):
    scene = own_world.own_world()
    ranks = ranks_of(ordering, layers)(on_device(scene, Capacity(24, 288)), 4)
    label, names = scene.nodes.label, own_world.ONTOLOGY.names
    given = np.isin(label, [own_world.PLANE, own_world.PILLAR])
    order = grown_layers(own_world.ONTOLOGY, layers)
    for rank in ranks:
        assert (rank[: len(label)][given] == -1).all()
        assert (rank[len(label) :] == 24).all()
        high = rank[: len(label)][~given]
        assert sorted(high) == list(range((~given).sum()))
        place = np.array([order.index(names[concept]) for concept in label[~given]])
        assert (np.diff(place[np.argsort(high)]) >= 0).all()


@pytest.mark.parametrize(
    ("layers", "expected"),
    [
        ((), ["wall", "room", "flat", "floor"]),
        (("floor", "wall", "room", "flat"), ["floor", "wall", "room", "flat"]),
        (("plane", "floor", "pillar", "wall", "room", "flat"), ["floor", "wall", "room", "flat"]),
    ],
)
def test_layers__may_name_what_is_observed_or_leave_it_out(layers, expected):
    assert grown_layers(own_world.ONTOLOGY, layers) == expected


@pytest.mark.parametrize(
    "layers",
    [
        ("wall", "room", "flat"),
        ("wall", "room", "flat", "floor", "floor"),
        ("wall", "room", "flat", "building"),
        ("wall", "room", "flat", "floor", "building"),
        ("plane", "pillar"),
    ],
    ids=["missing", "twice", "another", "one too many", "observed alone"],
)
def test_layers__name_each_concept_that_grows_once(layers):
    expected = r"flagg\.layers must name each of wall, room, flat, floor once, got " + layers[0]
    with pytest.raises(ValueError, match=expected):
        grown_layers(own_world.ONTOLOGY, layers)
