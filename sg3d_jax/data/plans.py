"""Floor plans as they are drawn: rooms as polygons, read from a file.

A file holds one floor a line (JSON Lines, .jsonl or .jsonl.gz): `{"building": "office/poli",
"storey": 0, "rooms": [{"poly": [[x, y], ...], "name": "kitchen"}, ...]}`, metres; a room may have a
`name`, or a `label`; other keys are ignored. A plan of one's own may be in another unit, and a room
of it that cannot be told costs that room alone.
"""

import gzip
import zlib
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
import shapely

from sg3d_jax.io.files import number, parsed_lines, read_bytes

MIN_SIDES: Final = 3
MAX_COORDINATE: Final = 1e4  # metres; beyond it a plan is hardly in metres
FARTHEST: Final = 1e8  # of whatever unit
UNITS: Final = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254})
DETECTED: Final = MappingProxyType(  # units, and the areas in them of the median room that tell
    {"m": (0.2, 500.0), "cm": (2e4, 1e6), "mm": (2e6, 1e8)}
)
MAX_BYTES: Final = 2**26  # of a file, unpacked


class Plan(NamedTuple):
    """The rooms of one floor as they are drawn."""

    building: str  # floors of one building belong into one part of a split
    origin: str  # the floor's own name
    rooms: tuple[np.ndarray, ...]  # float[v, 2] each, corners in order, metres
    names: tuple[str | None, ...] = ()  # of these rooms
    places: tuple[int, ...] = ()  # of these rooms in the file
    faults: tuple[str, ...] = ()  # a sentence for each room of the file that is not among them


def read_plans(path: str | Path, own: bool = False) -> list[Plan]:
    """Returns the floors of a .jsonl or .jsonl.gz file, not yet made sense of.

    Args:
      path: the file.
      own: whether it is a plan of the user's own, in any unit: a room without a polygon costs that
        room, and not the file.

    Raises:
      ValueError: one sentence that names the file, the line, the room and the field.
    """
    return [_plan(document, where, own) for where, document in parsed_lines(_read(path), path)]


def unit_of(plans: Sequence[Plan], units: str = "auto") -> tuple[str, float]:
    """Returns the unit of some plans, and how many metres one is.

    Args:
      plans: of `read_plans`.
      units: one of `UNITS`; or how many metres one is, such as "0.02" where a pixel is 2 cm; or
        "auto" for what the rooms tell: metres, centimetres or millimetres.

    Raises:
      ValueError: `units` is none, or the rooms tell none.
    """
    if units in UNITS:
        return units, UNITS[units]
    if units != "auto":
        try:
            scale = float(units)
        except ValueError:
            scale = 0.0
        if not 0 < scale < MAX_COORDINATE:
            known = ", ".join(UNITS)
            raise ValueError(f"units are {units!r:.40}, expected {known}, or metres such as 0.02")
        return f"{scale:g} m", scale
    areas = [
        np.median([shapely.Polygon(room).area for room in plan.rooms])
        for plan in plans
        if plan.rooms
    ]
    area = float(np.median(areas)) if areas else 0.0
    for unit, (least, most) in DETECTED.items():
        if least <= area <= most:
            return unit, UNITS[unit]
    known = ", ".join(DETECTED)
    problem = f"the median room has {area:.6g} square units"
    raise ValueError(f"{problem}, which may be in {known} or none of them: expected --units")


def _read(path: str | Path) -> bytes:
    """Returns what is in a file that may be compressed."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    if suffixes[-1:] == [".jsonl"]:
        return read_bytes(path, MAX_BYTES)
    if suffixes[-2:] != [".jsonl", ".gz"]:
        raise ValueError(f"{path}: the name does not end in .jsonl or .jsonl.gz")
    packed = BytesIO(read_bytes(path, MAX_BYTES))
    try:
        data = gzip.GzipFile(fileobj=packed).read(MAX_BYTES + 1)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: not a gzip file, or a damaged one ({error})") from error
    if len(data) > MAX_BYTES:
        raise ValueError(f"{path}: the file is too large, expected {MAX_BYTES} bytes at most")
    return data


def _plan(document: Any, where: str, own: bool) -> Plan:
    """Returns the floor of a parsed document."""
    if not isinstance(document, dict):
        raise ValueError(f"{where}: {document!r:.40} is no object, expected one floor")
    kinds = {"building": str, "storey": int, "rooms": list}
    for key, kind in kinds.items():
        if key not in document:
            raise ValueError(f"{where}: there is no {key!r}, expected {', '.join(kinds)}")
        if not isinstance(document[key], kind) or isinstance(document[key], bool):
            held = f"{document[key]!r:.40}"
            raise ValueError(f"{where}: {key} is {held}, expected {kind.__name__}")
    building, storey, rooms = (document[key] for key in kinds)
    if not building.isprintable():
        raise ValueError(f"{where}: building is {building!r:.40}, expected a name of one line")
    shapes, places, faults = [], [], []
    for index, room in enumerate(rooms):
        try:
            shapes.append(_corners(room, f"rooms[{index}]", FARTHEST if own else MAX_COORDINATE))
            places.append(index)
        except ValueError as error:
            if not own:
                raise ValueError(f"{where}: {error}") from error
            faults.append(f"{error}")
    names = (_name(rooms[place]) for place in places)
    origin = f"{building} storey {storey}"
    return Plan(building, origin, tuple(shapes), tuple(names), tuple(places), tuple(faults))


def _name(room: dict[str, Any]) -> str | None:
    """Returns what a room is called, if that is a word or a line."""
    said = [room.get(key) for key in ("name", "label")]
    return next((name for name in said if isinstance(name, str) and name.isprintable()), None)


def _corners(room: Any, where: str, farthest: float) -> np.ndarray:
    """Returns the corners of a room of a parsed document, float[v, 2]."""
    if not isinstance(room, dict) or not isinstance(room.get("poly"), list):
        raise ValueError(f"{where} is {room!r:.40}, expected an object with a list 'poly'")
    corners = [
        _point(point, f"{where}.poly[{i}]", farthest) for i, point in enumerate(room["poly"])
    ]
    if len(set(corners)) < MIN_SIDES:
        held = f"{len(set(corners))} different corners"
        raise ValueError(f"{where}.poly has {held}, expected at least {MIN_SIDES}")
    return np.array(corners)


def _point(point: Any, where: str, farthest: float) -> tuple[float, float]:
    if not isinstance(point, list) or len(point) != 2:
        raise ValueError(f"{where} is {point!r:.40}, expected two numbers")
    x, y = (number(value, where) for value in point)
    if not (abs(x) <= farthest and abs(y) <= farthest):  # false for NaN
        unit = "metres" if farthest == MAX_COORDINATE else "numbers"
        raise ValueError(f"{where} is {point!r:.40}, expected {unit} within {farthest:g}")
    return x, y
