"""`sg3d weights`: the weights at hand, each with its card."""

from typing import Any

from rich.console import Console
from rich.table import Table

from sg3d_jax.cli.arguments import Positional


def weights(names: Positional[tuple[str, ...]] = ()) -> None:
    """List weights, what they were trained on, and how well they complete what.

    Args:
      names: weights by name, or npz files; by default those that come with the package.
    """
    from sg3d_jax.train import DEFAULT_WEIGHTS
    from sg3d_jax.train.weights import load_weights
    from sg3d_jax.train.weights import names as shipped

    table = Table("weights", "trained on", "scenes of", "FGW / exact, test scenes")
    for name in names or shipped():
        trained = load_weights(name)
        shown = f"{name} (default)" if name == DEFAULT_WEIGHTS else name
        table.add_row(shown, *_row(trained))
    Console(soft_wrap=False).print(table)


def _row(trained: Any) -> tuple[str, str, str]:
    """Returns what the columns say of weights."""
    from sg3d_jax.train.card import described

    card, config = trained.card, trained.config
    if card is None:
        return f"{config.data.label}, {config.steps} steps", "", ""
    trained_on = [f"{card.graphs} graphs of {config.data.label}, {config.steps} steps"]
    scores = [
        f"{score.data}: {score.fgw:.4f} / {score.exact:.2f}, {score.graphs}"
        for score in card.scores
    ]
    likes = described(card, config.ontology.observed_plural)
    return "\n".join(trained_on + [card.history] * bool(card.history)), likes, "\n".join(scores)
