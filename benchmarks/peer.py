"""The peer: a dense graph transformer of DiGress's size, which denoises whole graphs in 500 steps.

Written for comparing costs. Nodes, all pairs of them and one vector of the whole graph pass through
five layers, at every step anew; parameters are random, so shapes and products are right and what is
drawn means nothing. DiGress's spectral features, and all that its sampling does beside the network
and the draw, are left out, in the peer's favour. One text serves JAX and PyTorch: it uses only what
both of them call alike.

Source: Vignac et al. 2023, DiGress, Sec. 4 and its configuration for larger graphs.
"""

from typing import Any, Final

import numpy as np

STEPS: Final = 500
LAYERS: Final = 5
NODE, PAIR, WHOLE = 256, 64, 64  # widths of the states,
NODE_HIDDEN, PAIR_HIDDEN, WHOLE_HIDDEN = 256, 128, 128  # and of the layers behind attention
CONCEPTS, RELATIONS = 6, 2
HEADS: Final = 8

Params = dict[str, Any]


def draw_params(seed: int = 0) -> Params:
    """Returns random parameters, numpy arrays by name."""
    rng = np.random.default_rng(seed)
    params: Params = {}

    def dense(name: str, wide: int, out: int) -> None:
        params[name] = rng.normal(0, wide**-0.5, (wide, out)).astype(np.float32)
        params[f"{name}_bias"] = np.zeros(out, np.float32)

    states = (
        ("node", CONCEPTS, NODE, NODE_HIDDEN),
        ("pair", RELATIONS, PAIR, PAIR_HIDDEN),
        ("whole", 1, WHOLE, WHOLE_HIDDEN),
    )
    for state, wide, width, hidden in states:
        dense(f"{state}_in", wide, hidden)
        dense(f"{state}_in_2", hidden, width)
        dense(f"{state}_out", width, hidden)
        dense(f"{state}_out_2", hidden, wide)
    for layer in range(LAYERS):
        for name in ("query", "key", "value", "attended"):
            dense(f"{layer}_{name}", NODE, NODE)
        for name in ("pair_scale", "pair_shift"):
            dense(f"{layer}_{name}", PAIR, NODE)
        for name, width in (("to_pair", PAIR), ("to_node", NODE)):
            dense(f"{layer}_{name}_scale", WHOLE, NODE)
            dense(f"{layer}_{name}_shift", WHOLE, NODE)
            dense(f"{layer}_{name}", NODE, width)
        dense(f"{layer}_of_nodes", 4 * NODE, WHOLE)
        dense(f"{layer}_of_pairs", 4 * PAIR, WHOLE)
        dense(f"{layer}_whole", WHOLE, WHOLE)
        dense(f"{layer}_whole_2", WHOLE, WHOLE)
        for state, _, width, hidden in states:
            dense(f"{layer}_{state}_hidden", width, hidden)
            dense(f"{layer}_{state}_hidden_2", hidden, width)
    return params


def predict(library: Any, params: Params, nodes: Any, pairs: Any, whole: Any) -> tuple[Any, Any]:
    """Predicts the clean graph.

    Args:
      library: `jax.numpy`, or `torch`.
      params: of `draw_params`, in its arrays.
      nodes: float[B, N, CONCEPTS], one-hot and noisy.
      pairs: float[B, N, N, RELATIONS], likewise.
      whole: float[B, 1], the time.

    Returns:
      Logits of the shapes of nodes and pairs.
    """

    def dense(name: str, values: Any) -> Any:
        return values @ params[name] + params[f"{name}_bias"]

    def two(name: str, values: Any) -> Any:
        return dense(f"{name}_2", _relu(library, dense(name, values)))

    nodes, pairs, whole = two("node_in", nodes), two("pair_in", pairs), two("whole_in", whole)
    for layer in range(LAYERS):
        query, key, value = (dense(f"{layer}_{name}", nodes) for name in ("query", "key", "value"))
        scores = query[:, :, None] * key[:, None] * (NODE // HEADS) ** -0.5  # a score a channel
        scores = scores * (1 + dense(f"{layer}_pair_scale", pairs))
        scores = scores + dense(f"{layer}_pair_shift", pairs)

        def told(name: str, values: Any, layer: int = layer, whole: Any = whole) -> Any:
            """Lets the whole graph have a word in values, and maps them."""
            scale, shift = (
                dense(f"{layer}_{name}_{part}", whole)[(slice(None), *[None] * (values.ndim - 2))]
                for part in ("scale", "shift")
            )
            return dense(f"{layer}_{name}", values * (1 + scale) + shift)

        attended = (_softmax(library, scores, 2) * value[:, None]).sum(axis=2)
        changes = {
            "node": told("to_node", dense(f"{layer}_attended", attended)),
            "pair": told("to_pair", scores),
            "whole": two(
                f"{layer}_whole",
                whole
                + dense(f"{layer}_of_nodes", _summary(library, nodes, (1,)))
                + dense(f"{layer}_of_pairs", _summary(library, pairs, (1, 2))),
            ),
        }
        states = {"node": nodes, "pair": pairs, "whole": whole}
        for name, change in changes.items():
            state = _normed(states[name] + change)
            states[name] = _normed(state + two(f"{layer}_{name}_hidden", state))
        nodes, pairs, whole = states["node"], states["pair"], states["whole"]
    logits = two("pair_out", pairs)
    return two("node_out", nodes), logits + logits.swapaxes(1, 2)


def step(library: Any, params: Params, nodes: Any, pairs: Any, time: float, drawn: Any) -> Any:
    """Takes one reverse step.

    Args:
      library: `jax.numpy`, or `torch`.
      params: of `draw_params`.
      nodes: float[B, N, CONCEPTS], one-hot.
      pairs: float[B, N, N, RELATIONS], one-hot and symmetric.
      time: 0 to 1; how much of the graph stays as it is.
      drawn: uniform numbers of the shapes of nodes and pairs.

    Returns:
      Nodes and pairs a step earlier.
    """
    whole = nodes[:, 0, :1] * 0 + time
    states = []
    for noisy, logits, uniform in zip(
        (nodes, pairs), predict(library, params, nodes, pairs, whole), drawn, strict=True
    ):
        shares = time * noisy + (1 - time) * _softmax(library, logits, -1)
        chances = library.log(shares + 1e-9) - library.log(1e-9 - library.log(uniform + 1e-9))
        states.append((chances >= library.amax(chances, axis=-1, keepdims=True)) * 1.0)
    upper = library.triu(states[1].swapaxes(1, 3), 1)  # [B, RELATIONS, N, N]
    return states[0], (upper + upper.swapaxes(2, 3)).swapaxes(1, 3)


def _relu(library: Any, values: Any) -> Any:
    return library.where(values > 0, values, 0.0)


def _softmax(library: Any, values: Any, axis: int) -> Any:
    shares = library.exp(values - library.amax(values, axis=axis, keepdims=True))
    return shares / shares.sum(axis=axis, keepdims=True)


def _normed(values: Any) -> Any:
    """Normalises the last axis."""
    centred = values - values.mean(axis=-1, keepdims=True)
    return centred * ((centred**2).mean(axis=-1, keepdims=True) + 1e-5) ** -0.5


def _summary(library: Any, values: Any, axes: tuple[int, ...]) -> Any:
    """Returns mean, least, greatest and variance over some axes, one behind the other."""
    mean = values.mean(axis=axes)
    variance = (values**2).mean(axis=axes) - mean**2
    least, greatest = library.amin(values, axis=axes), library.amax(values, axis=axes)
    return library.concatenate([mean, least, greatest, variance], axis=-1)
