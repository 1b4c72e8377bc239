import json
import re

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sg3d_jax.io.formats import read_graphs, read_planes, read_with_attributes, write_graphs
from sg3d_jax.io.planes import COLUMNS, planes, planes_from_dict, planes_to_dict, write_planes
from sg3d_jax.scene.graph import ontology_of
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE, Ontology
from sg3d_jax.scene.validate import validate_graph
from tests.own_world import ONTOLOGY

ROWS = (
    (0.1, 1 / 3, 2.7, 0.0, -1.0, 0.0, 4.000000000000001),
    (0.1, -1e-17, 2.7, 0.0, 1.0, 0.0, 4.0),
    (2.1, 0.5, 2.7, -1.0, 0.0, 0.0, 1.0),
)
SCENE = {
    "planes": [{"centroid": [*row[:3]], "normal": [*row[3:6]], "width": row[6]} for row in ROWS]
}
CSV = "\n".join([",".join(COLUMNS), *(",".join(map(repr, row)) for row in ROWS)]) + "\n"


def table(graph):
    return np.column_stack([graph.nodes.position, graph.nodes.normal, graph.nodes.width])


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refusal(path):
    with pytest.raises(ValueError, match=r"expected|not JSON|not CSV") as caught:
        read_planes(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message.removeprefix(str(path))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", json.dumps(SCENE)),
        ("a.JSON", json.dumps(SCENE)),
        ("a.jsonl", json.dumps(SCENE) + "\n"),
        ("a.csv", CSV),
        ("a.csv", "\ufeff" + CSV.replace("\n", "\r\n")),
        ("a.csv", CSV.replace(",", " , ") + "\n\n"),
        ("a.csv", CSV.replace("cx", '"cx"')),
    ],
)
def test_planes_are_read_exactly(tmp_path, name, content):
    (graph,) = read_planes(write(tmp_path, name, content))
    npt.assert_array_equal(table(graph), ROWS)
    assert graph.nodes.label.tolist() == [PLANE] * 3
    assert graph.nodes.position.dtype == np.float64
    validate_graph(graph, "planes")


def test_columns_may_come_in_any_order(tmp_path):
    order = [6, 3, 0, 5, 1, 4, 2]
    lines = [[COLUMNS[i] for i in order], *([repr(row[i]) for i in order] for row in ROWS)]
    (graph,) = read_planes(write(tmp_path, "a.csv", "\n".join(map(",".join, lines))))
    npt.assert_array_equal(table(graph), ROWS)


def test_scenes_keep_the_order_of_their_lines(tmp_path):
    scenes = [{"planes": SCENE["planes"][:count]} for count in (3, 2)]
    path = write(tmp_path, "a.jsonl", "\n".join(map(json.dumps, scenes)))
    assert [len(graph.nodes.label) for graph in read_planes(path)] == [3, 2]


@given(
    st.lists(
        st.tuples(*[st.floats(-100, 100)] * 3, st.floats(0, 6.28), st.floats(0.1, 50)),
        min_size=2,
        max_size=6,
        unique_by=lambda plane: round(plane[0], 3),
    )
)
@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_written_planes_read_back_bit_for_bit(tmp_path, planes):
    rows = [[*p[:3], np.cos(p[3]), np.sin(p[3]), 0.0, p[4]] for p in planes]
    scene = {"planes": [{"centroid": r[:3], "normal": r[3:6], "width": r[6]} for r in rows]}
    graph = planes_from_dict(scene, "planes")
    write_planes(tmp_path / "a.json", graph)
    (read,) = read_planes(tmp_path / "a.json")
    assert table(read).tobytes() == np.array(rows).tobytes()
    assert planes_to_dict(read) == scene


def test_planes_of_arrays_are_those_of_a_file():
    columns = np.array(ROWS)
    made = planes(columns[:, :3].tolist(), columns[:, 3:6], tuple(columns[:, 6]))
    read = planes_from_dict(SCENE, "planes")
    for one, other in zip(made.nodes, read.nodes, strict=True):
        npt.assert_array_equal(one, other, strict=True)
    assert made.nodes.observed.all()
    assert not len(made.senders)
    assert ontology_of(made) is PAPER_ONTOLOGY


def test_planes_of_another_ontology_are_its_first_with_normals_and_widths():
    pillar, plane, *others = (ONTOLOGY.concepts[label] for label in (1, 0, *range(2, 6)))
    ontology = Ontology((pillar, plane, *others), ONTOLOGY.rules)
    made = planes(np.eye(3), np.eye(3), np.ones(3), ontology)
    assert made.nodes.label.tolist() == [1, 1, 1]
    assert ontology_of(made) is ontology


def test_an_ontology_that_observes_no_planes_is_refused():
    _, pillar, *others = ONTOLOGY.concepts
    rules = [rule for rule in ONTOLOGY.rules if rule.part != "plane"]
    ontology = Ontology((pillar, *others), tuple(rules))
    with pytest.raises(ValueError, match=r"^planes: nothing observed has normal and width, expect"):
        planes(np.eye(3), np.eye(3), np.ones(3), ontology)


@pytest.mark.parametrize(
    ("centroid", "normal", "width", "sentence"),
    [
        (np.ones((4, 2)), np.eye(3), np.ones(3), "centroid has shape [4, 2], expected [4, 3]"),
        (np.ones(3), np.eye(3), np.ones(3), "centroid has shape [3], expected [3, 3]"),
        (np.eye(3), np.ones((4, 3)), np.ones(3), "normal has shape [4, 3], expected [3, 3]"),
        (np.eye(3), np.eye(3), np.ones((3, 1)), "width has shape [3, 1], expected [3]"),
        (np.eye(3), np.eye(3), 1.0, "width has shape [], expected [3]"),
        (1.0, np.eye(3), np.ones(3), "centroid has shape [], expected [1, 3]"),
        (np.eye(3), [[1, 0], [1]], np.ones(3), "normal is no array of numbers, expected a row"),
        (np.eye(3), np.eye(3), ["wide"] * 3, "width is no array of numbers, expected a row"),
        (np.eye(3), np.eye(3), None, "width has shape [], expected [3]"),
    ],
)
def test_arrays_of_other_shapes_are_refused(centroid, normal, width, sentence):
    with pytest.raises(ValueError, match=rf"^planes: {re.escape(sentence)}") as caught:
        planes(centroid, normal, width)
    assert "\n" not in str(caught.value)


def rounded_scene():
    """Returns planes whose normals a user has rounded to two decimals."""
    normals = [[0.71, 0.7, 0.0], [-0.71, -0.71, 0.0], [1.0, 0.0, 0.0]]
    scene = json.loads(json.dumps(SCENE))
    for plane, normal in zip(scene["planes"], normals, strict=True):
        plane["normal"] = normal
    return scene, np.array(normals)


@pytest.mark.parametrize("name", ["a.json", "a.csv"])
def test_what_can_be_mended_is_read_and_written_as_it_is(tmp_path, name):
    """Normals of any length and lean, and repeats; of what is right nothing is lost, either."""
    scene, _ = rounded_scene()
    scene["planes"][1]["normal"] = [0.0, -3.0, 0.4]
    scene["planes"].append(scene["planes"][0])
    rows = [[*p["centroid"], *p["normal"], p["width"]] for p in scene["planes"]]
    text = "\n".join([",".join(COLUMNS), *(",".join(map(repr, row)) for row in rows)])
    path = write(tmp_path, name, text if name == "a.csv" else json.dumps(scene))
    (graph,) = read_planes(path)
    npt.assert_array_equal(table(graph), rows)
    write_graphs(tmp_path / "graph.json", read_graphs(path))
    (again,) = read_planes(tmp_path / "graph.json")
    npt.assert_array_equal(table(again), rows)


FURTHER = [{"id": 17, "robot": "r1", "seen": [1, {"by": None}]}, {}, {"id": "door", "label": "x"}]


def test_further_keys_of_planes_are_their_attributes(tmp_path):
    planes = [plane | held for plane, held in zip(SCENE["planes"], FURTHER, strict=True)]
    (read,) = read_with_attributes(write(tmp_path, "a.json", json.dumps({"planes": planes})))
    npt.assert_array_equal(table(read.graph), ROWS)
    assert read.attributes == FURTHER


def test_further_columns_are_attributes_and_numbers_where_they_read_like_them(tmp_path):
    columns = {
        "": "0 1 2",
        "id": "17 007 3.0",
        "robot": "r1 - r2",
        "score": "0.25 1e400 nan",
        "count": "12 " + "1" * 400 + " 0x1",
    }
    lines = CSV.splitlines()
    cells = [value.split() for value in columns.values()]
    cells[2][1] = ""
    wide = [",".join([*columns, lines[0]])]
    wide += [
        ",".join([*row, line])
        for row, line in zip(zip(*cells, strict=True), lines[1:], strict=True)
    ]
    (read,) = read_with_attributes(write(tmp_path, "a.csv", "\n".join(wide)))
    npt.assert_array_equal(table(read.graph), ROWS)
    assert read.attributes == [
        {"id": 17, "robot": "r1", "score": 0.25, "count": 12},
        {"id": "007", "score": "1e400", "count": int("1" * 400)},
        {"id": "3.0", "robot": "r2", "score": "nan", "count": "0x1"},
    ]
    assert [[type(value) for value in held.values()] for held in read.attributes[:1]] == [
        [int, str, float, int]
    ]


@pytest.mark.parametrize(
    ("header", "sentence"),
    [
        ("cx,cy,cz,nx,ny,nz,length", "missing column 'width', expected cx,cy,cz"),
        ("cx,cy,cz,nx,ny,nz,width,height", "line 2 has 7 cells, expected 8"),
        ("cx,cy,cz,nx,ny,nz", "missing column 'width'"),
        ("cx,cx,cy,cz,nx,ny,nz,width", "repeated column 'cx'"),
        ("cx,cy,cz,nx,ny,nz,width,id,id", "repeated column 'id'"),
        ("0,0,0,1,0,0,3", "missing column 'cx'"),
    ],
)
def test_a_wrong_header_is_refused(tmp_path, header, sentence):
    rows = CSV.partition("\n")[2]
    assert sentence in refusal(write(tmp_path, "a.csv", f"{header}\n{rows}"))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", ": the file is empty, expected a header cx,cy,cz,nx,ny,nz,width"),
        (CSV.splitlines()[0], ": planes holds no planes"),
        ("\n".join(CSV.splitlines()[:2]), ": planes holds one plane"),
        (CSV + "1,2,3\n", ": line 5 has 3 cells, expected 7"),
        (CSV.replace("4.0\n", "wide\n"), ": line 3: width is 'wide', expected a number"),
        (CSV.replace("4.0\n", "\n"), ": line 3: width is '', expected a number"),
        (CSV.replace("4.0\n", "4_0\n"), ": line 3: width is '4_0', expected a number"),
        (CSV.replace("4.0\n", "\u0663\n"), ": line 3: width is '\u0663', expected a number"),
        (CSV.replace("4.0\n", "nan\n"), ": planes[1].width is nan, expected finite numbers"),
        (CSV.replace("4.0\n", '"4.0\n'), " is not CSV"),
    ],
)
def test_a_broken_table_is_refused(tmp_path, content, sentence):
    assert sentence in refusal(write(tmp_path, "a.csv", content))


def plane_with(**fields):
    return {"planes": [SCENE["planes"][0], SCENE["planes"][1] | fields]}


@pytest.mark.parametrize(
    ("scene", "sentence"),
    [
        (SCENE | {"units": "mm"}, ": the scene has 'units', expected exactly planes"),
        ({"planes": 3}, ": planes is no list"),
        ({"planes": []}, ": planes holds no planes"),
        ({"planes": [3]}, ": planes[0] is 3, expected an object with centroid, normal, width"),
        ({"planes": [{"centroid": [0, 0, 0]}]}, ": planes[0] lacks 'normal', expected centroid, n"),
        ({"planes": [SCENE["planes"][0], {"length": 3}]}, ": planes[1] lacks 'centroid', expected"),
        (plane_with(width="3"), ": planes[1].width is '3', expected a number"),
        (plane_with(width=True), ": planes[1].width is True, expected a number"),
        (plane_with(width=None), ": planes[1].width is None, expected a number"),
        (plane_with(width=10**400), ": planes[1].width is 1000"),
        (plane_with(centroid=[0, 0]), ": planes[1].centroid is [0, 0], expected three numbers"),
        (plane_with(normal=[1, 0, "0"]), ": planes[1].normal is '0', expected a number"),
        (
            plane_with(centroid=[0, float("nan"), 0]),
            ": planes[1].centroid is [0, nan, 0], expected",
        ),
    ],
)
def test_a_broken_scene_is_refused(tmp_path, scene, sentence):
    assert sentence in refusal(write(tmp_path, "a.json", json.dumps(scene)))
    lines = "\n".join(map(json.dumps, [SCENE, scene]))
    assert ": line 2" + sentence in refusal(write(tmp_path, "a.jsonl", lines))


@pytest.mark.parametrize(
    ("scene", "sentence"),
    [
        ([], "the scene is [], expected an object with planes"),
        ({}, "the scene lacks 'planes'"),
    ],
)
def test_a_document_without_planes_is_refused(scene, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        planes_from_dict(scene, "here")


LIST = "x;y;direction x;direction y;length;room\n1;2;0;1;3.5;hall\n1;4;0;-1;3;\n"


def test_columns_may_have_other_names_and_a_plan_needs_no_heights(tmp_path):
    (tmp_path / "a.csv").write_text(LIST)
    names = {"x": "cx", "y": "cy", "direction x": "nx", "direction y": "ny", "length": "width"}
    (read,) = read_with_attributes(tmp_path / "a.csv", names)
    nodes = read.graph.nodes
    assert nodes.position.tolist() == [[1, 2, 0], [1, 4, 0]]
    assert nodes.normal.tolist() == [[0, 1, 0], [0, -1, 0]]
    assert nodes.width.tolist() == [3.5, 3]
    assert read.attributes == [{"room": "hall"}, {}]
    assert read.remarks == ("has no column cz and nz, taken to be 0",)


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"X": "cx"}, "there is no column 'X', expected of x,y,direction x"),
        ({"x": "X"}, "column 'x' is to be 'X', expected one of cx, cy"),
        ({"x": "cx"}, "missing column 'cy', expected cx,cy"),
        ({"x": "cx", "y": "cx"}, "missing column 'cy'"),
    ],
)
def test_names_that_do_not_fit_are_refused(columns, sentence, tmp_path):
    (tmp_path / "a.csv").write_text(LIST)
    with pytest.raises(ValueError, match=sentence):
        read_with_attributes(tmp_path / "a.csv", columns)


def test_only_a_table_has_columns(tmp_path):
    (tmp_path / "a.json").write_text('{"planes": []}')
    with pytest.raises(ValueError, match=r"columns are named, expected a \.csv file"):
        read_with_attributes(tmp_path / "a.json", {"x": "cx"})
