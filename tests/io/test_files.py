import json

import pytest

from sg3d_jax.io.files import read_documents, replacing, write_document, write_documents


def test_a_file_appears_only_when_it_is_whole(tmp_path):
    path = tmp_path / "graph.json"
    with replacing(path) as temporary:
        temporary.write_text("half")
        assert not path.exists()
        assert temporary.parent == path.parent
        assert temporary.suffix == path.suffix
    assert path.read_text() == "half"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "graph.json"
    path.write_text("old")

    def fail():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(ValueError, match="which is no folder, expected the name of a file"):
        write_document(tmp_path / "nowhere" / "graph.json", {})
    with pytest.raises(ValueError, match="is a folder, expected the name of a file"):
        write_document(tmp_path, {})


def test_a_document_is_written_one_object_a_line_and_reads_back(tmp_path):
    document = {"nodes": [{"id": 0}, {"id": 1}], "edges": [[0, 1]], "seed": 3, "none": []}
    write_document(tmp_path / "a.json", document)
    text = (tmp_path / "a.json").read_text()
    assert '{"id": 0},\n' in text
    assert json.loads(text) == document


def test_lines_are_named_by_their_number_and_empty_ones_skipped(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text('{"a": 1}\n\n{"a": 2}\n')
    assert read_documents(path) == [(f"{path}: line 1", {"a": 1}), (f"{path}: line 3", {"a": 2})]


def test_documents_are_written_one_a_line(tmp_path):
    write_documents(tmp_path / "a.jsonl", [{"a": [{"b": 1}]}, {}])
    assert (tmp_path / "a.jsonl").read_text() == '{"a": [{"b": 1}]}\n{}\n'


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.json", b"", "not JSON at line 1 column 1"),
        ("a.json", b'{"a": 1}\n{"a": 2}', "not JSON at line 2 column 1"),
        ("a.jsonl", b'{"a": 1}\n{"a": ', "line 2: not JSON at line 1 column 7"),
        ("a.jsonl", b"\n \n", "the file is empty"),
        ("a.json", b"\xff\xfe", "byte 0 is not UTF-8, expected a text file"),
        ("a.json", b"[" * 100_000, "not JSON that can be read"),
        ("a.json", b"9" * 5000, "not JSON that can be read"),
        ("a.txt", b"{}", r"the name ends in '.txt', expected .json or .jsonl"),
    ],
)
def test_a_broken_file_is_refused_in_one_sentence(tmp_path, name, content, sentence):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=sentence) as caught:
        read_documents(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"none\.json: No such file or directory, expected a file"):
        read_documents(tmp_path / "none.json")
