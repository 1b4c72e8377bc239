"""`sg3d weights`, and what `sg3d complete` says of a scene that no training scene was like."""

import json
import shutil

import jax
import pytest

from sg3d_jax.train import DEFAULT_WEIGHTS
from sg3d_jax.train.card import Card, Score
from sg3d_jax.train.weights import load_weights, names, save_weights
from tests.command_line import SCENES, run, write
from tests.tiny_run import ROOT, untrained_weights

CARD = Card(7, {"number": (4.0, 5.0), "extent": (1.0, 50.0)}, (Score("s-f", 3, 0.25, 0.5),), "once")


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    """Files by relative names, and no check that a vmapped scan fails."""
    monkeypatch.chdir(tmp_path)
    with jax.debug_key_reuse(False):
        yield


def with_card(folder, card):
    path = untrained_weights(folder, "ec-square")
    trained = load_weights(path)
    return str(save_weights(path, trained.config, trained.statistics, trained.params, card))


def test_weights_are_listed_with_what_they_were_trained_on(tmp_path, capsys):
    path = with_card(tmp_path, CARD)
    shutil.copy(path, "w.npz")
    run("weights", "w.npz")
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for text in ("w.npz", "7 graphs", "once", "4 to 5 planes", "1 to 50 m across", "s-f: 0.2500"):
        assert text in said


def test_all_weights_of_the_package_have_a_card_with_scores(capsys):
    for name in names():
        card = load_weights(name).card
        assert card is not None, name
        assert card.graphs > 100
        assert card.ranges.keys() == {"number", "extent", "width", "thickness"}
        assert card.scores, name
    assert DEFAULT_WEIGHTS in names()
    assert load_weights().name == DEFAULT_WEIGHTS


def test_the_cards_in_the_documentation_are_those_of_the_weights(tmp_path):
    run("weights", "-o", "weights.md")
    written = (tmp_path / "weights.md").read_text()
    assert all(f"\n## {name}" in written for name in names())
    stale = "run `sg3d weights -o docs/weights.md`"
    assert written == (ROOT / "docs" / "weights.md").read_text(), stale


def test_a_scene_unlike_those_of_the_training_is_said_to_be(tmp_path, capsys):
    path = with_card(tmp_path, CARD)
    write("planes.json", SCENES[0])
    run("complete", "planes.json", "-o", "graph.json", "--weights", path)
    (remark, *_) = json.loads((tmp_path / "graph.json").read_text())["remarks"]
    count = len(SCENES[0]["planes"])
    assert remark == f"outside of what {path} was trained on: {count} planes (4 to 5 in training)"
    assert f"planes.json: {remark}" in capsys.readouterr().err
