import pytest

from sg3d_jax.io.formats import read_graphs, read_with_attributes

PLANE = """
- header: {{stamp: {{sec: 17, nanosec: 0}}, frame_id: map}}
  id: {0}
  nx: {1}
  ny: 0.0
  nz: 0.0
  d: 1.0
  plane_points:
  - x: {2}
    y: -1.0
    z: 0.5
  - x: {2}
    y: 2.0
    z: 0.5
  data_source: Online"""
MESSAGE = f"""header:
  frame_id: map
x_planes:{PLANE.format(4, 1.0, -1.0)}{PLANE.format(7, -1.0, 3.0)}
y_planes: []
"""


def write(tmp_path, text):
    (tmp_path / "planes.yaml").write_text(text)
    return tmp_path / "planes.yaml"


def test_printed_messages_are_read_one_after_the_other(tmp_path):
    reads = read_with_attributes(write(tmp_path, f"{MESSAGE}---\n{MESSAGE}---\n"))
    assert len(reads) == 2
    for read in reads:
        assert read.graph.nodes.width.tolist() == [3, 3]
        assert read.graph.nodes.position.tolist() == [[-1, 0.5, 0.5], [3, 0.5, 0.5]]
        assert read.attributes == [{"id": 4}, {"id": 7}]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "yaml: the file is empty, expected a message"),
        ("a: [", r"yaml: not YAML that can be read \("),
        ("x_planes: &a []\ny_planes: *a", "yaml: there is an alias, expected every value"),
        (MESSAGE.replace("y_planes: []", "y_planes:\n- '...'"), "lists were cut short, expected"),
        (f"{MESSAGE}---\nx_planes: 3\ny_planes: []\n", "yaml: message 1: x_planes is 3, expected"),
        ("a: 1", "yaml: the document has no key that tells what it is"),
        ("[" * 3000, "yaml: not YAML that can be read"),
        ("[" * 30000, "yaml: the file has 30000 brackets and braces, expected 20000"),
    ],
)
def test_another_file_is_refused_in_one_sentence(text, sentence, tmp_path):
    with pytest.raises(ValueError, match=sentence) as caught:
        read_graphs(write(tmp_path, text))
    assert "\n" not in str(caught.value)
