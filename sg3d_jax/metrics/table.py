"""The paper's tables from result files: our row of each method under the paper's.

A result is what `sg3d evaluate -o` writes: `method`, `weights`, `data` and, for each score of
`metrics.paper`, its `mean` and `sd` over the seeds under `scores`.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from sg3d_jax.metrics.paper import HEADINGS, PAPER, SCORES, TITLES

FORMATS: Final = ("markdown", "latex")
MISSING: Final = "-"


class Row(NamedTuple):
    """One method on one data set."""

    method: str  # as the table calls it
    cells: tuple[str, ...]  # one a score


def rows_by_data(results: Sequence[Mapping[str, Any]]) -> dict[str, list[Row]]:
    """Returns the rows of each data set: methods in the paper's order, its row above ours.

    Results of other methods come last. Of several results of one method, each tells its weights; a
    result of fewer scenes than another of its split tells how many.

    Raises:
      ValueError: a result lacks a field; the sentence says which result and field.
    """
    for index, result in enumerate(results):
        for field in ("method", "data", "scores"):
            if field not in result:
                raise ValueError(f"result {index} lacks {field!r}, expected `sg3d evaluate -o`")
    seen = Counter((result["data"], result["method"]) for result in results)
    tables = {}
    for data in dict.fromkeys(result["data"] for result in results):
        ours: dict[str, list[Row]] = {method: [] for method in TITLES}
        of_data = [result for result in results if result["data"] == data]
        for result in of_data:
            of_split = [other for other in of_data if other.get("split") == result.get("split")]
            most = max(other.get("graphs", 0) for other in of_split)
            row = _row(result, seen[data, result["method"]] > 1, result.get("graphs", most) < most)
            ours.setdefault(result["method"], []).append(row)
        published = PAPER.get(data, {})
        tables[data] = [
            row
            for method, rows in ours.items()
            for row in [*_published(method, published.get(method)), *rows]
        ]
    return tables


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
