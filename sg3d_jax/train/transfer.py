"""Parameters of a model of some concepts, carried over to one that knows others.

Concepts are told apart in a few layers alone: the first of each network, which reads one-hot
concepts, counts a concept and kinds, and the ones that predict labels and kinds. What belongs to
concepts and kinds of the same names is carried over; inputs that are new have no weight at first,
so that what a model knew it goes on knowing.

Source: ours.
"""

import re
from collections.abc import Hashable, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax.fill.protocol import Params
from sg3d_jax.scene.ontology import Ontology

CONCEPTS: Final = "concepts"  # one row a concept
KINDS: Final = "kinds"  # one row a kind of what is observed
OTHERS: Final = "others"  # all other rows

# What the rows of a kernel stand for, in their order, by its path: see `nn.embed`, `GraphHead` and
# the `block` layers of the denoisers.
INPUTS: Final[Mapping[str, tuple[str, ...]]] = {
    r"gine'\]\['nodes'\]\['kernel": (CONCEPTS, OTHERS, CONCEPTS, CONCEPTS, KINDS),
    r"gine'\]\['edges'\]\['kernel": (OTHERS, CONCEPTS),
    r"params'\]\['hidden'\]\['kernel": (OTHERS, CONCEPTS, CONCEPTS, CONCEPTS, CONCEPTS),
    r"params'\]\['block'\]\['kernel": (CONCEPTS, OTHERS),
}
# And what the columns of an output stand for. Kinds of what is grown go by their places.
OUTPUTS: Final[Mapping[str, tuple[str, ...]]] = {
    r"'label'\]\['(kernel|bias)": (CONCEPTS,),
    r"kinds.*'logits'\]\['(kernel|bias)": (OTHERS,),
}
BESIDE: Final = r"\W*(kinds|placement)\b"  # modules that a model may have or lack
FRESH: Final = r"\W*placement\b"  # the one that stays as it is: it is learnt soon


def transferred(params: Params, known: Ontology, fresh: Params, ontology: Ontology) -> Params:
    """Returns the parameters of a model of other concepts that computes what given ones do.

    Args:
      params: of a model of the concepts `known`.
      known: its concepts.
      fresh: initial parameters of a model of the concepts `ontology`, of the same widths and
        layers. The module that tells kinds stays fresh if the given ones lack it, and placement in
        any case.
      ontology: its concepts.

    Raises:
      ValueError: a layer differs otherwise than by its concepts and kinds, or only one has it.
    """
    given, wanted = (
        {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(tree)}
        for tree in (params, fresh)
    )
    for name in sorted(given.keys() ^ wanted.keys()):
        if not re.match(BESIDE, name):
            raise ValueError(f"{name} is of one model alone, expected the same layers")

    def carried(path: Any, leaf: jax.Array) -> jax.Array:
        name = jax.tree_util.keystr(path)
        have = given.get(name)
        if have is None or re.match(FRESH, name):
            return leaf
        reads, axis = _reads(name)
        if not reads:
            if have.shape != leaf.shape:
                raise ValueError(f"{name} is {list(have.shape)}, expected {list(leaf.shape)}")
            return have
        before, after = (
            _keys(reads, array.shape[axis], concepts)
            for array, concepts in ((have, known), (leaf, ontology))
        )
        target = [place for place, key in enumerate(after) if key in before]
        source = [before.index(after[place]) for place in target]
        start = leaf if axis else jnp.zeros_like(leaf)
        have, start = (jnp.moveaxis(array, axis, 0) for array in (have, start))
        if have.shape[1:] != start.shape[1:]:
            raise ValueError(f"{name} is {list(have.shape)}, expected {list(start.shape)}")
        return jnp.moveaxis(start.at[np.array(target)].set(have[np.array(source)]), 0, axis)

    return jax.tree_util.tree_map_with_path(carried, fresh)


def _reads(name: str) -> tuple[tuple[str, ...], int]:
    """Returns what the rows (axis 0) or columns (axis -1) of a layer stand for, if anything."""
    for table, axis in ((INPUTS, 0), (OUTPUTS, -1)):
        for pattern, groups in table.items():
            if re.search(pattern, name):
                return groups, axis
    return (), 0


def _keys(groups: tuple[str, ...], size: int, ontology: Ontology) -> list[Hashable]:
    """Returns a name for each of so many rows, the same for rows that stand for the same."""
    kinds = [(c.name, kind) for c in ontology.concepts if c.observed for kind in c.kinds]
    counted = {CONCEPTS: [*ontology.names], KINDS: kinds}
    rest = size - sum(len(counted.get(group, ())) for group in groups)
    counted[OTHERS] = [*range(rest)]
    return [(place, key) for place, group in enumerate(groups) for key in counted[group]]
