"""What detectors see beside planes: things with a class, a place and a size, as concepts and kinds.

`{"objects": [{"class": "couch", "centroid": [x, y, z], "size": [x, y, z]}, ...]}`, metres. A class
is the name of an observed concept, such as a door, or of a kind of one, such as a sofa among
objects; case, spaces, underscores and a plural s do not matter, and neither does which of several
names a label set has for it. What is called otherwise is of the concept whose layer is `OBJECTS`,
of unknown kind. The width is the greater horizontal extent, and 0 where no size is given.

Hydra's objects are read alike: their class is what the label names of the file call their semantic
label, or their own name; their size is that of their bounding box.

Source: MIT-SPARK/Spark-DSG, src/labelspace.cpp (label names); label sets of COCO, ADE20k, ScanNet,
NYUv2, Matterport3D, and those of Hydra.
"""

import functools
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from sg3d_jax.io.attributes import further
from sg3d_jax.io.files import number, vector
from sg3d_jax.io.records import KIND, Record, feature
from sg3d_jax.scene.ontology import FEATURES, Concept, Ontology

OBJECTS: Final = "OBJECTS"  # the layer of things of any class, as in Hydra
THINGS: Final = OBJECTS.lower()  # the list of them in a document
CLASS: Final = "class"
SIZE: Final = "size"
WIDTH: Final = "width"
LABEL_SPACES: Final = "labelspaces"  # where a file of Hydra's has the names of semantic labels

# What label sets call things, by what a concept or a kind may be called. ADE20k is often cut down
# to its first words, such as "swivel".
_NAMES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "bath": ("bathtub", "bath tub", "tub", "shower", "shower stall"),
        "bed": ("bunk bed", "crib", "cradle"),
        "board": ("whiteboard", "blackboard", "chalkboard", "bulletin board", "bulletin"),
        "chair": ("armchair", "office chair", "swivel chair", "swivel", "stool", "seat"),
        "cupboard": (
            *("cabinet", "kitchen cabinet", "bathroom cabinet", "file cabinet", "filing cabinet"),
            *("wardrobe", "closet", "dresser", "drawer", "chest of drawers", "chest"),
        ),
        "desk": ("office desk", "computer desk", "writing desk"),
        "door": ("doorway", "screen door", "sliding door", "glass door"),
        "fridge": ("refrigerator", "refridgerator", "freezer"),
        "shelf": ("shelves", "shelving", "bookshelf", "bookshelves", "bookcase"),
        "sink": ("basin", "washbasin", "kitchen sink", "bathroom sink"),
        "sofa": ("couch", "couches", "loveseat", "settee", "sofa bed"),
        "stairs": ("stair", "staircase", "stairway"),
        "stove": ("oven", "cooker", "cooktop", "hob"),
        "table": ("dining table", "coffee table", "coffee", "side table", "end table"),
        "toilet": ("wc", "urinal"),
        "washer": ("washing machine", "clothes dryer"),
    }
)
_OWN: Final = ("centroid", WIDTH, KIND)  # what is said of a node itself
_SYNONYMS: Final = {synonym: name for name, several in _NAMES.items() for synonym in several}


class Thing(NamedTuple):
    """What was made of something with a class."""

    record: Record
    word: str | None  # its class, as whatever found it calls it
    is_known: bool = True  # whether a concept or a kind is called so

    @property
    def said(self) -> dict[str, str]:
        """Its class as an attribute, if it has one."""
        return {CLASS: self.word} if self.word else {}


def things_in(
    items: Sequence[Any], ontology: Ontology, where: str
) -> tuple[list[tuple[Record, dict[str, Any]]], list[str]]:
    """Returns the nodes that a list of things stands for.

    Args:
      items: of a parsed document, not yet trusted. What one says of its node itself, as documents
        of graphs do, goes before: `kind` before `class`, and `width` before `size`.
      ontology: the concepts.
      where: what an error starts with, such as "scene.json: objects".

    Returns:
      The nodes, each with further keys of its object, and remarks.

    Raises:
      ValueError: one sentence that names the object, the field and what was expected.
    """
    made = [_thing_in(item, ontology, f"{where}[{index}]") for index, item in enumerate(items)]
    found = [
        (one.record, further(item, _OWN))
        for one, item in zip(made, items, strict=True)
        if one is not None
    ]
    return found, remarks_on(made, ontology)


def _thing_in(item: Any, ontology: Ontology, where: str) -> Thing | None:
    expected = f"an object with {CLASS}, centroid and {SIZE}"
    if not isinstance(item, dict):
        raise ValueError(f"{where} is {item!r:.40}, expected {expected}")
    if "centroid" not in item:
        raise ValueError(f"{where} lacks 'centroid', expected {expected}")
    if odd := [name for name in FEATURES if name in item and name not in _OWN]:
        raise ValueError(f"{where} has {odd[0]!r}, expected {expected}")
    word = item.get(CLASS)
    if not isinstance(word, (str, type(None))):
        raise ValueError(f"{where}.{CLASS} is {word!r:.40}, expected a word")
    centroid = vector(item["centroid"], f"{where}.centroid")
    said = item.get(WIDTH)
    width = _width_of(item.get(SIZE), f"{where}.{SIZE}")
    width = width if said is None else number(said, f"{where}.{WIDTH}")
    made = _thing(word, centroid, width, ontology)
    other, kind = _concept_of_others(ontology), item.get(KIND)
    if kind is None or other is None or KIND not in ontology.concepts[other].features:
        return made
    found = feature(KIND, kind, f"{where}.{KIND}", ontology.concepts[other])
    return Thing(_record(other, found, centroid, width, ontology), word)


def thing_seen(
    record: Record, attributes: Mapping[str, Any], names: Mapping[int, str], ontology: Ontology
) -> Thing | None:
    """Returns what a node of the objects of Hydra is; None if a node is in another layer.

    Args:
      record: of the node, without features.
      attributes: of the node, not yet trusted; what is no label, name or box says nothing.
      names: of `label_names`.
      ontology: the concepts.
    """
    if record.label != _concept_of_others(ontology):
        return None
    label, name = attributes.get("semantic_label"), attributes.get("name")
    word = names.get(label) if isinstance(label, int) else None
    if word is None and isinstance(name, str) and len(_words(name)) > 1:  # no symbol, such as O(3)
        word = _words(name)
    box = attributes.get("bounding_box")
    box = box if isinstance(box, dict) else {}
    try:
        width = _width_of(box.get("dimensions"), "")
    except ValueError:
        width = 0.0
    return _thing(word, record.position, width, ontology)


def remarks_on(things: Sequence[Thing | None], ontology: Ontology) -> list[str]:
    """Returns a sentence on things that nothing is called like, and on those that are left out."""
    remarks = []
    unknown = [one.word or "without a class" for one in things if one and not one.is_known]
    if unknown:
        held = ", ".join(f"{count} {word}" for word, count in Counter(unknown).most_common())
        remarks.append(f"took {len(unknown)} for {THINGS} of unknown kind: {held}")
    if left_out := things.count(None):
        known = ", ".join(ontology.names)
        remarks.append(f"left out {left_out} of {THINGS}: the concepts known are {known}")
    return remarks


def label_names(metadata: Any, layer: int, partition: int) -> dict[int, str]:
    """Returns the names of the semantic labels of a layer, if the metadata of a document has some.

    Args:
      metadata: of a Spark-DSG document, not yet trusted.
      layer: number of the layer.
      partition: of it.
    """
    spaces = metadata.get(LABEL_SPACES) if isinstance(metadata, dict) else None
    pairs = spaces.get(f"_l{layer}p{partition}") if isinstance(spaces, dict) else None
    if not isinstance(pairs, list):
        return {}
    return {
        pair[0]: pair[1]
        for pair in pairs
        if isinstance(pair, list) and [*map(type, pair)] == [int, str]
    }


def _thing(
    word: str | None, position: list[float], width: float, ontology: Ontology
) -> Thing | None:
    """Returns the node of something with a class; None if the ontology has no concept for it."""
    names = _known(ontology)
    if (
        called := next(filter(names.__contains__, _readings(_words(word or ""))), None)
    ) is not None:
        return Thing(_record(*names[called], position, width, ontology), word)
    if (other := _concept_of_others(ontology)) is None:
        return None
    is_known = not ontology.concepts[other].kinds
    return Thing(_record(other, 0.0, position, width, ontology), word, is_known)


def _record(
    label: int, kind: Any, position: list[float], width: float, ontology: Ontology
) -> Record:
    said = {WIDTH: width, KIND: kind}
    features = {name: said[name] for name in ontology.concepts[label].features}
    return Record(label, position, features)


def _width_of(size: Any, where: str) -> float:
    """Returns the greater horizontal extent of a size, 0 of none."""
    if size is None:
        return 0.0
    extents = vector(size, where, 2 if isinstance(size, list) and len(size) == 2 else 3)
    if not all(math.isfinite(extent) and extent >= 0 for extent in extents):
        raise ValueError(f"{where} is {size!r:.40}, expected zero metres or more")
    return max(extents[:2])


def _words(text: str) -> str:
    """Returns the words of a name in lower case, without numbers, parted by single spaces."""
    return " ".join(re.findall(r"[^\W\d_]+", text.lower()))


def _readings(called: str) -> list[str]:
    """Returns what a class may stand for: itself, its synonym, and those of its singular."""
    singular = called.removesuffix("s")
    return [called, _SYNONYMS.get(called, ""), singular, _SYNONYMS.get(singular, "")]


@functools.lru_cache
def _known(ontology: Ontology) -> dict[str, tuple[int, float]]:
    """Returns the label and the kind of every class that the ontology has a name for."""
    things = [(label, c) for label, c in enumerate(ontology.concepts) if is_thing(c)]
    kinds = {
        _words(kind): (label, 1.0 + place)
        for label, concept in things
        for place, kind in enumerate(concept.kinds)
    }
    return kinds | {_words(concept.name): (label, 0.0) for label, concept in things}


@functools.lru_cache
def _concept_of_others(ontology: Ontology) -> int | None:
    """Returns the label of what a thing is that nothing is called like, None if there is none."""
    labels = [i for i, c in enumerate(ontology.concepts) if is_thing(c) and c.layer == OBJECTS]
    return labels[0] if labels else None


def is_thing(concept: Concept) -> bool:
    """Returns whether a class, a place and a size are all that a node of a concept needs."""
    return concept.observed and {*concept.features} <= {WIDTH, KIND}
