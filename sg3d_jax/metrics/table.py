"""The paper's tables from result files: our row of each method under the paper's.

A result is what `sg3d evaluate -o` writes: `method`, `weights`, `data` and, for each score of
`metrics.paper`, its `mean` and `sd` over the seeds under `scores`; also `graphs`, how many scenes
were completed, of `split_graphs` that the `split` has.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from sg3d_jax.metrics.paper import HEADINGS, PAPER, SCORES, TITLES

FORMATS: Final = ("markdown", "latex")
MISSING: Final = "-"
MAX_SCORE: Final = 1e100


class Row(NamedTuple):
    """One method on one data set."""

    method: str  # as the table calls it
    cells: tuple[str, ...]  # one a score


def rows_by_data(results: Sequence[Mapping[str, Any]]) -> dict[str, list[Row]]:
    """Returns the rows of each data set: methods in the paper's order, its row above ours.

    Results of other methods come last. Of several results of one method, each tells its weights; a
    result of fewer scenes than its split has tells how many.

    Raises:
      ValueError: a result is none; the sentence says which result and field.
    """
    for index, result in enumerate(results):
        check_result(result, f"result {index}")
    seen = Counter((result["data"], result["method"]) for result in results)
    tables = {}
    for data in dict.fromkeys(result["data"] for result in results):
        ours: dict[str, list[Row]] = {method: [] for method in TITLES}
        of_data = [result for result in results if result["data"] == data]
        for result in of_data:
            of_split = [other for other in of_data if other.get("split") == result.get("split")]
            most = max(other.get("graphs", 0) for other in of_split)
            row = _row(result, seen[data, result["method"]] > 1, _is_partial(result, most))
            ours.setdefault(result["method"], []).append(row)
        published = PAPER.get(data, {})
        tables[data] = [
            row
            for method, rows in ours.items()
            for row in [*_published(method, published.get(method)), *rows]
        ]
    return tables


def check_result(result: Any, where: str) -> None:
    """Refuses what `sg3d evaluate -o` has not written.

    Args:
      result: parsed JSON, not yet trusted.
      where: what the sentence starts with, such as the name of the file.

    Raises:
      ValueError: one sentence that names the field and what was expected.
    """
    if not isinstance(result, Mapping):
        raise ValueError(f"{where}: is {result!r:.40}, expected what `sg3d evaluate -o` writes")
    for field, (fits, expected) in _FIELDS.items():
        if field not in result and field in _REQUIRED:
            raise ValueError(f"{where} lacks {field!r}, expected `sg3d evaluate -o`")
        if field in result and not fits(result[field]):
            raise ValueError(f"{where}: {field} is {result[field]!r:.40}, expected {expected}")
    for name, score in result["scores"].items():
        here = f"{where}: scores.{name!r:.40}"
        mean, sd = (score.get(k) if isinstance(score, Mapping) else None for k in ("mean", "sd"))
        if not _is_finite(mean):
            raise ValueError(f"{here} has the mean {mean!r:.40}, expected a finite number")
        if sd is not None and not (_is_finite(sd) and sd >= 0):
            raise ValueError(f"{here} has the sd {sd!r:.40}, expected a number from 0, or null")


def _is_line(value: Any) -> bool:
    return isinstance(value, str) and value.isprintable() and "|" not in value


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 < value < 2**63


def _is_finite(value: Any) -> bool:
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return known and -MAX_SCORE <= value <= MAX_SCORE


_REQUIRED: Final = ("method", "data", "scores")
_FIELDS: Final[Mapping[str, tuple[Callable[[Any], bool], str]]] = {
    "method": (_is_line, "a name of one line"),
    "data": (_is_line, "a name of one line"),
    "scores": (lambda value: isinstance(value, Mapping), "an object"),
    "weights": (lambda value: value is None or _is_line(value), "a name of one line, or null"),
    "split": (_is_line, "a name of one line"),
    "command": (lambda value: isinstance(value, str), "a text"),
    "graphs": (_is_count, "a number from 1"),
    "split_graphs": (_is_count, "a number from 1"),
    "candidates": (_is_count, "a number from 1"),
}


def _is_partial(result: Mapping[str, Any], most: int) -> bool:
    """Returns whether a result is of fewer scenes than its split has, as far as one can tell."""
    graphs = result.get("graphs", most)
    whole = result.get("split_graphs")
    if whole is None:  # written by an older version, which tells it by the command alone
        return graphs < most or ("graphs" in result and "--num-graphs" in result.get("command", ""))
    return graphs < whole


def render(results: Sequence[Mapping[str, Any]], to: str = "markdown") -> str:
    """Returns the tables of all data sets as text.

    Args:
      results: see the module.
      to: one of `FORMATS`.

    Raises:
      ValueError: an unknown format, or a result that lacks a field.
    """
    if to not in FORMATS:
        raise ValueError(f"the format is {to!r}, expected one of {', '.join(FORMATS)}")
    draw = _markdown if to == "markdown" else _latex
    tables = rows_by_data(results)
    return "\n".join(draw(data, rows) for data, rows in tables.items())


def _row(result: Mapping[str, Any], with_weights: bool, with_graphs: bool) -> Row:
    """Returns the row of a result."""
    title = TITLES.get(result["method"], result["method"])
    if with_weights and result.get("weights"):
        title = f"{title} ({result['weights']})"
    if (candidates := result.get("candidates", 1)) > 1:
        title = f"{title}, consensus of {candidates}"
    if with_graphs:
        title = f"{title}, {result['graphs']} scenes"
    return Row(title, tuple(_cell(result["scores"].get(name)) for name in SCORES))


def _published(method: str, values: Sequence[float] | None) -> list[Row]:
    """Returns the paper's row of a method, if it has one."""
    if values is None:
        return []
    cells = [f"{value:.2f}" for value in values] + [MISSING] * (len(SCORES) - len(values))
    return [Row(f"{TITLES[method]} (paper)", tuple(cells))]


def _cell(score: Mapping[str, float] | None) -> str:
    """Returns a mean, with its standard deviation where there are several seeds."""
    if score is None:
        return MISSING
    spread = score.get("sd")
    return f"{score['mean']:.3f}" + ("" if spread is None else f" ± {spread:.3f}")


def _markdown(data: str, rows: Sequence[Row]) -> str:
    lines = [
        (data, *HEADINGS),
        ("---", *["---:"] * len(HEADINGS)),
        *((r.method, *r.cells) for r in rows),
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _latex(data: str, rows: Sequence[Row]) -> str:
    """Returns a tabular that needs the package booktabs."""
    lines = [[_escaped(data), *HEADINGS]]
    for row in rows:
        lines.append([_escaped(row.method), *(c.replace("±", r"$\pm$") for c in row.cells)])
    head, *body = (" & ".join(line) + r" \\" for line in lines)
    columns = "l" + "r" * len(HEADINGS)
    begin = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule"]
    return "\n".join([*begin, *body, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _escaped(text: str) -> str:
    """Returns text that LaTeX prints as it is."""
    for symbol in "_&%#":
        text = text.replace(symbol, f"\\{symbol}")
    return text.replace("□", r"$\square$")
