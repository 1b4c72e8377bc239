"""Relaxed-equivariant graph transformer: labels, edges and positions of a block, jointly.

The layers are those of the rectangle (`graph_transformer`); between them the positions of the new
nodes move. What moves them are vectors between nodes and normals of planes, weighted by invariants,
so a scene that is turned about the vertical, mirrored or shifted together with its frame gives a
block that is turned, mirrored or shifted with it. Distances from the origin of the frame are
inputs, hence "relaxed": shifted without its frame, a scene gives something else.

Source: MiDi, Sec. 3 (rEGNN); paper, Sec. "Adapting MiDi".
Differs: vectors are averaged by attention, which does not grow with the graph, and are left in
metres, where MiDi sums them and normalises the result (SE3Norm); the normals of planes, and the
mean of the linked nodes, move a node too; no centre of mass is removed, as the paper says.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.nn.apply import Dense, stacked
from sg3d_jax.nn.embed import Surface, multiscale, relative_to_points, safe_norm, sinusoids
from sg3d_jax.nn.graph_transformer import Conditioning, RectangleLayer, block_symmetric

POSITION_HEADS = 4


def all_surfaces(position: Float[Array, "M 3"], old: Surface) -> Surface:
    """Returns the surfaces of all tokens: new nodes, which are points, then old nodes."""
    num_block = position.shape[0]
    return Surface(
        position=jnp.concatenate([position, old.position]),
        normal=jnp.pad(old.normal, [(num_block, 0), (0, 0)]),
        width=jnp.pad(old.width, (num_block, 0)),
    )


def linked_mean(
    position: Float[Array, "M 3"],
    linked: Float[Array, "M tokens"],
    tokens: Float[Array, "tokens 3"],
) -> tuple[Float[Array, "M 3"], Float[Array, "M 1"]]:
    """Returns the mean position of the linked tokens, and how many there are.

    A node without links stands at its own position.
    """
    count = jnp.sum(linked, axis=-1, keepdims=True)
    mean = linked @ tokens / jnp.maximum(count, 1.0)
    return jnp.where(count > 0, mean, position), count


class PositionUpdate(nn.Module):
    """p_i <- p_i + sum over heads of g_ih (sum_j a_ijh (p_j - p_i)) + k_ih (sum_j a_ijh n_j).

    One more vector leads to the mean of the linked tokens. The weights are zero at first, so an
    untrained network leaves a position where it is.

    Source: MiDi, the position update of an rEGNN layer. Differs: see the module.
    """

    @nn.compact
    def __call__(
        self,
        position: Float[Array, "M 3"],
        block: Float[Array, "M D"],
        pairs: Float[Array, "M tokens P"],
        linked: Float[Array, "M tokens"],
        old: Surface,
        token_mask: Bool[Array, " tokens"],
    ) -> Float[Array, "M 3"]:
        """Returns the new positions, metres."""
        tokens = all_surfaces(position, old)
        logits = Dense(POSITION_HEADS, name="attend")(nn.relu(nn.LayerNorm(name="norm")(pairs)))
        weights = jax.nn.softmax(jnp.where(token_mask[None, :, None], logits, -1e9), axis=1)
        towards = jnp.einsum("mth,tc->mhc", weights, tokens.position) - position[:, None]
        along = jnp.einsum("mth,tc->mhc", weights, tokens.normal)
        mean, _ = linked_mean(position, linked, tokens.position)
        vectors = jnp.concatenate([towards, along, (mean - position)[:, None]], axis=1)
        hidden = nn.LayerNorm(name="block_norm")(block)
        gates = Dense(vectors.shape[1], kernel_init=nn.initializers.zeros, name="gates")(hidden)
        return position + jnp.einsum("mv,mvc->mc", gates, vectors)


class RelaxedLayer(nn.Module):
    """A layer of the rectangle between what it sees of the positions and how it moves them."""

    node_width: int
    pair_width: int
    heads: int
    gates: int

    @nn.compact
    def __call__(
        self,
        state: tuple[Float[Array, "M D"], Float[Array, "M tokens P"], Float[Array, "M 3"]],
        conditioning: Conditioning,
        linked: Float[Array, "M tokens"],
        token_mask: Bool[Array, " tokens"],
    ) -> tuple[tuple[Float[Array, "M D"], Float[Array, "M tokens P"], Float[Array, "M 3"]], None]:
        """Returns the new states of the block nodes and of the pairs, and the new positions."""
        block, pairs, position = state
        seen = relative_to_points(position, all_surfaces(position, conditioning.surface))
        pairs += Dense(self.pair_width, name="geometry")(seen)
        sizes = self.node_width, self.pair_width, self.heads, self.gates
        rectangle = RectangleLayer(*sizes, name="rectangle")
        (block, pairs), _ = rectangle((block, pairs), conditioning, token_mask)
        back = Dense(self.pair_width, use_bias=False, name="back")(block)
        pairs = pairs.at[:, : block.shape[0]].add(back[None])
        position = PositionUpdate(name="position")(
            position, block, pairs, linked, conditioning.surface, token_mask
        )
        return (block, pairs, position), None


class RelaxedTransformer(nn.Module):
    """Predicts the clean labels, edges and positions of a block from noisy ones."""

    node_width: int
    pair_width: int
    layers: int
    heads: int
    gates: int
    num_concepts: int

    @nn.compact
    def __call__(
        self,
        conditioning: Conditioning,
        centre: Float[Array, "3"],
        block_mask: Bool[Array, " M"],
        label: Int[Array, " M"],
        edges: Int[Array, "M tokens"],
        position: Float[Array, "M 3"],
        time: Float[Array, ""],
    ) -> tuple[Float[Array, "M C"], Float[Array, "M tokens 2"], Float[Array, "M 3"]]:
        """Returns logits of the clean labels and of {no edge, edge}, and the clean positions.

        Args:
          conditioning: the encoded old graph.
          centre: the origin of the frame, metres.
          block_mask: real new nodes.
          label: noisy labels.
          edges: noisy edges, 0 or 1, symmetric inside the block.
          position: a first guess of the clean positions, metres.
          time: diffusion time, 0..S.
        """
        num_block = block_mask.shape[0]
        token_mask = jnp.concatenate([block_mask, conditioning.mask])
        linked = (edges * token_mask[None, :]).astype(jnp.float32)
        tokens = all_surfaces(position, conditioning.surface)
        mean, count = linked_mean(position, linked, tokens.position)
        concept = jax.nn.one_hot(label, self.num_concepts)
        clock = jnp.broadcast_to(sinusoids(time)[None], (num_block, 16))
        size = jnp.broadcast_to(jnp.sum(block_mask) / 10.0, (num_block, 1))
        radius = multiscale(safe_norm(position - centre[None])[:, None])
        inputs = jnp.concatenate([concept, clock, size, count / 5.0, radius], axis=-1)
        block = Dense(self.node_width, name="block")(inputs)

        new = Dense(self.pair_width, name="new")(block)
        old = Dense(self.pair_width, name="old")(conditioning.nodes)
        own = Dense(self.pair_width, use_bias=False, name="own")(block)
        from_mean = relative_to_points(mean, tokens)
        pairs = Dense(self.pair_width, use_bias=False, name="from_mean")(from_mean)
        pairs += own[:, None] + jnp.concatenate([new, old])[None]
        link = self.param("link", nn.initializers.normal(1.0), (self.pair_width,))
        pairs += linked[..., None] * link[None, None]

        sizes = self.node_width, self.pair_width, self.heads, self.gates
        layers = stacked(RelaxedLayer, self.layers)(*sizes, name="layers")
        state = block, pairs, position
        (block, pairs, position), _ = layers(state, conditioning, linked, token_mask)

        logits_label = Dense(self.num_concepts, name="label")(nn.LayerNorm(name="out")(block))
        logits_edge = Dense(2, name="edge")(nn.relu(nn.LayerNorm(name="pair_out")(pairs)))
        return logits_label, block_symmetric(logits_edge), position
