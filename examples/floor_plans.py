"""Turns IFC, Matterport3D and RoomPlan files into floor plans or planes that `sg3d` reads.

    python examples/floor_plans.py house.ifc plan.jsonl     rooms of every storey (IfcSpace)
    python examples/floor_plans.py 17DRP5sb8fy.house plan.jsonl     regions of every level
    python examples/floor_plans.py Room.json planes.json    walls that a phone has captured

A plan becomes graphs, with walls, rooms and their names, by `sg3d data import home plan.jsonl -o
home.npz --like p-f`; planes are completed by `sg3d complete planes.json -o graph.json`.

IFC needs `pip install ifcopenshell`. Spaces are taken as they are drawn, in metres: a model without
IfcSpace has no rooms to read. RoomPlan is a CapturedRoom or CapturedStructure that was encoded as
JSON: metres, y up, matrices column by column.

Tried: on an IFC4 file that ifcopenshell 0.9 made (tests/test_floor_plans.py); on the house of
Matterport3D in the source of spark_dsg 1.1.3; RoomPlan on a small file of its form, not on a
phone's own.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import shapely

FLAT = 1e-6  # square metres: a triangle that stands upright has no more on the ground
JUNK = "Z"  # a region of Matterport3D that is none, such as what a mirror shows
REGIONS = {
    "a": "bathroom",
    "b": "bedroom",
    "c": "closet",
    "d": "dining room",
    "e": "entryway",
    "f": "family room",
    "g": "garage",
    "h": "hallway",
    "i": "library",
    "j": "laundry room",
    "k": "kitchen",
    "l": "living room",
    "m": "meeting room",
    "n": "lounge",
    "o": "office",
    "p": "porch",
    "r": "recreation room",
    "s": "stairs",
    "t": "toilet",
    "u": "utility room",
    "v": "cinema",
    "w": "gym",
    "x": "outdoors",
    "y": "balcony",
    "z": "other room",
    "B": "bar",
    "C": "classroom",
    "D": "dining booth",
    "S": "spa",
    "-": "",
}


def ifc_plans(path: Path) -> list[dict[str, Any]]:
    """Returns the storeys of an IFC file as floor plans."""
    import ifcopenshell  # ty: ignore[import-not-found]
    import ifcopenshell.geom  # ty: ignore[import-not-found]
    from ifcopenshell.util.element import get_aggregate  # ty: ignore[import-not-found]

    model, settings = ifcopenshell.open(str(path)), ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    rooms = defaultdict(list)
    for space in model.by_type("IfcSpace"):
        if space.Representation is None:
            continue
        made = ifcopenshell.geom.create_shape(settings, space).geometry
        corners = np.array(made.verts).reshape(-1, 3)[:, :2][np.array(made.faces).reshape(-1, 3)]
        outline = shapely.union_all([t for t in shapely.polygons(corners) if t.area > FLAT])
        name = space.LongName or space.Name or ""
        rooms[get_aggregate(space)].append({"poly": _ring(outline), "name": name})
    storeys = sorted(model.by_type("IfcBuildingStorey"), key=lambda s: s.Elevation or 0.0)
    return [
        {
            "building": getattr(get_aggregate(storey), "Name", None) or path.stem,
            "storey": number,
            "name": storey.Name,
            "rooms": rooms[storey],
        }
        for number, storey in enumerate(storeys)
        if rooms[storey]
    ]


def _ring(outline: shapely.Geometry) -> list[list[float]]:
    """Returns the corners of the greatest piece of an outline."""
    piece = max(shapely.get_parts(outline), key=lambda part: part.area)
    return shapely.get_coordinates(piece.exterior.simplify(0.001))[:-1].round(4).tolist()


def matterport_plans(path: Path) -> list[dict[str, Any]]:
    """Returns the levels of a Matterport3D .house file as floor plans: each region is a room.

    Source: the format's description, niessner/Matterport, data_organization.md: lines R (region,
    level, ..., label), S (surface, region), V (vertex, surface, label, x, y, z); labels of regions.
    """
    lines = [line.split() for line in path.read_text().splitlines() if line.strip()]
    region_of = {cells[1]: cells[2] for cells in lines if cells[0] == "S"}
    corners = defaultdict(list)
    for cells in lines:
        if cells[0] == "V":
            corners[region_of[cells[2]]].append([float(cells[4]), float(cells[5])])
    levels = defaultdict(list)
    for cells in lines:
        if cells[0] == "R" and len(corners[cells[1]]) > 2 and cells[5] != JUNK:
            name = REGIONS.get(cells[5], cells[5])
            levels[int(cells[2])].append({"poly": corners[cells[1]], "name": name})
    return [
        {"building": path.stem, "storey": level, "rooms": levels[level]} for level in sorted(levels)
    ]


def room_plan_planes(path: Path) -> dict[str, Any]:
    """Returns the walls that RoomPlan captured as planes, their normals into their rooms."""
    document, planes = json.loads(path.read_text()), []
    for room in document.get("rooms", [document]):
        walls = [_wall(wall) for wall in room["walls"]]
        middle = np.mean([centroid for centroid, _, _ in walls], axis=0)
        for wall, (centroid, normal, width) in zip(room["walls"], walls, strict=True):
            inward = normal if normal @ (middle - centroid) >= 0 else -normal
            plane = {"centroid": centroid.tolist(), "normal": inward.tolist(), "width": width}
            planes.append(plane | {"id": wall["identifier"]})
    return {"planes": planes}


def _wall(wall: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns centroid, normal and width; their y is up, and so our z."""
    matrix = np.array(wall["transform"], float).reshape(4, 4).T
    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    normal = up @ matrix[:3, 2]
    normal[2] = 0.0
    return up @ matrix[:3, 3], normal / np.linalg.norm(normal), float(wall["dimensions"][0])


def main(source: Path, output: Path) -> None:
    """Converts a file by its suffix."""
    if source.suffix == ".json":
        output.write_text(json.dumps(room_plan_planes(source), indent=1))
        return
    plans = (ifc_plans if source.suffix == ".ifc" else matterport_plans)(source)
    output.write_text("".join(json.dumps(plan) + "\n" for plan in plans))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
