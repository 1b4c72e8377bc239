"""`sg3d weights`: the weights at hand, each with its card."""

from collections.abc import Sequence
from typing import Any, Final

from rich.table import Table

from sg3d_jax.cli.arguments import OptionalOutput, Positional, check_output, print_table

PREFACE: Final = """\
# Weights

What weights were trained on, and how well they complete test scenes. FGW is a distance, 0 for equal
graphs; exact is the share of graphs whose edges are all right. `sg3d weights -o FILE` wrote this.
"""


def weights(names: Positional[tuple[str, ...]] = (), output: OptionalOutput = None) -> None:
    """List weights, what they were trained on, and how well they complete what.

    Args:
      names: weights by name, or npz files; by default those that come with the package.
      output: also write the cards as Markdown, a section for each.
    """
    from sg3d_jax.io.files import replacing
    from sg3d_jax.train import DEFAULT_WEIGHTS
    from sg3d_jax.train.weights import load_weights
    from sg3d_jax.train.weights import names as shipped

    check_output(output, (".md",))
    table, sections = Table("weights", "trained on", "scenes of", "FGW / exact, test scenes"), []
    for name in names or shipped():
        trained = load_weights(name)
        shown = f"{name} (default)" if name == DEFAULT_WEIGHTS else name
        table.add_row(shown, *("\n".join(lines) for lines in _told(trained)))
        sections.append(_section(shown, trained))
    print_table(table)
    if output is not None:
        with replacing(output) as temporary:
            temporary.write_text("\n".join([PREFACE, *sections]), encoding="utf-8")


def _told(trained: Any) -> tuple[list[str], list[str], list[str]]:
    """Returns what the columns say of weights, lines each."""
    from sg3d_jax.train.card import described

    card, config = trained.card, trained.config
    if card is None:
        return [f"{config.data.label}, {config.steps} steps"], [], []
    trained_on = [f"{card.graphs} graphs of {config.data.label}, {config.steps} steps"]
    scores = [
        f"{score.data}: {score.fgw:.4f} / {score.exact:.2f}, {score.graphs}"
        for score in card.scores
    ]
    likes = described(card, config.ontology.observed_plural)
    return trained_on + [card.history] * bool(card.history), likes.splitlines(), scores


def _section(name: str, trained: Any) -> str:
    """Returns the card of weights as Markdown."""
    import jax

    trained_on, likes, _ = _told(trained)
    leaves = jax.tree.leaves(trained.params)
    about = {
        "method": f"{trained.config.method}, {sum(leaf.size for leaf in leaves):,} parameters",
        "trained on": ". ".join(trained_on),
        "scenes of": "; ".join(likes),
    }
    lines = [f"## {name}", "", *_rows(("", ""), about.items())]
    if trained.card is not None and trained.card.scores:
        rows = [
            (score.data, score.graphs, f"{score.fgw:.4f}", f"{score.exact:.0%}")
            for score in trained.card.scores
        ]
        lines += ["", *_rows(("test scenes of", "graphs", "FGW", "exact"), rows)]
    return "\n".join([*lines, ""])


def _rows(head: Sequence[str], rows: Any) -> list[str]:
    """Returns a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines]
