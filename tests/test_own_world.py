"""Concepts are data: a world of one's own, by a configuration alone, from training to every format.

Pillars are observed beside the planes; flats stand above the rooms. Nothing of the package knows.
"""

import json
import re
from pathlib import Path

import jax
import numpy as np
import pytest

from sg3d_jax.io import npz
from sg3d_jax.io.formats import read_graphs, write_graphs
from sg3d_jax.metrics.oddities import check
from sg3d_jax.scene.graph import observed_of, ontology_of
from sg3d_jax.scene.validate import validate_graph
from sg3d_jax.train import loop
from sg3d_jax.train.weights import load_weights
from tests.command_line import run
from tests.own_world import FLAT, NUM_OBSERVED, ONTOLOGY, PILLAR, own_world

CONFIGURATION = """
from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.scene.ontology import Concept, Ontology, Rule
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

ONTOLOGY = {ontology}

CONFIG = Config(
    data=DataConfig(name="worlds.npz"),
    ontology=ONTOLOGY,
    model=MiDiConfig(encoder_width=8, encoder_layers=1, gates=2, node_width=8, pair_width=8,
        layers=1, heads=2, noise_levels=1, kin=2, sampling_steps=2),
    flagg=FlaggConfig(coins=(1,), width=8, depth=1),
    optimiser=OptimiserConfig(warmup_steps=1),
    steps=4, steps_per_call=2, batch=2, capacities=(32,), validate_every=2, validation_graphs=1,
)
"""


def worlds(count=10):
    """Returns own worlds of different sizes."""
    graph = own_world()
    factors = np.linspace(0.8, 1.2, count)
    return [
        graph._replace(
            nodes=graph.nodes._replace(
                position=graph.nodes.position * factor, width=graph.nodes.width * factor
            )
        )
        for factor in factors
    ]


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    npz.save("worlds.npz", worlds(), {"name": "worlds"})
    with jax.debug_key_reuse(False):
        yield


@pytest.mark.slow
def test_a_world_of_ones_own_needs_a_configuration_alone(monkeypatch, capsys):
    Path("own.py").write_text(CONFIGURATION.format(ontology=repr(ONTOLOGY)))

    # Trained, cut short after its first checkpoint, and resumed.
    save = loop.checkpoint.save

    def save_and_stop(checkpoints, state, fgw):
        save(checkpoints, state, fgw)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(loop.checkpoint, "save", save_and_stop)
        with pytest.raises(SystemExit):
            run("train", "own.py")
    assert not Path("runs/own/weights.npz").exists()
    run("train", "own.py")
    trained = load_weights("runs/own/weights.npz")
    assert trained.config.ontology == trained.model.ontology == ONTOLOGY
    assert len(trained.statistics.label) == ONTOLOGY.num_concepts
    assert trained.statistics.label[FLAT] > 0 == trained.statistics.label[PILLAR]
    config = json.loads(Path("runs/own/config.json").read_text())
    assert [concept["name"] for concept in config["ontology"]["concepts"]] == [*ONTOLOGY.names]

    # Scored.
    run("evaluate", "runs/own/weights.npz", "--num-graphs", 2, "-o", "scores.json")
    scores = json.loads(Path("scores.json").read_text())["scores"]
    assert np.isfinite(scores["fgw"]["mean"])
    assert "recall, flat" in scores

    # Grown, from pillars and planes as a document holds them.
    write_graphs("observed.json", [observed_of(own_world())])
    run("complete", "observed.json", "-o", "grown.json", "--weights", "runs/own/weights.npz")
    (grown,) = read_graphs("grown.json")
    assert ontology_of(grown) == ONTOLOGY
    assert grown.nodes.observed.sum() == NUM_OBSERVED
    assert not ONTOLOGY.is_observed[grown.nodes.label[NUM_OBSERVED:]].any()
    validate_graph(grown, "grown.json", rules=False)
    validate_graph(own_world(), "own world")
    assert check([own_world()]) == []
    said = capsys.readouterr().out
    assert re.search(r"grown\.json: scene 0 sample 0: 12 planes, 2 pillars", said)

    # Drawn, and written in every format and read back.
    run("view", "grown.json", "-o", "grown.png")
    run("view", "grown.json", "-o", "grown.html")
    assert "flat" in Path("grown.html").read_text()
    for to, suffix in (
        ("json", "json"),
        ("networkx", "json"),
        ("spark-dsg", "json"),
        ("graphml", "graphml"),
        ("npz", "npz"),
    ):
        run("export", "grown.json", "-o", f"{to}.{suffix}", "--to", to)
        (back,) = read_graphs(f"{to}.{suffix}")
        assert ontology_of(back) == ONTOLOGY
        np.testing.assert_array_equal(back.nodes.label, grown.nodes.label)
        np.testing.assert_array_equal(back.nodes.position, grown.nodes.position)


def test_graphs_of_other_concepts_are_refused_by_name(capsys):
    npz.save("worlds.npz", worlds(), {"name": "worlds"})
    with pytest.raises(SystemExit):
        run("train", "fd4-s-f", "--data.name", "worlds.npz")
    line = capsys.readouterr().err
    assert "graph 0 has the concepts plane, pillar, wall, room, flat, floor, expected" in line
    write_graphs("own.json", [own_world()])
    with pytest.raises(SystemExit):
        run("complete", "own.json", "-o", "grown.json")
    assert "own.json: its concepts are plane, pillar" in capsys.readouterr().err
