"""Concepts as data: what the nodes of a scene graph stand for, and how they belong together.

An `Ontology` is hashable and has no arrays in it. A graph carries it in its tree structure
(`graph.globals`), configurations and weights store it, files name it unless it is the default:
whatever must know of a concept asks there. The default is that of the paper.

Source: paper, Sec. "Problem definition".
"""

import dataclasses
import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, get_origin

import jax
import numpy as np

RELATIONS: Final = ("proximity", "part_of")
PROXIMITY, PART_OF = range(len(RELATIONS))
NUM_RELATIONS: Final = len(RELATIONS)

# What a node may have beside its position, and the shape of it: fields of `graph.Nodes`. Which
# concepts have which is said by the ontology; formats and checks go through this table.
FEATURES: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {"normal": (3,), "width": (), "kind": ()}
)


@dataclasses.dataclass(frozen=True)
class Concept:
    """One kind of nodes.

    Attributes:
      name: lower case, singular.
      colour: of its dots, "#rrggbb": how it is drawn, and not what it is, so that what differs in
        colours alone is equal.
      letter: of its node symbols in Spark-DSG, one ASCII letter.
      layer: its layer in Spark-DSG, upper case, plural.
      observed: whether its nodes are given, and never generated.
      features: what its nodes have beside a position, of `FEATURES`; zero for all others.
      kinds: what its nodes may be, such as chairs among objects; the feature `kind` of a node is
        its place among them, counted from 1, and 0 where it is unknown. Kinds of what is observed
        are given, those of what is grown are found in the complete graph.
      least_parts: fewer parts than this are odd.
      above: whether a node stands above its parts, and not amid them.
      hears_kin: whether its nodes hear of the nearest others of their own concept in the encoder.
    """

    name: str
    colour: str = dataclasses.field(compare=False)
    letter: str
    layer: str
    observed: bool = False
    features: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    least_parts: int = 1
    above: bool = False
    hears_kin: bool = False

    def __post_init__(self) -> None:
        """Makes tuples of lists, so that it can be hashed."""
        for field in ("features", "kinds"):
            if isinstance(value := getattr(self, field), list):
                object.__setattr__(self, field, tuple(value))


@dataclasses.dataclass(frozen=True)
class Rule:
    """That nodes of one concept may be part of nodes of another.

    Attributes:
      part: the name of the lower concept.
      whole: the name of the upper one.
      single: whether a part has exactly one such whole, and not any number of them.
    """

    part: str
    whole: str
    single: bool = True


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Ontology:
    """The concepts of a kind of scenes, bottom-up, and which of them may be part of which.

    Labels are places in `concepts`: where `label[i] < label[j]`, node i can be part of node j but
    never the reverse, and is inserted before it unless another order is asked for.

    Attributes:
      concepts: bottom-up; any sequence becomes a tuple.
      rules: what may be part of what, likewise.

    Raises:
      ValueError: names, letters or layers repeat, a feature is unknown, a rule names no two
        concepts bottom-up, nothing is observed, or everything is.
    """

    concepts: tuple[Concept, ...]
    rules: tuple[Rule, ...]

    def __post_init__(self) -> None:
        """Refuses what is no ontology."""
        object.__setattr__(self, "concepts", tuple(self.concepts))
        object.__setattr__(self, "rules", tuple(self.rules))
        for field in ("name", "letter", "layer"):
            values = [getattr(concept, field) for concept in self.concepts]
            if odd := [value for value in values if not value.isprintable()]:
                raise ValueError(f"ontology: {field} is {odd[0]!r:.40}, expected one line")
            if repeated := [value for value in values if values.count(value) > 1]:
                raise ValueError(f"ontology: {field} {repeated[0]!r} is there twice, expected once")
        for concept in self.concepts:
            letter, colour = concept.letter, concept.colour
            if not (len(letter) == 1 and letter.isascii() and letter.isalpha()):
                raise ValueError(f"ontology: letter of {concept.name} is {letter!r}, expected one")
            if not (len(colour) == 7 and colour[0] == "#" and _is_hex(colour[1:])):
                raise ValueError(
                    f"ontology: colour of {concept.name} is {colour!r}, expected such as '#1d4ed8'"
                )
            if unknown := [name for name in concept.features if name not in FEATURES]:
                known = ", ".join(FEATURES)
                raise ValueError(
                    f"ontology: feature of {concept.name} is {unknown[0]!r}, expected of {known}"
                )
            _check_kinds(concept)
        if self.is_observed.all() or not self.is_observed.any():
            raise ValueError("ontology: expected concepts that are observed, and others that grow")
        for rule in self.rules:
            if self.label_of(rule.part) >= self.label_of(rule.whole):
                raise ValueError(
                    f"ontology: {rule.part} is part of {rule.whole}, expected a concept further up"
                )

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the concepts, in the order of their labels."""
        return tuple(concept.name for concept in self.concepts)

    @property
    def num_concepts(self) -> int:
        """C, how many concepts there are."""
        return len(self.concepts)

    @functools.cached_property
    def is_observed(self) -> np.ndarray:
        """bool[C], which concepts are given."""
        return np.array([concept.observed for concept in self.concepts], bool)

    @functools.cached_property
    def observed_plural(self) -> str:
        """What messages call observed nodes, such as "planes"."""
        return " or ".join(concept.layer.lower() for concept in self.concepts if concept.observed)

    @functools.cached_property
    def is_above(self) -> np.ndarray:
        """bool[C], which concepts stand above their parts."""
        return np.array([concept.above for concept in self.concepts], bool)

    @functools.cached_property
    def hears_kin(self) -> np.ndarray:
        """bool[C], which concepts hear of their kin."""
        return np.array([concept.hears_kin for concept in self.concepts], bool)

    @functools.cached_property
    def may_be_part(self) -> np.ndarray:
        """bool[C, C], whether the concept of a row may be part of that of a column."""
        table = np.zeros((self.num_concepts, self.num_concepts), bool)
        for rule in self.rules:
            table[self.label_of(rule.part), self.label_of(rule.whole)] = True
        return table

    @functools.cached_property
    def single_wholes(self) -> tuple[tuple[int, int], ...]:
        """Pairs of labels (part, whole) where a part has exactly one whole."""
        pairs = [(rule.part, rule.whole) for rule in self.rules if rule.single]
        return tuple((self.label_of(part), self.label_of(whole)) for part, whole in pairs)

    @functools.cached_property
    def has_one_whole(self) -> np.ndarray:
        """bool[C, C], whether parts of a row's concept have exactly one whole of a column's."""
        table = np.zeros((self.num_concepts, self.num_concepts), bool)
        for part, whole in self.single_wholes:
            table[part, whole] = True
        return table

    @functools.cached_property
    def is_top(self) -> np.ndarray:
        """bool[C], which concepts hold all there is: wholes of single parts, and in no such."""
        single = self.has_one_whole
        return single.any(axis=0) & ~single.any(axis=1) & ~self.is_observed

    def has(self, feature: str) -> np.ndarray:
        """Returns bool[C], the concepts whose nodes have a feature."""
        return np.array([feature in concept.features for concept in self.concepts], bool)

    @functools.cached_property
    def features(self) -> tuple[str, ...]:
        """The features that some concept has, in the order of `FEATURES`."""
        return tuple(name for name in FEATURES if self.has(name).any())

    @functools.cached_property
    def num_kinds(self) -> np.ndarray:
        """int[C], how many kinds the nodes of each concept may be of."""
        return np.array([len(concept.kinds) for concept in self.concepts])

    def label_of(self, name: str) -> int:
        """Returns the label of a concept.

        Raises:
          ValueError: there is no such concept.
        """
        if name not in self.names:
            known = ", ".join(self.names)
            raise ValueError(f"unknown concept {name!r:.40}, expected one of {known}")
        return self.names.index(name)

    def to_dict(self) -> dict[str, Any]:
        """Returns the ontology as JSON values."""
        return dataclasses.asdict(self)

    def __reduce__(self) -> tuple[type["Ontology"], tuple[Any, ...]]:
        """Pickles without what is cached: hashes of strings are those of one process."""
        return Ontology, (self.concepts, self.rules)

    def __hash__(self) -> int:
        """Hashes once: every call of a compiled function asks for it."""
        return self._hash

    @functools.cached_property
    def _hash(self) -> int:
        return hash((self.concepts, self.rules))


def _check_kinds(concept: Concept) -> None:
    """Refuses kinds without the feature, the feature without kinds, and kinds that repeat."""
    kinds = concept.kinds
    if bool(kinds) != ("kind" in concept.features):
        held = ", ".join(concept.features) or "none"
        problem = f"kinds of {concept.name} are {list(kinds)}, its features {held}"
        raise ValueError(f"ontology: {problem}, expected kinds and the feature kind, or neither")
    if odd := [kind for kind in kinds if not (kind and kind.isprintable())]:
        raise ValueError(f"ontology: kind of {concept.name} is {odd[0]!r:.40}, expected one line")
    if repeated := [kind for kind in kinds if kinds.count(kind) > 1]:
        problem = f"kind {repeated[0]!r:.40} of {concept.name} is there twice"
        raise ValueError(f"ontology: {problem}, expected once")


def ontology_from_dict(values: Any, where: str = "ontology") -> Ontology:
    """Returns the ontology of `Ontology.to_dict`, or of its JSON; of None, the paper's.

    Raises:
      ValueError: one sentence that says where what is wrong with it.
    """
    if values is None:
        return PAPER_ONTOLOGY
    try:
        concepts = tuple(_record(Concept, concept) for concept in values["concepts"])
        made = Ontology(concepts, tuple(_record(Rule, rule) for rule in values["rules"]))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{where}: expected concepts and rules, got {values!r:.40}") from error
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return PAPER_ONTOLOGY if made == PAPER_ONTOLOGY else made  # one object is compared faster


def _record(kind: Any, values: Mapping[str, Any]) -> Any:
    """Returns a dataclass of JSON values; its lists are tuples.

    Raises:
      TypeError: a field is unknown, lacking, or of another type.
    """
    made = kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
    for field in dataclasses.fields(kind):
        expected: Any = get_origin(field.type) or field.type
        if not isinstance(getattr(made, field.name), expected):
            raise TypeError(field.name)
    return made


def _is_hex(text: str) -> bool:
    return all(digit in "0123456789abcdefABCDEF" for digit in text)


# The paper's concepts, in colours that the colour-blind can tell apart. Walls have no whole: the
# one exception to its strict hierarchy. A plane may bound several walls, but one room.
PAPER_ONTOLOGY: Final = Ontology(
    concepts=(
        Concept("plane", "#1d4ed8", "p", "PLANES", observed=True, features=("normal", "width")),
        Concept("wall", "#fbbf24", "w", "WALLS", least_parts=2),
        Concept("room", "#e6160b", "R", "ROOMS", hears_kin=True),
        Concept("floor", "#1a9961", "F", "FLOORS", hears_kin=True),
        Concept("building", "#00d8fd", "B", "BUILDINGS", above=True, hears_kin=True),
        Concept("city", "#111111", "C", "CITIES", above=True, hears_kin=True),
    ),
    rules=(
        Rule("plane", "wall", single=False),
        Rule("plane", "room"),
        Rule("room", "floor"),
        Rule("floor", "building"),
        Rule("building", "city"),
    ),
)

# Its labels, for what knows it alone: generators, readers of other programs' files, baselines.
PLANE, WALL, ROOM, FLOOR, BUILDING, CITY = range(PAPER_ONTOLOGY.num_concepts)
