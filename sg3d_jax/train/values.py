"""Values of configurations, and of whatever a file states: of their type, and in their range.

A dataclass does not look at what it is given, and JSON knows no types: a width of "8", or of -8, is
found where it is read, and not by whatever breaks over it an hour later.
"""

import dataclasses
import sys
from collections.abc import Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from sg3d_jax.scene.ontology import Ontology

# What numbers may be: whole ones, and others, are not negative where their default is not, and at
# least 1 where it is that; but for these.
MAY_BE_ZERO: Final = ("certainty_passes", "resamplings", "warmup_steps")
MAY_BE_NEGATIVE: Final = ("threshold",)
SHARES: Final = ("p_node", "p_drop", "p_add", "any_cuts", "dropout", "ema_decay")
LARGEST: Final = 10_000  # of the sizes of a model: no array of them outgrows a machine;
DEEPEST: Final = 100  # of those that count layers
KINDS: Final[Mapping[Any, str]] = {
    int: "a whole number",
    float: "a number",
    str: "a text",
    bool: "True or False",
    NoneType: "None",
}


def check_values(config: Any, within: str = "") -> None:
    """Refuses values of a configuration that are of another type than stated, or that none can be.

    Args:
      config: the configuration, or a part of it.
      within: what the part is called, with a dot, such as "model.".

    Raises:
      ValueError: one sentence that names the field and what was expected.
    """
    for field in dataclasses.fields(config):
        name, value = f"{within}{field.name}", getattr(config, field.name)
        check_type(name, value, hints_of(config)[field.name])
        if dataclasses.is_dataclass(value) and not isinstance(value, Ontology):
            check_values(value, f"{name}.")
        sized = within.startswith(("model.", "flagg."))
        for number in value if isinstance(value, tuple) else (value,):
            if type(number) in (int, float):
                _check_range(name, number, field.default, sized)


def hints_of(made: Any) -> dict[str, Any]:
    """Returns the annotated types of the fields of a dataclass or a NamedTuple."""
    return get_type_hints(type(made), include_extras=True)


def check_type(name: str, value: Any, hint: Any) -> None:
    """Refuses a value that is not of its annotated type.

    Raises:
      ValueError: one sentence that names it, and what was expected.
    """
    if not fits(value, hint):
        kinds = " or ".join(dict.fromkeys(_kinds(hint)))
        raise ValueError(f"{name} is {value!r:.40}, expected {kinds}")


def fits(value: Any, hint: Any) -> bool:
    """Returns whether a value is of an annotated type; of one that is not known here, it is."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return fits(value, inner[0])
    if origin in (Union, UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return isinstance(value, str) and value in inner
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        each = (inner[0],) * len(value) if inner[-1] is Ellipsis else inner
        return len(value) == len(each) and all(map(fits, value, each))
    if origin is dict:
        return isinstance(value, dict) and all(
            fits(key, inner[0]) and fits(one, inner[1]) for key, one in value.items()
        )
    if hint is float:
        return type(value) in (int, float) and abs(value) <= sys.float_info.max  # false for nan
    if hint in (int, bool):
        return type(value) is hint
    return hint is Any or not isinstance(hint, type) or isinstance(value, hint)


def _kinds(hint: Any) -> Iterator[str]:
    """Yields what a value of an annotated type may be, in words."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        for one in inner:
            yield from _kinds(one)
    elif origin is Literal:
        yield from map(repr, inner)
    elif origin is tuple:
        yield f"several, each {next(_kinds(inner[0]))}"
    elif origin is Annotated:
        yield from _kinds(inner[0])
    else:
        yield KINDS.get(hint, f"a {getattr(hint, '__name__', hint)}")


def _check_range(name: str, value: int | float, default: Any, sized: bool) -> None:
    """Refuses a number that a field cannot have."""
    field = name.rpartition(".")[2]
    usual = default[0] if isinstance(default, tuple) and default else default
    usual = 1 if usual is None else usual
    if not isinstance(usual, (int, float)) or field in MAY_BE_NEGATIVE:
        return
    least = int(isinstance(usual, int) and usual >= 1 and field not in MAY_BE_ZERO)
    if usual >= 0 and value < least:
        raise ValueError(f"{name} is {value}, expected at least {least}")
    if field in SHARES and value > 1:
        raise ValueError(f"{name} is {value}, expected at most 1")
    most = DEEPEST if field.endswith(("layers", "depth")) else LARGEST
    if sized and value > most:
        raise ValueError(f"{name} is {value}, expected at most {most}")
