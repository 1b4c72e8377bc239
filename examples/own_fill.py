"""A Fill model of one's own, in one file: trained, resumed, scored and completed with like ours.

    sg3d train examples/own_fill.py
    sg3d evaluate runs/own_fill/weights.npz --code examples/own_fill.py
    sg3d complete examples/floor.json -o floor.json --weights runs/own_fill/weights.npz \
        --code examples/own_fill.py

No diffusion: a new node draws its label, then one old node that is to be its part (the anchor),
then, for every other old node, whether it is another part, as seen from the anchor. It stands at
the mean of its parts. Nothing in a scene tells it where a room ends but the anchor and that node,
so it is no match for MiDi; it shows what a Fill model must offer.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn
from jaxtyping import Array, Bool, Float, Int, Key

import sg3d_jax as sg
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.nn.embed import relative_geometry, surface_of, take
from sg3d_jax.nn.gine import GINE
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig


@dataclasses.dataclass(frozen=True)
class AnchorConfig:
    """Sizes of the network."""

    width: int = 48
    layers: int = 3


class AnchorNetwork(nn.Module):
    """What comes next, by a GINE over the old graph: label, anchor, further parts."""

    width: int
    layers: int
    num_concepts: int

    def setup(self) -> None:
        """Names the parts."""
        self.encoder = GINE(self.width, self.layers)
        self.of_label = nn.Dense(self.num_concepts)
        self.of_anchor = nn.Sequential([nn.Dense(self.width), nn.relu, nn.Dense(1)])
        self.of_part = nn.Sequential([nn.Dense(self.width), nn.relu, nn.Dense(1)])

    def label_logits(self, graph: sg.SceneGraph) -> Float[Array, " C"]:
        """Returns logits of the next label."""
        nodes, mask = self.encoder(graph).nodes, graph.nodes.mask[:, None]
        most = jnp.max(jnp.where(mask, nodes, -1e9), axis=0)
        return self.of_label(jnp.concatenate([jnp.sum(nodes, axis=0) / jnp.sum(mask), most]))

    def part_logits(
        self, graph: sg.SceneGraph, label: Int[Array, ""], anchor: Int[Array, ""]
    ) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
        """Returns logits of each old node: to be the anchor, and to be a part beside it."""
        nodes, surface = self.encoder(graph).nodes, surface_of(graph.nodes)
        seen = relative_geometry(take(surface, anchor[None]), surface)
        concept = jnp.broadcast_to(
            jax.nn.one_hot(label, self.num_concepts), (len(nodes), self.num_concepts)
        )
        of_anchor = self.of_anchor(jnp.concatenate([nodes, concept], axis=-1))[:, 0]
        beside = jnp.broadcast_to(nodes[anchor], nodes.shape)
        of_part = self.of_part(jnp.concatenate([nodes, concept, beside, seen], axis=-1))[:, 0]
        return jnp.where(graph.nodes.mask, of_anchor, -1e9), of_part

    def __call__(self, graph: sg.SceneGraph, label: Int[Array, ""], anchor: Int[Array, ""]) -> Any:
        """Runs everything once, for `init`."""
        return self.label_logits(graph), self.part_logits(graph, label, anchor)


@dataclasses.dataclass(frozen=True)
class AnchorFill:
    """The Fill model: `init`, `loss` and `sample`, pure functions of one padded graph."""

    config: AnchorConfig
    statistics: sg.Statistics  # of the training set; this model has no use for it
    ontology: sg.Ontology
    kin: int = 0  # its encoder adds no edges between kin

    @property
    def network(self) -> AnchorNetwork:
        """The network."""
        sizes = self.config.width, self.config.layers
        return AnchorNetwork(*sizes, self.ontology.num_concepts)

    def _run(self, method: str, params: Any, *inputs: Any) -> Any:
        return self.network.apply(params, *inputs, method=method)

    def init(self, key: Key[Array, ""], graph: sg.SceneGraph, block: sg.Block) -> Any:
        """Draws initial parameters."""
        return self.network.init(key, graph, jnp.asarray(0), jnp.asarray(0))

    def loss(
        self, params: Any, key: Key[Array, ""], graph: sg.SceneGraph, block: sg.Block
    ) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
        """Returns the negative log-likelihood of a block of one node, and its three terms."""
        label, is_part = block.label[0], block.edges[0, block.mask.shape[0] :]
        anchor = jax.random.categorical(key, jnp.where(is_part, 0.0, -1e9))
        label_logits = self._run("label_logits", params, graph)
        anchor_logits, part_logits = self._run("part_logits", params, graph, label, anchor)
        others = graph.nodes.mask.at[anchor].set(False)
        errors = optax.sigmoid_binary_cross_entropy(part_logits, is_part.astype(jnp.float32))
        cross_entropy = optax.softmax_cross_entropy_with_integer_labels
        terms = {
            "label": cross_entropy(label_logits, label),
            "anchor": cross_entropy(anchor_logits, anchor),
            "part": jnp.sum(errors * others),
        }
        terms = {name: jnp.where(block.mask[0], term, 0.0) for name, term in terms.items()}
        return terms["label"] + terms["anchor"] + terms["part"], terms

    def sample(
        self,
        params: Any,
        key: Key[Array, ""],
        graph: sg.SceneGraph,
        block_mask: Bool[Array, " M"],
        rules: sg.Rules | None = None,
    ) -> sg.Block:
        """Draws a block of one node: a concept that may come, and parts that are still free."""
        key_label, key_anchor, key_parts = jax.random.split(key, 3)
        nodes, observed = graph.nodes, jnp.asarray(self.ontology.is_observed)
        logits = self._run("label_logits", params, graph)
        possible, free = ~observed, jnp.ones((len(observed), 1), bool)
        if rules is not None:
            possible, free = rules.label, rules.part
        label = jax.random.categorical(key_label, jnp.where(possible, logits, -1e9))
        anchor_logits, _ = self._run("part_logits", params, graph, label, jnp.asarray(0))
        anchor = jax.random.categorical(key_anchor, jnp.where(free[label], anchor_logits, -1e9))
        _, logits = self._run("part_logits", params, graph, label, anchor)
        drawn = jax.random.bernoulli(key_parts, jax.nn.sigmoid(logits)) & nodes.mask & free[label]
        parts = drawn.at[anchor].set(True)
        position = jnp.sum(nodes.position * parts[:, None], axis=0) / jnp.sum(parts)
        return sg.Block(
            label=jnp.where(block_mask, label, 0),
            position=jnp.where(block_mask[:, None], position[None], 0.0),
            edges=jnp.pad(parts[None], ((0, 0), (1, 0))) & block_mask[:, None],
            mask=block_mask,
        )


sg.register_fill("anchor", AnchorConfig, AnchorFill)

CONFIG = Config(
    data=DataConfig(name="s-f-square", num_graphs=600),
    model=AnchorConfig(),
    flagg=FlaggConfig(coins=(1,)),  # one node a block
    optimiser=OptimiserConfig(learning_rate=2e-3, warmup_steps=100),
    steps=1_000,
    capacities=(24, 48),
    validate_every=500,
    validation_graphs=32,
)
