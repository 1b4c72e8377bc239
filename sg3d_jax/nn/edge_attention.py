"""Attention on the edges of the plane graph: the edge classifiers, and where their rooms stand.

A graph comes as features of its nodes and directed edges with `Links`; every edge is there in both
directions. Masked edges do not matter, whatever they hold.

Source: Millan-Romera et al. 2024 (EC-square, arXiv 2310.00401; EC-L, arXiv 2409.11972), as in the
authors' code and weights (snt-arg/situational_graphs_reasoning).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.nn.apply import Dense
from sg3d_jax.nn.embed import safe_norm

NO_ROOM = -1
_XAVIER = nn.initializers.xavier_uniform()


class Links(NamedTuple):
    """The directed edges of a padded graph."""

    senders: Array  # int32[E]
    receivers: Array  # int32[E]
    mask: Array  # bool[E]


def with_loops(links: Links, num_nodes: int) -> Links:
    """Appends an edge from every node to itself, so that attention always has something to see."""
    nodes = jnp.arange(num_nodes)
    return Links(
        jnp.concatenate([links.senders, nodes]),
        jnp.concatenate([links.receivers, nodes]),
        jnp.concatenate([links.mask, jnp.ones(num_nodes, bool)]),
    )


def reverse_of(links: Links, num_nodes: int) -> Int[Array, " E"]:
    """Returns the slot of the opposite direction of each edge; anything for masked edges."""
    slots = jnp.where(links.mask, jnp.arange(links.mask.shape[0]), 0)
    table = jnp.zeros((num_nodes, num_nodes), slots.dtype)
    table = table.at[links.senders, links.receivers].max(slots)
    return table[links.receivers, links.senders]


def segment_softmax(
    scores: Float[Array, "E H"], links: Links, num_nodes: int
) -> Float[Array, "E H"]:
    """Returns weights that sum to one over the incoming edges of each node; zero if masked."""
    scores = jnp.where(links.mask[:, None], scores, -jnp.inf)
    most = jax.ops.segment_max(scores, links.receivers, num_nodes)
    most = jnp.where(jnp.isfinite(most), most, 0.0)
    share = jnp.exp(scores - jax.lax.stop_gradient(most)[links.receivers])
    total = jax.ops.segment_sum(share, links.receivers, num_nodes)
    return share / jnp.maximum(total, 1e-12)[links.receivers]


class MLP(nn.Module):
    """Linear layers with ReLU between them."""

    widths: Sequence[int]

    @nn.compact
    def __call__(self, hidden: Float[Array, "... D"]) -> Float[Array, "... K"]:
        """Returns the output of the last layer."""
        *inner, last = self.widths
        for width in inner:
            hidden = nn.relu(Dense(width, kernel_init=_XAVIER)(hidden))
        return Dense(last, kernel_init=_XAVIER)(hidden)


class GraphAttention(nn.Module):
    """A graph attention layer, heads concatenated.

    Source: Velickovic et al. 2018.
    """

    heads: int
    width: int

    @nn.compact
    def __call__(self, nodes: Float[Array, "N D"], loops: Links) -> Float[Array, "N K"]:
        """Returns the new node states; `loops` are links with loops."""
        num_nodes, shape = nodes.shape[0], (self.heads, self.width)
        states = Dense(self.heads * self.width, use_bias=False, kernel_init=_XAVIER)(nodes)
        states = states.reshape(num_nodes, *shape)
        as_sender = jnp.einsum("nhw,hw->nh", states, self.param("sender", _XAVIER, shape))
        as_receiver = jnp.einsum("nhw,hw->nh", states, self.param("receiver", _XAVIER, shape))
        scores = nn.leaky_relu(as_sender[loops.senders] + as_receiver[loops.receivers], 0.2)
        weights = segment_softmax(scores, loops, num_nodes)
        message = weights[..., None] * states[loops.senders]
        total = jax.ops.segment_sum(message, loops.receivers, num_nodes).reshape(num_nodes, -1)
        bias = self.param("bias", nn.initializers.zeros, (self.heads * self.width,))
        return total + bias[None]


class EdgeBranchGAT(nn.Module):
    """Two graph attention layers with an edge state beside them: one logit a directed edge.

    Edges do not take part in the attention; they reach the output by their own branch.

    Source: EC-square; of its two networks, one of rooms and one of walls, this is either.
    """

    heads: int
    width: int
    decoder: Sequence[int]

    @nn.compact
    def __call__(
        self, nodes: Float[Array, "N D"], edges: Float[Array, "E F"], links: Links
    ) -> Float[Array, " E"]:
        """Returns the logits of the directed edges, arbitrary where masked."""
        loops = with_loops(links, nodes.shape[0])
        for layer, heads in enumerate((self.heads, 1)):
            ends = [nodes[links.senders], nodes[links.receivers], edges]
            update = Dense(self.width, kernel_init=_XAVIER, name=f"edge_{layer}")
            edges = update(jnp.concatenate(ends, axis=-1))
            attention = GraphAttention(heads, self.width, name=f"attention_{layer}")
            nodes = nn.elu(attention(nodes, loops))
        ends = [nodes[links.senders], nodes[links.receivers], edges]
        logits = MLP((*self.decoder, 1), name="decoder")(jnp.concatenate(ends, axis=-1))
        return logits[..., 0]


class EdgeAwareAttention(nn.Module):
    """Attention whose scores and messages hold the edge, and which updates the edge.

    Source: EC-L, Sec. on the edge-aware layer, in the version whose second layer sees the edges of
    the first.
    """

    heads: int
    node_width: int
    edge_width: int
    dropout: float

    @nn.compact
    def __call__(
        self,
        nodes: Float[Array, "N D"],
        edges: Float[Array, "E F"],
        links: Links,
        key: Key[Array, ""] | None,
    ) -> tuple[Float[Array, "N Wn"], Float[Array, "E We"]]:
        """Returns new node and edge states; without a key nothing is dropped."""
        key_nodes, key_weights = _split(key, 2)
        num_nodes, loops = nodes.shape[0], with_loops(links, nodes.shape[0])
        states = _linear(self.heads * self.node_width, "nodes")(nodes)
        states = _dropped(self.dropout, key_nodes, states)
        states = states.reshape(num_nodes, self.heads, self.node_width)
        along = _linear(self.heads * self.edge_width, "edges")(edges)
        along = along.reshape(-1, self.heads, self.edge_width)

        shape = (2 * self.node_width + self.edge_width, 1)
        score = self.param("score", _XAVIER, shape)[:, 0]
        as_receiver, as_sender, as_edge = jnp.split(score, [self.node_width, 2 * self.node_width])
        of_edge = jnp.pad(along @ as_edge, [(0, num_nodes), (0, 0)])  # loops have no edge state
        scores = (states @ as_receiver)[loops.receivers] + (states @ as_sender)[loops.senders]
        weights = segment_softmax(nn.leaky_relu(scores + of_edge, 0.01), loops, num_nodes)
        weights = _dropped(self.dropout, key_weights, weights) / self.heads

        sent = jnp.einsum("eh,ehw->ew", weights, states[loops.senders])
        carried = jnp.einsum("eh,ehw->ew", weights[: along.shape[0]], along)
        totals = [
            jax.ops.segment_sum(sent, loops.receivers, num_nodes),
            jax.ops.segment_sum(carried, links.receivers, num_nodes),
        ]
        # The map of messages is linear, so it may follow the sum over neighbours and heads.
        nodes = _linear(self.node_width, "message")(jnp.concatenate(totals, axis=-1))

        ends = [nodes[links.senders], nodes[links.receivers], jnp.mean(along, axis=1)]
        update = _linear(self.edge_width, "update")(jnp.concatenate(ends, axis=-1))
        return nodes, nn.relu(update)


class EdgeAttentionClassifier(nn.Module):
    """Two edge-aware attention layers and a decoder of pairs: logits of each edge.

    Source: EC-L.
    Differs: both orders of a pair are decoded and averaged, where the original decodes the one that
    the numbering of the planes happens to give.
    """

    heads: int
    node_width: int
    edge_width: int
    decoder: Sequence[int]
    num_classes: int
    dropout: float

    @nn.compact
    def __call__(
        self,
        nodes: Float[Array, "N D"],
        edges: Float[Array, "E F"],
        links: Links,
        key: Key[Array, ""] | None = None,
    ) -> Float[Array, "E K"]:
        """Returns logits, the same for both directions of an edge, arbitrary where masked."""
        keys = _split(key, 4)
        sizes = self.heads, self.node_width, self.edge_width, self.dropout
        nodes, edges = EdgeAwareAttention(*sizes, name="layer_0")(nodes, edges, links, keys[0])
        nodes = _dropped(self.dropout, keys[1], nn.elu(nodes))
        edges = _dropped(self.dropout, keys[2], edges)
        nodes, edges = EdgeAwareAttention(*sizes, name="layer_1")(nodes, edges, links, keys[3])
        nodes = nn.elu(nodes)
        reverse = reverse_of(links, nodes.shape[0])
        pair = [nodes[links.senders], nodes[links.receivers], edges, edges[reverse]]
        decode = MLP((*self.decoder, self.num_classes), name="decoder")
        logits = decode(jnp.concatenate(pair, axis=-1))
        return (logits + logits[reverse]) / 2


class RoomReadout(nn.Module):
    """Where a room stands, from its planes: a star of planes around an empty node.

    The room's node attends to its planes and collects vectors: sums of their normals and offsets
    with invariant weights. Planes then see these vectors by their inner products, so the result
    turns, shifts and mirrors with the room.

    Source: the factor network of EC-L, of which only inputs and outputs are known.
    Differs: layers, sizes and the equivariance are ours.
    """

    width: int
    channels: int = 8
    rounds: int = 2

    @nn.compact
    def __call__(
        self,
        position: Float[Array, "N 2"],
        normal: Float[Array, "N 2"],
        width: Float[Array, " N"],
        room: Int[Array, " N"],
    ) -> Float[Array, "N 2"]:
        """Returns the offset of each room's centroid from the mean of its planes.

        Args:
          position: of planes, in any unit, the one of the result.
          normal: of planes.
          width: of planes, in the same unit.
          room: the number of each plane's room; NO_ROOM for none.

        Returns:
          A row a room; zero for rooms without planes.
        """
        num_nodes, mask, means = room.shape[0], room != NO_ROOM, room_means(position, room)
        room = jnp.maximum(room, 0)
        star = Links(jnp.arange(num_nodes), room, mask)
        away = position - means[room]
        arrows = jnp.stack([normal, away], axis=1)
        count = jax.ops.segment_sum(mask.astype(jnp.float32), room, num_nodes)
        seen = [width, safe_norm(away), jnp.sum(normal * away, axis=-1), count[room] / 10.0]
        hidden = nn.relu(Dense(self.width, name="planes")(jnp.stack(seen, axis=-1)))
        for index in range(self.rounds):
            weights = segment_softmax(Dense(1, name=f"score_{index}")(hidden), star, num_nodes)
            state = jax.ops.segment_sum(weights * hidden, room, num_nodes)
            factors = Dense(2 * self.channels, name=f"factors_{index}")(hidden)
            vectors = _summed(factors, arrows, weights, room)
            inner = jnp.einsum("nav,ncv->nac", arrows, vectors[room]).reshape(num_nodes, -1)
            inputs = jnp.concatenate([hidden, state[room], inner], axis=-1)
            hidden = nn.relu(Dense(self.width, name=f"hidden_{index}")(inputs))
        factors = Dense(2, name="offset", kernel_init=nn.initializers.zeros)(hidden)
        share = (mask / jnp.maximum(count, 1.0)[room])[:, None]
        return _summed(factors, arrows, share, room)[:, 0]


def room_means(values: Float[Array, "N D"], room: Int[Array, " N"]) -> Float[Array, "N D"]:
    """Returns the mean over the planes of each room; zero for rooms without planes."""
    mask = (room != NO_ROOM)[:, None].astype(values.dtype)
    slot = jnp.maximum(room, 0)
    count = jax.ops.segment_sum(mask, slot, room.shape[0])
    return jax.ops.segment_sum(values * mask, slot, room.shape[0]) / jnp.maximum(count, 1.0)


def _summed(
    factors: Float[Array, "N K"],
    arrows: Float[Array, "N 2 2"],
    weights: Float[Array, "N 1"],
    room: Int[Array, " N"],
) -> Float[Array, "N C 2"]:
    """Returns vectors of each room: sums of the arrows of its planes, each times its factor."""
    num_nodes = room.shape[0]
    factors = (weights * factors).reshape(num_nodes, 2, -1)
    return jax.ops.segment_sum(jnp.einsum("nac,nav->ncv", factors, arrows), room, num_nodes)


def _linear(width: int, name: str) -> Dense:
    return Dense(width, use_bias=False, kernel_init=_XAVIER, name=name)


def _split(key: Key[Array, ""] | None, num: int) -> Sequence[Key[Array, ""] | None]:
    return [None] * num if key is None else list(jax.random.split(key, num))


def _dropped(rate: float, key: Key[Array, ""] | None, values: Array) -> Array:
    """Returns the values, a share of them dropped if there is a key."""
    return nn.Dropout(rate)(values, deterministic=key is None, rng=key)
