"""How a floor of any kind is divided into rooms: as labels of the cells of a grid.

A `Footprint` is what the storeys of a building share: its parts and the corridors between them.
Each storey divides the parts anew, into boxes that are painted over one another; then neighbours
merge into L, T and U shapes, and columns, shafts and niches are taken out. Lengths are cells.

There are five kinds of floors: few rooms; homes, cut up recursively, some around a hall; corridors
with rooms on both sides, with wings; floors around a core, with a corridor around it; halls and
open plans with rooms at their edge or as islands in them.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

SOLID: Final = -1  # a column, a shaft or the outside
COMMON: Final = 0  # the corridor, or the hall, that parts share
NEW: Final = -2  # a room of its own
MAX_CORE_ROOMS: Final = 16
MAX_MERGED: Final = 3  # rooms
MAX_COLUMNS: Final = 4  # in one room: four sides each

Box = tuple[int, int, int, int]  # first and last line in x and in y: x0, y0, x1, y1
Block = tuple[int, int, int, int, int]  # a box and its label


class Part(NamedTuple):
    """A box of a footprint and how it is divided."""

    box: Box
    kind: str  # one of `DIVIDED`
    band: tuple[int, int] = (0, 0)  # first and last line in y of the corridor of a bar along x
    along_y: bool = False  # whether the bar and its corridor run in y instead


class Footprint(NamedTuple):
    """What the storeys of a building have in common."""

    step: float  # metres, mean side of a cell
    size: tuple[int, int]  # cells in x and in y
    parts: tuple[Part, ...]
    links: tuple[Box, ...]  # of corridors through other parts
    room: float  # typical area of a room, or, along a corridor, its square, cells
    least: int  # least width of a room, cells
    merge: float  # share of the pairs of neighbours that merge
    insets: float  # share of the rooms with a niche, a column, a shaft or a closet


class _Scale(NamedTuple):
    """Metres to cells."""

    step: float  # metres

    def cells(self, metres: float, fewest: int = 1) -> int:
        return max(fewest, round(metres / self.step))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Returns a length drawn such that its logarithm is uniform."""
    return low * (high / low) ** rng.random()


# --- footprints ---


def draw_footprint(
    kind: str, num_rooms: float, thickness: float, rng: np.random.Generator
) -> Footprint:
    """Draws a footprint for about so many rooms a storey.

    Args:
      kind: one of `FOOTPRINTS`.
      num_rooms: how many rooms a storey is to have, roughly.
      thickness: greatest thickness of its walls, metres: rooms are wider where walls are thick.
      rng: source of randomness.
    """
    return FOOTPRINTS[kind](num_rooms, thickness, rng)


def _footprint(
    scale: _Scale,
    parts: Sequence[Part],
    links: Sequence[Box],
    room: float,
    thickness: float,
    rng: np.random.Generator,
    merge: float,
) -> Footprint:
    """Puts a footprint together, moved such that it starts at zero."""
    boxes = np.array([part.box for part in parts])
    x, y = boxes[:, :2].min(axis=0).tolist()
    width, height = (boxes[:, 2:].max(axis=0) - (x, y)).tolist()
    moved = [
        part._replace(
            box=_moved(part.box, x, y),
            band=tuple(line - (x if part.along_y else y) for line in part.band),
        )
        for part in parts
    ]
    return Footprint(
        step=scale.step,
        size=(width, height),
        parts=tuple(moved),
        links=tuple(_moved(link, x, y) for link in links),
        room=room / scale.step**2,
        least=int(np.ceil((0.9 + thickness) / scale.step)),
        merge=merge,
        insets=0.4 * rng.random(),
    )


def _moved(box: Box, x: int, y: int) -> Box:
    return box[0] - x, box[1] - y, box[2] - x, box[3] - y


def _few(num_rooms: float, thickness: float, rng: np.random.Generator) -> Footprint:
    """One room, or a few: a hut, a studio, a garage."""
    scale = _Scale(0.3)
    room = _between(rng, 4.0, 60.0)
    side = np.sqrt(max(1.0, num_rooms) * room)
    stretch = _between(rng, 0.6, 1.7)
    fewest = scale.cells(1.0 + thickness)
    box = (0, 0, scale.cells(side * stretch, fewest), scale.cells(side / stretch, fewest))
    return _footprint(scale, [Part(box, "cut")], [], room, thickness, rng, 0.3 * rng.random())


def _home(num_rooms: float, thickness: float, rng: np.random.Generator) -> Footprint:
    """A flat or a house: a box, an L, a T or a U of rooms of many sizes."""
    scale = _Scale(0.3)
    room = _between(rng, 4.0, 16.0) + 4 * thickness
    side = np.sqrt(num_rooms * room)
    stretch = _between(rng, 0.55, 1.8)
    width, height = scale.cells(side * stretch, 8), scale.cells(side / stretch, 8)
    parts = [Part((0, 0, width, height), "hall way" if rng.random() < 0.6 else "cut")]
    if rng.random() < 0.45:  # the wings of an L, a T or a U
        share = 0.25 + 0.3 * rng.random()
        wing = max(8, round(share * width))
        reach = max(8, round((0.3 + 0.6 * rng.random()) * height))
        starts = [0, width - wing] if rng.random() < 0.4 and 2 * wing + 6 < width else [0]
        if len(starts) == 1 and rng.random() < 0.4:
            starts = [(width - wing) // 2]
        parts += [
            Part((x, height, x + wing, height + reach), "cut") for x in starts if wing < width
        ]
    return _footprint(scale, parts, [], room, thickness, rng, 0.5 * rng.random())


def _corridor(num_rooms: float, thickness: float, rng: np.random.Generator) -> Footprint:
    """A corridor with rooms on both sides, or on one, and up to four wings of its kind."""
    bay = _between(rng, 2.6, 8.5) + thickness
    depth, passage = _between(rng, 3.2, 8.0) + thickness, _between(rng, 1.3, 3.2) + thickness
    two_sided = rng.random() < 0.85
    total = num_rooms * bay / (2 if two_sided else 1)
    num_wings = int(rng.random() ** 1.5 * 5) if total > 30 else 0
    length = float(np.clip(total / (1 + 0.5 * num_wings), 3 * bay, 95))
    scale = _Scale(float(np.clip(length / 150, 0.3, 0.6)))
    row, band = scale.cells(depth), scale.cells(passage)
    below = row if two_sided else 0
    height = below + band + row
    end = scale.cells(length)
    parts = [Part((0, 0, end, height), "bar", (below, below + band))]
    links = []
    corners = [(x, up) for x in (0, end - (2 * row + band)) for up in (True, False)]
    for index in rng.permutation(len(corners))[:num_wings].tolist():
        x, up = corners[index]
        if end < 2 * (2 * row + band) + 4:  # short bars have a wing in the middle
            x = (end - (2 * row + band)) // 2
        reach = scale.cells(float(np.clip(0.6 * length * rng.random(), 2 * bay, 60)))
        low, high = (height, height + reach) if up else (-reach, 0)
        lane = (x + row, x + row + band)
        parts.append(Part((x, low, x + 2 * row + band, high), "bar", lane, along_y=True))
        links.append((lane[0], below, lane[1], low) if up else (lane[0], high, lane[1], below))
    return _footprint(scale, parts, links, bay**2, thickness, rng, 0.25 * rng.random())


def _core(num_rooms: float, thickness: float, rng: np.random.Generator) -> Footprint:
    """Rooms around a corridor around a core of stairs, shafts and other small rooms."""
    bay = _between(rng, 2.8, 7.0) + thickness
    side = float(np.clip(num_rooms * bay / 5 + bay, 14, 60))
    scale = _Scale(float(np.clip(side / 120, 0.3, 0.5)))
    stretch = _between(rng, 0.7, 1.5)
    box = (0, 0, scale.cells(side * stretch), scale.cells(side / stretch))
    return _footprint(scale, [Part(box, "ring")], [], bay**2, thickness, rng, 0.25 * rng.random())


def _hall(num_rooms: float, thickness: float, rng: np.random.Generator) -> Footprint:
    """A hall or an open plan, with columns and with rooms along its sides or as islands."""
    most = 100.0 if num_rooms > 4 else 60.0
    length = _between(rng, 6.0, most)
    scale = _Scale(float(np.clip(length / 120, 0.3, 0.7)))
    width = float(np.clip(length * (0.35 + 0.65 * rng.random()), 5, 60))
    box = (0, 0, scale.cells(length), scale.cells(width))
    bay = float(np.clip((length + width) / max(num_rooms, 1.0), 2.5, 12)) + thickness
    return _footprint(scale, [Part(box, "hall")], [], bay**2, thickness, rng, 0.1 * rng.random())


FOOTPRINTS: Final = MappingProxyType(
    {"few": _few, "home": _home, "corridor": _corridor, "core": _core, "hall": _hall}
)


# --- rooms ---


def draw_rooms(footprint: Footprint, rng: np.random.Generator) -> np.ndarray:
    """Divides a footprint into rooms.

    Returns:
      int[x, y], the room of each cell, `SOLID` for columns, shafts and the outside. A number may
      occur in several places, which are rooms of their own.
    """
    blocks = [
        block for part in footprint.parts for block in DIVIDED[part.kind](part, footprint, rng)
    ]
    blocks += [(*link, COMMON) for link in footprint.links]
    labels = np.full(footprint.size, SOLID)
    for room, (x0, y0, x1, y1, label) in enumerate(blocks, 1):
        labels[x0:x1, y0:y1] = room if label == NEW else label
    labels = _merged(labels, footprint, rng)
    added = _insets(blocks, footprint, rng)
    for room, (x0, y0, x1, y1, label) in enumerate(added, len(blocks) + 1):
        labels[x0:x1, y0:y1] = room if label == NEW else label
    return labels


def _merged(labels: np.ndarray, footprint: Footprint, rng: np.random.Generator) -> np.ndarray:
    """Merges neighbours, up to three, where they share enough for a passage."""
    if not footprint.merge:
        return labels
    most = labels.max() + 1
    beside = [(labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])]
    codes = [
        (np.minimum(one, other) * most + np.maximum(one, other))[
            (one != other) & (one >= COMMON) & (other >= COMMON)
        ]
        for one, other in beside
    ]
    code, shared = np.unique(np.concatenate(codes), return_counts=True)
    tried = (shared >= footprint.least) & (rng.random(len(code)) < footprint.merge)
    becomes, parts = np.arange(most), np.ones(most, int)
    for pair in zip(*divmod(code[tried], most), strict=True):
        one, other = sorted(becomes[list(pair)].tolist())
        if one != other and parts[one] + parts[other] <= MAX_MERGED:
            parts[one] += parts[other]
            becomes[becomes == other] = one
    return np.append(becomes, SOLID)[labels]


def _insets(
    blocks: Sequence[Block], footprint: Footprint, rng: np.random.Generator
) -> Iterator[Block]:
    """Yields what takes a place in rooms: columns, shafts, niches and closets.

    They stand in a corner, at a side or, but for closets, free.
    """
    least = footprint.least
    chosen = np.flatnonzero(rng.random(len(blocks)) < footprint.insets)
    for index, draws in zip(chosen.tolist(), rng.random((len(chosen), 7)).tolist(), strict=True):
        x0, y0, x1, y1, label = blocks[index]
        closet, place, along, *ends = draws
        is_closet = closet < 0.6
        smallest, spread = (least, 3) if is_closet else (1, 2)
        wide, deep = (smallest + int(spread * draw**2) for draw in ends[:2])
        free_x, free_y = x1 - x0 - wide, y1 - y0 - deep
        if label == SOLID or min(free_x, free_y) < least:
            continue
        x, y = (free * (draw < 0.5) for free, draw in zip((free_x, free_y), ends[2:], strict=True))
        if place < 0.3:
            if free_x < 2 * least:
                continue
            x = least + int(along * (free_x - 2 * least + 1))
        elif place < 0.45 and not is_closet:
            if min(free_x, free_y) < 2 * least:
                continue
            x, y = free_x // 2, free_y // 2
        x, y = x0 + x, y0 + y
        yield x, y, x + wide, y + deep, NEW if is_closet else SOLID


# --- how parts are divided ---


def _cut(part: Part, footprint: Footprint, rng: np.random.Generator) -> list[Block]:
    """Cuts a box in two, and the halves again, until rooms are small enough."""
    return _rooms(part.box, footprint.room, footprint.least, rng)


def _rooms(box: Box, area: float, least: int, rng: np.random.Generator) -> list[Block]:
    done, todo = [], [box]
    while todo:
        x0, y0, x1, y1 = todo.pop()
        width, height = x1 - x0, y1 - y0
        longer = max(width, height)
        size, lean, share, other = rng.random(4).tolist()
        if longer < 2 * least or width * height <= area * (0.5 + 1.2 * size):
            if width > 0 and height > 0:
                done.append((x0, y0, x1, y1, NEW))
            continue
        in_x = width * (0.7 + 0.6 * lean) > height
        if min(width, height) < 2 * least:
            in_x = width > height
        free = (width if in_x else height) - 2 * least
        cut = least + round(free * (share + other) / 2)
        if in_x:
            todo += [(x0, y0, x0 + cut, y1), (x0 + cut, y0, x1, y1)]
        else:
            todo += [(x0, y0, x1, y0 + cut), (x0, y0 + cut, x1, y1)]
    return done


def _hall_way(part: Part, footprint: Footprint, rng: np.random.Generator) -> list[Block]:
    """Cuts a box on both sides of a hall, which reaches one end of it or both."""
    x0, y0, x1, y1 = part.box
    least, area = footprint.least, footprint.room
    turned = y1 - y0 > x1 - x0
    if turned:
        x0, y0, x1, y1 = y0, x0, y1, x1
    band = least + int(rng.random() * 3)
    free = y1 - y0 - band - 2 * least
    if free < 0 or x1 - x0 < 3 * least:
        return _cut(part, footprint, rng)
    low = y0 + least + round(free * (rng.random() + rng.random()) / 2)
    end = x1 if rng.random() < 0.4 else x1 - least - int(rng.random() * (x1 - x0 - 3 * least + 1))
    blocks = _rooms((x0, y0, x1, low), area, least, rng)
    blocks += _rooms((x0, low + band, x1, y1), area, least, rng)
    blocks.append((x0, low, end, low + band, NEW))
    if end < x1:
        blocks.append((end, low, x1, low + band, NEW))
    return [_transposed(block) for block in blocks] if turned else blocks


def _transposed(block: Block) -> Block:
    x0, y0, x1, y1, label = block
    return y0, x0, y1, x1, label


def _bar(part: Part, footprint: Footprint, rng: np.random.Generator) -> list[Block]:
    """Cuts a box into rows of rooms on both sides of its corridor."""
    x0, y0, x1, y1 = part.box
    if part.along_y:
        x0, y0, x1, y1 = y0, x0, y1, x1
    low, high = part.band
    blocks = _row((x0, y0, x1, low), footprint, rng) + _row((x0, high, x1, y1), footprint, rng)
    start, end = x0, x1
    for at_end in (False, True):  # stairs close an end of the corridor
        if rng.random() < 0.35 and end - start > 4 * footprint.least:
            stairs = footprint.least + int(rng.random() * 2 * footprint.least)
            if at_end:
                end -= stairs
                blocks.append((end, low, end + stairs, high, NEW))
            else:
                blocks.append((start, low, start + stairs, high, NEW))
                start += stairs
    blocks.append((start, low, end, high, COMMON))
    return [_transposed(block) for block in blocks] if part.along_y else blocks


def _row(box: Box, footprint: Footprint, rng: np.random.Generator) -> list[Block]:
    """Cuts a box across its length into rooms of one width, or of many."""
    x0, y0, x1, y1 = box
    least = footprint.least
    if y1 - y0 < least or x1 - x0 < least:
        return []
    bay = max(least, round(np.sqrt(footprint.room)))
    number = max(1, round((x1 - x0) / bay))
    spread = 0.9 * rng.random() if rng.random() < 0.5 else 0.0
    inner = np.arange(1, number) + spread * (rng.random(number - 1) - 0.5)
    inner = inner[rng.random(number - 1) > 0.2]  # now and then a room of two bays, or three
    lines = [x0, *(x0 + np.round(inner * (x1 - x0) / number)).astype(int).tolist(), x1]
    blocks: list[Block] = []
    for start, end in pairwise(lines):
        if end - start < least:
            continue
        if rng.random() < 0.12 and y1 - y0 >= 2 * least:  # a group of smaller rooms
            blocks += _rooms((start, y0, end, y1), (end - start) * (y1 - y0) / 3, least, rng)
        else:
            blocks.append((start, y0, end, y1, NEW))
    return blocks


def _ring(part: Part, footprint: Footprint, rng: np.random.Generator) -> list[Block]:
    """Divides a box into rows along its sides, a corridor within them and a core within that."""
    x0, y0, x1, y1 = part.box
    least = footprint.least
    shorter = min(x1 - x0, y1 - y0)
    depth = int(np.clip(np.sqrt(footprint.room) * (0.8 + 0.5 * rng.random()), least, shorter / 4))
    band = least + int(rng.random() * 4)
    if shorter < 2 * (depth + band) + least:
        return _hall_way(part, footprint, rng)
    inner = (x0 + depth, y0 + depth, x1 - depth, y1 - depth)
    blocks = _row((x0, y0, x1, inner[1]), footprint, rng)
    blocks += _row((x0, inner[3], x1, y1), footprint, rng)
    for start, end in ((x0, inner[0]), (inner[2], x1)):
        row = _row((inner[1], start, inner[3], end), footprint, rng)
        blocks += [_transposed(block) for block in row]
    blocks.append((*inner, COMMON))
    core = (inner[0] + band, inner[1] + band, inner[2] - band, inner[3] - band)
    if rng.random() < 0.15:
        return [*blocks, (*core, SOLID)]
    area = (core[2] - core[0]) * (core[3] - core[1])
    return blocks + _rooms(core, area / (1 + MAX_CORE_ROOMS * rng.random() ** 2), least, rng)


def _open(part: Part, footprint: Footprint, rng: np.random.Generator) -> list[Block]:
    """Makes a hall of a box: rooms along its sides or in its corners, islands and columns in it."""
    x0, y0, x1, y1 = part.box
    least = footprint.least
    bay = max(least, round(np.sqrt(footprint.room)))
    blocks: list[Block] = [(x0, y0, x1, y1, COMMON)]
    depth = max(least, min(bay, (y1 - y0) // 3))
    side = rng.random()
    if y1 - y0 < 3 * least or x1 - x0 < 3 * least:
        return blocks
    if side < 0.5:
        blocks += _row((x0, y0, x1, y0 + depth), footprint, rng)
        if side < 0.2:
            blocks += _row((x0, y1 - depth, x1, y1), footprint, rng)
    else:
        wide = min(2 * bay, (x1 - x0 - least) // 2)
        for corner in np.flatnonzero(rng.random(4) < 0.4).tolist() if wide >= least else ():
            x = x1 - wide if corner % 2 else x0
            y = y1 - depth if corner // 2 else y0
            blocks += _row((x, y, x + wide, y + depth), footprint, rng)
    inner = (x0 + least, y0 + depth + least, x1 - least, y1 - depth - least)
    return blocks + _within(inner, least, bay, rng)


def _within(box: Box, least: int, bay: int, rng: np.random.Generator) -> list[Block]:
    """Returns an island of rooms, or columns, in the middle of a hall."""
    x0, y0, x1, y1 = box
    if min(x1 - x0, y1 - y0) < 2 * least:
        return []
    x, y = (x0 + x1) // 2, (y0 + y1) // 2
    if rng.random() < 0.4:
        reach_x, reach_y = (
            least + round(rng.random() * (end - start) / 4 - 0.5)
            for start, end in ((x0, x1), (y0, y1))
        )
        island = (
            x - reach_x // 2,
            y - reach_y // 2,
            x + reach_x - reach_x // 2,
            y + reach_y - reach_y // 2,
        )
        return _rooms(island, 0.5 * bay * bay, least, rng)
    number = int(rng.random() * (MAX_COLUMNS + 1))
    size = 1 + int(rng.random() < 0.3)
    spots = [x0 + round((k + 0.5) * (x1 - x0) / max(number, 1)) for k in range(number)]
    return [(spot, y, spot + size, y + size, SOLID) for spot in spots]


DIVIDED: Final[dict[str, Callable[[Part, Footprint, np.random.Generator], list[Block]]]] = {
    "cut": _cut,
    "hall way": _hall_way,
    "bar": _bar,
    "ring": _ring,
    "hall": _open,
}
