import dataclasses

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.data.splits import split
from sg3d_jax.io import npz
from sg3d_jax.scene.graph import parts_first, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, pad, unpad
from sg3d_jax.scene.proximity import connect_observed
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split, stack_by_size, stacks_like, training_graphs

CAPACITIES = (20, 32, 136)
PARTS = ("train", "validation", "test")


@pytest.fixture(scope="module")
def floors():
    """Floors of fewer than 32 nodes: two of the three buckets."""
    graphs = registry.make("s-f-square", 30)
    return [graph for graph in graphs if len(graph.nodes.label) <= CAPACITIES[1]][:8]


@pytest.fixture(scope="module")
def stacks(floors):
    return on_host(stack_by_size(floors, CAPACITIES))


def on_host(stacks):
    return jax.tree.map(np.asarray, stacks)


def members(stacks):
    """Returns the padded graphs of every stack."""
    return [
        [jax.tree.map(lambda leaf, i=i: leaf[i], stack) for i in range(len(stack[5]))]
        for stack in stacks
    ]


def test_every_graph_is_in_the_smallest_bucket_that_holds_it_once(floors, stacks):
    sizes = [len(graph.nodes.label) for graph in floors]
    expected = [
        [graph for graph, size in zip(floors, sizes, strict=True) if low < size <= high]
        for low, high in ((0, 20), (20, 32))
    ]
    assert [stack.nodes.label.shape[1] for stack in stacks] == [20, 32]
    for inside, wanted in zip(members(stacks), expected, strict=True):
        for padded, graph in zip(inside, wanted, strict=True):
            npt.assert_array_equal(unpad(padded).nodes.label, graph.nodes.label)
            npt.assert_allclose(unpad(padded).nodes.position, graph.nodes.position, rtol=1e-6)
            npt.assert_array_equal(
                undirected_edges(unpad(padded), PART_OF), undirected_edges(graph, PART_OF)
            )


def test_proximity_edges_are_those_of_the_graph_alone(floors, stacks):
    connect = jax.jit(connect_observed)
    alone = {
        graph.nodes.position.astype(np.float32).tobytes(): undirected_edges(
            connect(jax.tree.map(jax.numpy.asarray, pad(graph, Capacity(64, 768)))), PROXIMITY
        )
        for graph in floors[:3]
    }
    padded = [graph for inside in members(stacks) for graph in inside]
    seen = {unpad(g).nodes.position.astype(np.float32).tobytes(): g for g in padded}
    for positions, edges in alone.items():
        npt.assert_array_equal(undirected_edges(seen[positions], PROXIMITY), edges)
        assert len(edges)


def test_edge_slots_hold_every_edge_and_few_more(stacks):
    for stack in stacks:
        slots = stack.senders.shape[1]
        needed = int(stack.n_edge[:, 0].max())
        assert needed <= slots < needed + 32
        npt.assert_array_equal(stack.n_edge.sum(axis=1), slots)
        npt.assert_array_equal(stack.edges.mask.sum(axis=1), stack.n_edge[:, 0])


def test_larger_graphs_get_further_buckets_each_twice_as_large(floors):
    large = [graph for graph in floors if len(graph.nodes.label) > CAPACITIES[0]]
    (stack,) = stack_by_size(large, (4, 8))
    assert stack.nodes.label.shape == (len(large), 32)


def test_other_graphs_are_stacked_in_the_same_shapes(floors, stacks):
    """Of too many some are left out, of too few some come twice, those too large are counted."""
    spare = on_host(stack_by_size(floors, CAPACITIES, spare=0.5))
    for one, wide in zip(stacks, spare, strict=True):
        assert wide.senders.shape[1] > 1.3 * one.senders.shape[1]
        npt.assert_array_equal(wide.n_edge.sum(axis=1), wide.senders.shape[1])
    again, too_large = stacks_like(floors, stacks)
    assert too_large == 0
    for one, other in zip(*map(jax.tree.leaves, (again, stacks)), strict=True):
        npt.assert_array_equal(one, other)
    small = [graph for graph in floors if len(graph.nodes.label) <= 20]
    count, given = len(small), [*small[:4], *small]
    many, _ = stacks_like(given, spare)
    assert jax.tree.map(jax.numpy.shape, many) == jax.tree.map(jax.numpy.shape, spare)
    assert firsts(many[0]) == [first(given[row * (count + 4) // count]) for row in range(count)]
    npt.assert_array_equal(many[1].nodes.position, spare[1].nodes.position)  # there are no others
    few, _ = stacks_like(small[:3], spare)
    assert firsts(few[0]) == [first(small[row * 3 // count]) for row in range(count)]


def first(graph):
    """Returns the position of the first node, which no other graph has."""
    return tuple(graph.nodes.position[0].astype(np.float32).tolist())


def firsts(stack):
    return [tuple(position) for position in np.asarray(stack.nodes.position[:, 0]).tolist()]


def test_graphs_without_room_for_their_edges_are_counted(floors, stacks):
    narrow = [
        stack._replace(senders=stack.senders[:, : int(stack.n_edge[:, 0].min())])
        for stack in stacks
    ]
    made, too_large = stacks_like(floors, narrow)
    made = on_host(made)
    slots = [stack.senders.shape[1] for stack in narrow]
    fit = [(stack.n_edge[:, 0] <= most).sum() for stack, most in zip(stacks, slots, strict=True)]
    assert too_large == len(floors) - sum(fit) > 0
    for stack, most in zip(made, slots, strict=True):
        npt.assert_array_equal(stack.n_edge.sum(axis=1), most)
        npt.assert_array_equal(stack.edges.mask.sum(axis=1), stack.n_edge[:, 0])
    _, too_large = stacks_like(floors, stacks[:1])
    assert too_large == len(stacks[1].n_edge)


def test_edge_classifiers_are_refused_more_than_a_floor(tmp_path, monkeypatch):
    npz.save(tmp_path / "a.npz", registry.make("s-b", 10), registry.header("s-b"))
    monkeypatch.setattr(registry, "make", None)  # a name is refused before its graphs are made
    for name, top in (("s-c", "city"), ("m-b", "building"), (str(tmp_path / "a.npz"), "building")):
        with pytest.raises(ValueError, match=f"{name} reaches up to a {top}, .* because ec-square"):
            load_split(DataConfig(name), "train", "midi", "ec-square")
    assert len(load_split(DataConfig(str(tmp_path / "a.npz")), "train", "midi", "rand")) == 5


def test_a_set_that_is_made_from_a_file_is_refused_with_the_command():
    with pytest.raises(ValueError, match=r"p-f is made of a file .* `sg3d data import p-f FILE"):
        load_split(DataConfig("p-f"), "test")


def test_parts_share_no_graph_and_leave_none_out():
    config = DataConfig("s-f-square", num_graphs=12)
    parts = {part: [g.nodes.position.tobytes() for g in load_split(config, part)] for part in PARTS}
    assert [len(parts[part]) for part in PARTS] == [6, 1, 5]  # of 2400 graphs, the first twelve
    everything = {graph.nodes.position.tobytes() for graph in registry.make("s-f-square", 12)}
    assert set().union(*parts.values()) == everything
    assert len(everything) == 12


def test_the_first_graphs_of_a_set_are_for_the_same_parts_as_in_the_whole_of_it():
    graphs = registry.make("s-f-square", 60)
    chosen = load_split(DataConfig("s-f-square", num_graphs=60), "test")
    of_whole = [graphs[index] for index in split(2400).test if index < 60]
    for one, other in zip(chosen, of_whole, strict=True):
        npt.assert_array_equal(one.nodes.position, other.nodes.position)


def test_a_file_is_split_as_the_data_set_of_its_name(tmp_path):
    npz.save(tmp_path / "a.npz", registry.make("s-f", 12), registry.header("s-f"))
    by_name = DataConfig("s-f", num_graphs=10)
    by_path = dataclasses.replace(by_name, name=str(tmp_path / "a.npz"))
    for part in PARTS:
        for one, other in zip(load_split(by_name, part), load_split(by_path, part), strict=True):
            npt.assert_array_equal(one.nodes.position, other.nodes.position)


def test_seeds_change_the_graphs_and_how_they_are_dealt():
    config = DataConfig("s-f-square", num_graphs=12)
    widths = {
        tuple(load_split(chosen, "train")[0].nodes.width)
        for chosen in (
            config,
            dataclasses.replace(config, seed=1),
            dataclasses.replace(config, split_seed=1),
        )
    }
    assert len(widths) == 3


def test_several_sets_are_mixed_and_take_turns():
    """Each has its own number of graphs; one that is named twice is trained on twice."""
    mixed = DataConfig("s-f-square:10+s-f+s-f-square:10", num_graphs=15)
    one, other = (registry.make(name, number) for name, number in (("s-f-square", 10), ("s-f", 15)))
    assert len(load_split(mixed, "all")) == 25
    trained_on = [graph.nodes.position.tobytes() for graph in training_graphs(mixed)]
    assert len(trained_on) == 6 + 9 + 6
    assert trained_on[:6] == trained_on[-6:]
    assert trained_on[6:15] == [
        graph.nodes.position.tobytes()
        for graph in load_split(DataConfig("s-f", num_graphs=15), "train")
    ]
    first, second = load_split(mixed, "all")[:2]
    npt.assert_array_equal(first.nodes.position, one[0].nodes.position)
    npt.assert_array_equal(second.nodes.position, other[0].nodes.position)
    assert mixed.label == "s-f-square:10+s-f+s-f-square:10"
    assert dataclasses.replace(mixed, title="mixed").label == "mixed"


def test_sets_that_a_robot_sees_are_trained_on_in_other_views_and_in_pieces():
    config = DataConfig("s-f:10@merged+s-f:10@robot+s-f:10@robot", views=2)
    graphs = training_graphs(config)
    assert len(graphs) == 3 * 2 * 5
    merged, seen = graphs[:5], [graph.nodes.position.tobytes() for graph in graphs[10:]]
    assert len(set(seen)) == 20  # no view comes twice
    for graph in merged:  # no piece bounds two rooms
        planes_of_rooms = [part for part, whole in parts_first(graph) if _is_room(graph, whole)]
        assert len(planes_of_rooms) == len(set(planes_of_rooms))
    shared = load_split(DataConfig("s-f:10@merged"), "train")  # as they are seen
    assert sum(len(graph.nodes.label) for graph in shared) < sum(map(_size, merged))
    with pytest.raises(ValueError, match="s-f has no view 'nothing', expected one of robot"):
        training_graphs(DataConfig("s-f:10@nothing"))


def _is_room(graph, node):
    return graph.nodes.label[node] == ROOM


def _size(graph):
    return len(graph.nodes.label)
