"""A few changed files of every kind; `python -m tests.fuzz` tries as many as there is time for."""

import pytest

from tests.fuzz.files import kinds
from tests.fuzz.fuzzing import try_files

COUNT = 6  # of each kind
NAMES = (
    *("json.json", "json.jsonl", "networkx.json", "networkx.jsonl", "spark-dsg.json"),
    *("spark-dsg.jsonl", "a.graphml", "planes.json", "planes.csv", "columns.csv", "objects.json"),
    *("adjacency.json", "cytoscape.json", "multigraph.json", "d3.json", "places.json", "a.gexf"),
    *("message.json", "map.json", "printed.yaml", "old-map", "new-map", "hydra.json"),
    *("old-hydra.json", "into.json", "told.jsonl", "messages.jsonl", "graphs.npz", "theirs.pkl"),
    *("theirs.zip", "msd.csv", "plans.jsonl", "plans.jsonl.gz", "own.jsonl", "own-mm.jsonl"),
    *("result.json", "weights.npz"),
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return {kind.name: kind for kind in kinds(tmp_path_factory.mktemp("sound"))}


def test_every_kind_is_tried(files):
    assert tuple(files) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_sound_file_is_read(files, name, tmp_path):
    path = tmp_path / name
    path.write_bytes(files[name].content)
    files[name].read(path)


@pytest.mark.parametrize("name", NAMES)
def test_a_changed_file_is_refused_in_one_sentence_or_is_sound(files, name, tmp_path):
    report = try_files([files[name]], tmp_path, seed=0, first=0, count=COUNT)
    assert report.failures == []
    assert sum(report.outcomes.values()) == COUNT
