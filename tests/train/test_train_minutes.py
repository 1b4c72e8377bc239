"""What is asked of a training on a clock, and the graphs that it takes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.train_minutes import alone, configured, mostly_several
from sg3d_jax.flagg.step import FlaggConfig, make_flagg
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import PLANE, ROOM
from tests.growing_rooms import AddRooms, grows_rooms, stop_at
from tests.two_rooms import on_device, random_params, two_rooms

pytestmark = pytest.mark.slow


@dataclasses.dataclass(frozen=True)
class Wanted(AddRooms):
    """A Fill whose loss is its parameter."""

    def loss(self, params, key, graph, block):
        return params, {"w": params}


def with_rooms(number):
    return make_graph([PLANE] * 2 + [ROOM] * number, np.zeros((2 + number, 3)))


@pytest.mark.parametrize(
    ("others", "expected"),
    [
        ([0, 1, 1, 0, 1, 0], [2, 3, 5, 2, 0, 0]),  # six to four: every third of them
        ([1], [2, 3, 5, 2, 1]),
        ([], [2, 3, 5, 2]),
    ],
)
def test_two_graphs_of_three__have_several_of_a_concept(others, expected):
    graphs = [with_rooms(number) for number in [2, 3, *others, 5, 2]]
    assert [(g.nodes.label == ROOM).sum() for g in mostly_several(graphs, "room")] == expected


def test_what_is_given_at_the_shell__takes_the_place_of_what_is_configured():
    given = {
        "config": "midi-furnished",
        "views": 1,
        "capacities": [96],
        "batch": 4,
    }
    config, own = configured(given), configured({"config": "midi-furnished"})
    assert (own.data.views, own.batch) == (2, 16)
    assert (config.data.views, config.batch) == (1, 4)
    assert config.capacities == (96,)
    assert (config.data.name, config.batch_nodes) == (own.data.name, own.batch_nodes)


@pytest.mark.parametrize(
    ("only", "lacks"),
    [
        ("kinds", "has no kinds"),
        ("upper", r"has no upper layers \(flagg\.upper\)"),
        ("placement", r"has no placement \(flagg\.placement\)"),
    ],
)
def test_what_a_configuration_lacks__cannot_be_trained_alone(only, lacks):
    for model in (grows_rooms(1), AddRooms()):
        with pytest.raises(SystemExit, match=rf"^--only {only}: what .* grows {lacks}"):
            alone(model, only)


def test_the_upper_layers_alone__have_their_loss():
    model = make_flagg(FlaggConfig(coins=(1,), upper="floor"), Wanted())
    params, graph = stop_at(9)._replace(upper=jnp.float32(7)), on_device(two_rooms())
    loss, terms = alone(model, "upper").loss(params, jax.random.key(0), graph)
    assert (float(loss), {name: float(term) for name, term in terms.items()}) == (7, {"upper_w": 7})


def test_the_placement_alone__has_its_loss():
    model = make_flagg(FlaggConfig(coins=(1,), placement=(4, 2, 1)), AddRooms())
    graph, key = on_device(two_rooms()), jax.random.key(0)
    params = stop_at(9)._replace(placement=random_params(model.placement.init, graph))
    loss, terms = alone(model, "placement").loss(params, key, graph)
    expected, _ = model.placement_loss(params, key, graph)
    assert float(loss) == float(terms["placement"]) == float(expected) > 0
