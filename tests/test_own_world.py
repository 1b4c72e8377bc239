"""Graphs of a world of one's own, where those of the paper are wanted.

What such a world can do is in `tests/train/test_loop.py`.
"""

import pytest

from sg3d_jax.io import npz
from sg3d_jax.io.formats import write_graphs
from tests.command_line import run
from tests.own_world import own_world


def test_graphs_of_other_concepts_are_refused_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    npz.save("worlds.npz", [own_world()] * 10, {"name": "worlds"})
    with pytest.raises(SystemExit):
        run("train", "fd4-s-f", "--data.name", "worlds.npz")
    line = capsys.readouterr().err
    assert "graph 0 has the concepts plane, pillar, wall, room, flat, floor, expected" in line
    write_graphs("own.json", [own_world()])
    with pytest.raises(SystemExit):
        run("complete", "own.json", "-o", "grown.json")
    assert "own.json: its concepts are plane, pillar" in capsys.readouterr().err
