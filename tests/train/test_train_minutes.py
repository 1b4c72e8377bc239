"""What is asked of a training on a clock, and the graphs that it takes."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.train_minutes import configured, kinds_alone, mostly_several
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import PLANE, ROOM


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
        "often": "unit",
        "views": 1,
        "capacities": [96],
        "batch": 4,
    }
    config, own = configured(given), configured({"config": "midi-furnished"})
    assert (own.flagg.often, own.data.views, own.batch) == ("", 2, 16)
    assert (config.flagg.often, config.data.views, config.batch) == ("unit", 1, 4)
    assert config.capacities == (96,)
    assert (config.data.name, config.batch_nodes) == (own.data.name, own.batch_nodes)


def test_kinds_alone_of_what_grows_none__are_refused():
    with pytest.raises(SystemExit, match=r"^--only kinds: what this configuration grows has no "):
        kinds_alone(SimpleNamespace(kinds=None))


def test_cuts_of_what_does_not_grow__are_refused():
    with pytest.raises(SystemExit, match=r"^--often: ec-l does not grow, nothing is cut$"):
        configured({"config": "ec-l-s-f", "often": "room"})
