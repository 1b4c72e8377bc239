"""The example that turns files of others into plans and planes: what comes out is read."""

import importlib.util
import json

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.floorplan import read_floors
from sg3d_jax.data.plans import read_plans
from sg3d_jax.io.formats import read_with_attributes
from tests.tiny_run import ROOT


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("plans", ROOT / "examples" / "floor_plans.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


HOUSE = """ASCII 1.1
R  0 0  0 0 k  0 0 0  0 0 0  4 3 2.5  2.5  0 0 0 0
R  1 0  0 0 b  0 0 0  0 0 0  4 3 2.5  2.5  0 0 0 0
R  2 0  0 0 Z  0 0 0  0 0 0  4 3 2.5  2.5  0 0 0 0
S  0 0 0 -  0 0 0  0 0 1  0 0 0  4 3 0  0 0 0
S  1 1 0 -  0 0 0  0 0 1  0 0 0  4 3 0  0 0 0
S  2 2 0 -  0 0 0  0 0 1  0 0 0  4 3 0  0 0 0
"""


def test_regions_of_matterport_are_rooms(script, tmp_path):
    corners = [
        f"V  {4 * s + i} {s} -  {x + 4.2 * s} {y} 0.1  0 0 1  0 0 0\n"
        for s in (0, 1, 2)
        for i, (x, y) in enumerate([(0, 0), (4, 0), (4, 3), (0, 3)])
    ]
    (tmp_path / "abc.house").write_text(HOUSE + "".join(corners))
    script.main(tmp_path / "abc.house", tmp_path / "plan.jsonl")
    ((floor,), left_out) = read_floors(tmp_path / "plan.jsonl")
    assert (floor.origin, floor.rooms, left_out) == ("abc storey 0", ("kitchen", "bedroom"), [])
    assert len(floor.storey.wall_centre) == 1


def test_walls_of_a_phone_look_into_their_room(script, tmp_path):
    def wall(name, angle, x, z, width):  # y is up; the wall's own z is across it
        cos, sin = np.cos(angle), np.sin(angle)
        matrix = [[cos, 0, sin, x], [0, 1, 0, 1.2], [-sin, 0, cos, z], [0, 0, 0, 1]]
        columns = np.array(matrix).T.ravel().tolist()
        return {"identifier": name, "transform": columns, "dimensions": [width, 2.4, 0.0]}

    walls = [wall("n", 0, 0, -2, 6), wall("s", 0, 0, 2, 6)]
    walls += [wall("w", np.pi / 2, -3, 0, 4), wall("e", np.pi / 2, 3, 0, 4)]
    (tmp_path / "Room.json").write_text(json.dumps({"rooms": [{"walls": walls}]}))
    script.main(tmp_path / "Room.json", tmp_path / "planes.json")
    (read,) = read_with_attributes(tmp_path / "planes.json")
    nodes = read.graph.nodes
    assert [held["id"] for held in read.attributes] == ["n", "s", "w", "e"]
    expected = [[0, 2, 1.2], [0, -2, 1.2], [-3, 0, 1.2], [3, 0, 1.2]]
    npt.assert_allclose(nodes.position, expected, atol=1e-12)
    inward = [[0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0]]
    npt.assert_allclose(nodes.normal, inward, atol=1e-12)
    npt.assert_array_equal(nodes.width, [6, 6, 4, 4])


def test_spaces_of_an_ifc_file_are_rooms(script, tmp_path):
    ifcopenshell = pytest.importorskip("ifcopenshell")
    api = importlib.import_module("ifcopenshell.api")
    model = ifcopenshell.file(schema="IFC4")

    def make(kind, name, whole=None):
        made = api.run("root.create_entity", model, ifc_class=kind, name=name)
        if whole is not None:
            api.run("aggregate.assign_object", model, products=[made], relating_object=whole)
        return made

    project = make("IfcProject", "p")
    api.run("unit.assign_unit", model, length={"is_metric": True, "raw": "MILLIMETERS"})
    context = api.run("context.add_context", model, context_type="Model")
    body = api.run(
        "context.add_context",
        model,
        context_type="Model",
        context_identifier="Body",
        target_view="MODEL_VIEW",
        parent=context,
    )
    home = make("IfcBuilding", "home", make("IfcSite", "s", project))
    for level in (1, 0):
        storey = make("IfcBuildingStorey", f"level {level}", home)
        storey.Elevation = 3000.0 * level
        for index in range(2):
            space = make("IfcSpace", f"room {level}{index}", storey)
            outline = [(0, 0), (4000, 0), (4000, 3000), (0, 3000), (0, 0)]
            points = [
                model.create_entity("IfcCartesianPoint", [float(x + 4200 * index), float(y)])
                for x, y in outline
            ]
            profile = model.create_entity(
                "IfcArbitraryClosedProfileDef", "AREA", None, model.createIfcPolyline(points)
            )
            up = model.createIfcDirection([0.0, 0.0, 1.0])
            solid = model.createIfcExtrudedAreaSolid(profile, None, up, 2500.0)
            shape = model.createIfcShapeRepresentation(body, "Body", "SweptSolid", [solid])
            api.run("geometry.assign_representation", model, product=space, representation=shape)
            api.run("geometry.edit_object_placement", model, product=space)
    model.write(str(tmp_path / "home.ifc"))
    script.main(tmp_path / "home.ifc", tmp_path / "plan.jsonl")
    plans = read_plans(tmp_path / "plan.jsonl")
    assert [plan.origin for plan in plans] == ["home storey 0", "home storey 1"]
    assert sorted(plans[1].names) == ["room 10", "room 11"]
    floors, left_out = read_floors(tmp_path / "plan.jsonl")
    assert left_out == []
    npt.assert_allclose(sorted(floors[0].storey.width), [3] * 4 + [4] * 4, atol=1e-6)
    assert len(floors[0].storey.wall_centre) == 1
