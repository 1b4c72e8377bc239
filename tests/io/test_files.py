import json
import os
import resource
import stat

import pytest

from sg3d_jax.io import files
from sg3d_jax.io.files import (
    TEMPORARY,
    read_bytes,
    read_documents,
    replacing,
    write_document,
    write_documents,
)


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


def test_content_is_on_the_disk_before_a_file_has_its_name_and_the_name_after(
    tmp_path, monkeypatch
):
    path, synced = tmp_path / "graph.json", []
    flush = lambda file: synced.append((stat.S_ISDIR(os.fstat(file).st_mode), path.exists()))
    monkeypatch.setattr(os, "fsync", flush)
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert synced == [(False, False), (True, True)]


def test_a_name_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(ValueError, match="which is no folder, expected the name of a file"):
        write_document(tmp_path / "nowhere" / "graph.json", {})
    with pytest.raises(ValueError, match="is a folder, expected the name of a file"):
        write_document(tmp_path, {})


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "there").mkdir()
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "there" / "graph.json")
    for content in ({"a": 1}, {"a": 2}):  # the first makes the file that the link names
        write_document(link, content)
        assert link.is_symlink()
        assert json.loads((tmp_path / "there" / "graph.json").read_text()) == content


def test_a_device_is_not_replaced(tmp_path):
    link = tmp_path / "null.json"
    link.symlink_to("/dev/null")
    with pytest.raises(ValueError, match=r"null\.json: is a device, expected the name of a file"):
        write_document(link, {})


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444])
def test_a_file_that_is_replaced_hands_down_its_mode(tmp_path, mode):
    path = tmp_path / "graph.json"
    path.write_text("{}")
    path.chmod(mode)
    with replacing(path) as temporary:
        assert temporary.stat().st_mode & 0o077 == 0
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o777 == mode


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path):
    name = "n" * 250 + ".json"
    write_document(tmp_path / name, {})
    assert [path.name for path in tmp_path.iterdir()] == [name]
    with pytest.raises(OSError, match=r"nn\.json.*[Nn]ame too long"):
        write_document(tmp_path / ("n" * 251 + ".json"), {})


def test_what_killed_processes_left_is_removed_and_what_others_write_is_not(tmp_path):
    left, young = tmp_path / f"{TEMPORARY}01234567.npz", tmp_path / f"{TEMPORARY}89abcdef.json"
    left.write_text("half")
    young.write_text("half")
    os.utime(left, (0, 0))
    write_document(tmp_path / "a.json", {})
    assert sorted(path.name for path in tmp_path.iterdir()) == [young.name, "a.json"]


def test_a_full_disk_is_told_also_if_the_writer_breaks_over_it(tmp_path):
    def write():
        with replacing(tmp_path / "a.pdf"):
            try:
                raise OSError(28, "No space left on device")
            finally:
                raise AttributeError

    with pytest.raises(OSError, match=r"a\.pdf: cannot be written \(No space left on device\)"):
        write()


def test_a_full_disk_is_told_with_the_name_of_the_file(tmp_path):
    path = tmp_path / "a.json"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"a\.json: cannot be written \(File too large\)"):
            write_document(path, {"a": "x" * 5000})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())


def test_what_has_no_end_is_not_read_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_DOCUMENT", 20)
    (tmp_path / "zero.json").symlink_to("/dev/zero")
    with pytest.raises(ValueError, match=r"zero\.json: the file is too large, expected 9 bytes"):
        read_bytes(tmp_path / "zero.json", 9)
    (tmp_path / "a.json").write_text(json.dumps(["x"] * 9))
    with pytest.raises(ValueError, match=r"a\.json: the document has 45 characters, expected 20"):
        list(read_documents(tmp_path / "a.json"))


def test_a_file_of_too_many_documents_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_GRAPHS", 2)
    (tmp_path / "a.jsonl").write_text("{}\n{}\n\n{}\n")
    with pytest.raises(ValueError, match=r"a\.jsonl: line 4: one too many, expected 2 documents"):
        list(read_documents(tmp_path / "a.jsonl"))


def test_a_document_is_written_one_object_a_line_and_reads_back(tmp_path):
    document = {"nodes": [{"id": 0}, {"id": 1}], "edges": [[0, 1]], "seed": 3, "none": []}
    write_document(tmp_path / "a.json", document)
    text = (tmp_path / "a.json").read_text()
    assert '{"id": 0},\n' in text
    assert json.loads(text) == document


def test_lines_are_named_by_their_number_and_empty_ones_skipped(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text('{"a": 1}\n\n{"a": 2}\n')
    read = list(read_documents(path))
    assert read == [(f"{path}: line 1", {"a": 1}), (f"{path}: line 3", {"a": 2})]


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
        ("a.json", b'{"a": 1, "b": 2, "a": 1}', "not JSON that can be read .the key 'a' is there"),
        (
            "a.jsonl",
            b'{}\n{"a": {"b": 1, "b": 2}}',
            "line 2: .*the key .b. is there twice",
        ),
        ("a.txt", b"{}", r"the name ends in '.txt', expected .json or .jsonl"),
    ],
)
def test_a_broken_file_is_refused_in_one_sentence(tmp_path, name, content, sentence):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=sentence) as caught:
        list(read_documents(path))
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"none\.json: No such file or directory, expected a file"):
        list(read_documents(tmp_path / "none.json"))
