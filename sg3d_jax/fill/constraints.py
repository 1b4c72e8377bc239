"""The rules of the ontology as constraints inside the reverse process: what a block may still be.

`rules_of` reads off a graph which concepts a new node may have, and which old nodes it may have an
edge to; `constrained` takes what they forbid out of every prediction of the clean block, so that it
has probability zero at every step; `draw_valid` draws the block itself, at time 0, from the
prediction given that the rules hold. Nothing is mended afterwards. All of it runs under `jit` and
`vmap`.

Source: ConStruct (Madeira et al. 2024), constraints through the whole reverse trajectory; PRODIGY
(Sharma et al. 2024), the nearest state that obeys them.
Differs: ours are rules on pairs, counts and labels, so that predictions are conditioned on them in
closed form, and the noise stays that of the training.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, Shaped

from sg3d_jax.scene.graph import SceneGraph, ontology_of
from sg3d_jax.scene.ontology import PART_OF, Ontology

NEVER = -1e9  # log odds of what is forbidden: finite, so that differences of two are


class Rules(NamedTuple):
    """What new nodes may be, given a graph."""

    ontology: Ontology  # no array: part of the tree structure
    label: Array  # bool[C], concepts that a new node may have
    closes: Array  # bool[C], those of them that give a loose node its whole (see `is_loose`)
    part: Array  # bool[C, N], old nodes that may become part of a new node of each concept
    whole: Array  # bool[C, N], old nodes of which a new node of each concept may become part
    old_label: Array  # int32[N]
    must: Array  # bool[C, C], a part (row) takes one of these wholes (columns) if there is one
    least: Array  # int32[C], parts without which there is no new node of a concept

    @property
    def allowed(self) -> Bool[Array, "C N"]:
        """Returns the old nodes to which a new node of each concept may have an edge."""
        return self.part | self.whole


class Order(NamedTuple):
    """What follows of the order in which concepts are inserted; on the host."""

    after: np.ndarray  # bool[C, C], the concept of a row is inserted after that of a column
    least: np.ndarray  # int[C], parts that a node needs when it is inserted


@functools.cache
def order_of(ontology: Ontology, layers: tuple[str, ...] = ()) -> Order:
    """Returns the tables of an ontology, for concepts that are grown in an order.

    Args:
      ontology: the concepts.
      layers: those that are grown, in the order of their insertion; empty for bottom-up.
    """
    place = np.arange(ontology.num_concepts)
    if layers:
        place = np.array([layers.index(name) if name in layers else -1 for name in ontology.names])
    place = np.where(ontology.is_observed, -1, place)
    after = place[:, None] > place[None, :]
    earlier = (ontology.may_be_part & after.T).any(axis=0)  # of a column's parts some come first
    least = np.array([concept.least_parts for concept in ontology.concepts]) * earlier
    return Order(after, least)


def rules_of(
    graph: SceneGraph,
    num_block: int,
    layers: tuple[str, ...] = (),
    closing: Bool[Array, ""] | bool = False,
    last: bool = False,
) -> Rules:
    """Returns what the nodes of a block may be, given the old graph.

    A part that has its one whole is no part of another; a concept of which there are too few such
    parts left cannot come; of one that holds all there is, such as a city, there is one, and it
    holds all.

    Args:
      graph: padded.
      num_block: M; where it is more than one, nodes of a block may be parts of each other.
      layers: the concepts in the order of insertion; empty for bottom-up.
      closing: whether only what gives a loose node its whole may come.
      last: whether nothing comes after this block, so that its parts find their wholes in it.
    """
    ontology, mask = ontology_of(graph), graph.nodes.mask
    order, label = order_of(ontology, layers), graph.nodes.label
    may, single = jnp.asarray(ontology.may_be_part), jnp.asarray(ontology.has_one_whole)
    taken = wholes_of(graph)
    part = may[label].T & mask[None, :] & ~(single[label].T & taken)
    whole = may[:, label] & mask[None, :]
    loose = is_loose(graph, taken)
    by_mates = jnp.asarray((ontology.may_be_part & ~ontology.is_observed[:, None]).any(axis=0))
    enough = jnp.sum(part, axis=-1) + (num_block - 1) * by_mates >= jnp.asarray(order.least)
    there = jnp.zeros(ontology.num_concepts, bool).at[label].max(mask)
    possible = enough & ~jnp.asarray(ontology.is_observed) & ~(jnp.asarray(ontology.is_top) & there)
    closes = jnp.any(part & single[label].T & loose[None, :], axis=-1)
    closes |= jnp.any(whole & _lacks_parts(graph, layers)[None, :], axis=-1)
    closes &= possible
    must = jnp.asarray(ontology.is_top[None, :] | order.after | last) & single
    return Rules(
        ontology=ontology,
        label=jnp.where(closing, closes, possible),
        closes=closes,
        part=part,
        whole=whole,
        old_label=label,
        must=must,
        least=jnp.asarray(order.least, jnp.int32),
    )


def wholes_of(graph: SceneGraph) -> Bool[Array, "C N"]:
    """Returns whether each node is part of some node of each concept."""
    label = graph.nodes.label
    empty = jnp.zeros((ontology_of(graph).num_concepts, label.shape[0]), bool)
    return empty.at[label[graph.receivers], graph.senders].max(upwards(graph))


def upwards(graph: SceneGraph) -> Bool[Array, " E"]:
    """Returns which edges go from a part to its whole."""
    may, label = jnp.asarray(ontology_of(graph).may_be_part), graph.nodes.label
    part_of = graph.edges.mask & (graph.edges.relation == PART_OF)
    return part_of & may[label[graph.senders], label[graph.receivers]]


def num_parts(graph: SceneGraph) -> Int[Array, " N"]:
    """Returns of how many parts each node is the whole."""
    none = jnp.zeros(graph.nodes.label.shape, jnp.int32)
    return none.at[graph.receivers].add(upwards(graph))


def is_loose(graph: SceneGraph, taken: Bool[Array, "C N"]) -> Bool[Array, " N"]:
    """Returns which grown nodes lack a whole that is due; what holds all there is is one, too.

    What is observed is never loose: a model says that it belongs to nothing by leaving it alone.
    """
    ontology, label = ontology_of(graph), graph.nodes.label
    single = jnp.asarray(ontology.has_one_whole)
    lacks = jnp.any(single[label].T & ~taken, axis=0) | jnp.asarray(ontology.is_top)[label]
    return graph.nodes.mask & ~graph.nodes.observed & lacks


def _lacks_parts(graph: SceneGraph, layers: tuple[str, ...]) -> Bool[Array, " N"]:
    """Returns which nodes wait for parts that are inserted after them."""
    ontology, label = ontology_of(graph), graph.nodes.label
    least = np.array([concept.least_parts for concept in ontology.concepts])
    waits = (order_of(ontology, layers).least < least) & ontology.may_be_part.any(axis=0)
    if not waits.any():
        return jnp.zeros(label.shape, bool)
    too_few = num_parts(graph) < jnp.asarray(least)[label]
    return graph.nodes.mask & jnp.asarray(waits)[label] & too_few


def is_whole(graph: SceneGraph, layers: tuple[str, ...] = ()) -> Bool[Array, ""]:
    """Returns whether a graph may end: all that is grown hangs together below one node."""
    loose = jnp.sum(is_loose(graph, wholes_of(graph)))
    return (loose <= 1) & ~jnp.any(_lacks_parts(graph, layers))


def constrained(
    rules: Rules | None,
    logits_label: Float[Array, "M C"],
    logits_edge: Float[Array, "M tokens 2"],
) -> tuple[Float[Array, "M C"], Float[Array, "M tokens 2"]]:
    """Returns the probabilities of clean labels and edges, without what is forbidden.

    An edge that some label of its node allows keeps its probability, times that of these labels.

    Args:
      rules: of the old graph; None for the probabilities as they are predicted.
      logits_label: predicted.
      logits_edge: predicted, to the block itself and to the old graph.
    """
    if rules is None:
        return jax.nn.softmax(logits_label), jax.nn.softmax(logits_edge)
    label = jax.nn.softmax(_possible(rules, logits_label))
    may = jnp.asarray(rules.ontology.may_be_part | rules.ontology.may_be_part.T, jnp.float32)
    inside, across = label @ may @ label.T, label @ rules.allowed.astype(jnp.float32)
    edge = jax.nn.softmax(logits_edge)[..., 1] * jnp.concatenate([inside, across], axis=1)
    return label, jnp.stack([1 - edge, edge], axis=-1)


def _possible(rules: Rules, logits_label: Float[Array, "M C"]) -> Float[Array, "M C"]:
    """Returns logits of labels without those that cannot be; where none can be, as they are."""
    allowed = rules.label | ~jnp.any(rules.label)
    return jnp.where(allowed[None, :], logits_label, NEVER)


def draw_valid(
    key: Key[Array, ""],
    rules: Rules,
    logits_label: Float[Array, "M C"],
    logits_edge: Float[Array, "M tokens 2"],
    block_mask: Bool[Array, " M"],
) -> tuple[Int[Array, " M"], Bool[Array, "M tokens"], Bool[Array, " M"]]:
    """Draws labels and edges of a block from a prediction, given that the rules hold.

    Labels come first, each by its own probability and that of an edge set which it allows. Then
    every part takes at most one of the wholes that it may have one of, by their odds against
    having none, and a node that has too few parts takes those of the best odds.

    Args:
      key: one draw.
      rules: of the old graph.
      logits_label: of the clean labels.
      logits_edge: of the clean edges, to the block itself and to the old graph.
      block_mask: the nodes that are asked for.

    Returns:
      Labels, edges (symmetric inside the block), and which nodes there are: those that the rules
      leave room for, every one where the block is of one node and any label is possible.
    """
    key_label, key_edges = jax.random.split(key)
    log_odds = mirrored(logits_edge[..., 1] - logits_edge[..., 0])
    label, mask = _draw_labels(key_label, rules, logits_label, log_odds, block_mask)
    pairs = _pairs_of(rules, label, mask)
    edges = _draw_edges(key_edges, rules, pairs, log_odds)
    edges = _with_least(rules, pairs, edges, log_odds)
    return label, *_sound(rules, pairs, edges, mask)


class Pairs(NamedTuple):
    """How the nodes of a block, whose labels are drawn, may be joined."""

    label: Array  # int32[M]
    token: Array  # int32[tokens], labels of the block and of the old graph
    up: Array  # bool[M, tokens], the token may be the one whole of the node
    down: Array  # bool[M, tokens], the token may be part of the node, and of no other of its kind
    free: Array  # bool[M, tokens], either, in any number
    part: Array  # bool[M, tokens], the token would be a part of the node
    rival: Array  # bool[M, M], another node of the same concept


def _pairs_of(rules: Rules, label: Int[Array, " M"], mask: Bool[Array, " M"]) -> Pairs:
    may = jnp.asarray(rules.ontology.may_be_part)
    single = jnp.asarray(rules.ontology.has_one_whole)
    inside = may[label][:, label] & mask[:, None] & mask[None, :]
    whole = jnp.concatenate([inside, rules.whole[label] & mask[:, None]], axis=1)
    part = jnp.concatenate([inside.T, rules.part[label] & mask[:, None]], axis=1)
    token = jnp.concatenate([label, rules.old_label])
    up, down = whole & single[label][:, token], part & single[token][:, label].T
    rival = (label[:, None] == label[None, :]) & ~jnp.eye(len(label), dtype=bool)
    return Pairs(label, token, up, down, (whole & ~up) | (part & ~down), part, rival)


def mirrored(pairs: Shaped[Array, "M tokens"]) -> Shaped[Array, "M tokens"]:
    """Mirrors the strict lower triangle of the block itself: one number a pair."""
    num_block = pairs.shape[0]
    lower = jnp.tril(pairs[:, :num_block], -1)
    return jnp.concatenate([lower + lower.T, pairs[:, num_block:]], axis=1)


def _draw_labels(
    key: Key[Array, ""],
    rules: Rules,
    logits_label: Float[Array, "M C"],
    log_odds: Float[Array, "M tokens"],
    block_mask: Bool[Array, " M"],
) -> tuple[Int[Array, " M"], Bool[Array, " M"]]:
    """Draws labels, given that the edges to the old graph obey them and that there are parts."""
    num_block = block_mask.shape[0]
    absent = -jax.nn.softplus(log_odds[:, num_block:])  # log chance that there is no edge
    no_forbidden = absent @ (~rules.allowed).T.astype(jnp.float32)
    no_part = absent @ rules.part.T.astype(jnp.float32)
    some_part = jnp.log(jnp.maximum(-jnp.expm1(no_part), jnp.finfo(jnp.float32).tiny))
    if num_block > 1:  # which of the others are its parts, their labels would say
        some_part = jnp.zeros_like(some_part)
    weight = jax.nn.log_softmax(logits_label) + no_forbidden
    weight += jnp.where(rules.least > 0, some_part, 0.0)
    label = jax.random.categorical(key, _possible(rules, weight)).astype(jnp.int32)
    top = jnp.asarray(rules.ontology.is_top)[label] & block_mask
    return label, block_mask & jnp.any(rules.label) & ~(top & (jnp.cumsum(top) > 1))


def _draw_edges(
    key: Key[Array, ""], rules: Rules, pairs: Pairs, log_odds: Float[Array, "M tokens"]
) -> Bool[Array, "M tokens"]:
    """Draws edges: of one whole at most by their odds, of any number each by its own.

    A part takes none with odds of one: the chance of each choice is that of independent edges,
    given that there is one at most (the Gumbel-max trick).
    """
    num_block = log_odds.shape[0]
    keys = jax.random.split(key, 3)
    value = log_odds + mirrored(jax.random.gumbel(keys[0], log_odds.shape))
    free = pairs.free & (value > mirrored(jax.random.gumbel(keys[1], log_odds.shape)))
    shape = rules.ontology.num_concepts, log_odds.shape[1]
    none = jax.random.gumbel(keys[2], shape)  # of the part in a column, for each kind of whole
    offered = jnp.where(pairs.up, value, NEVER)
    kinds = jnp.arange(rules.ontology.num_concepts)
    of_kind = jnp.where(pairs.token[None, :] == kinds[:, None], 0.0, NEVER)
    best = jnp.max(offered[:, None, :] + of_kind[None], axis=-1)  # of each kind of whole
    taken = rules.must[pairs.label][:, pairs.token] | (value > none[pairs.token, :num_block].T)
    up = pairs.up & (value >= best[:, pairs.token]) & taken
    claimed = jnp.where(pairs.down, value, NEVER)
    rivals = jnp.max(jnp.where(pairs.rival[:, :, None], claimed[None], NEVER), axis=1)
    taken = rules.must[pairs.token][:, pairs.label].T | (value > none[pairs.label])
    down = pairs.down & (value > rivals) & taken
    # Of two nodes of the block, the part decides.
    inside = up[:, :num_block] | up[:, :num_block].T | free[:, :num_block]
    across = (up | down | free)[:, num_block:]
    return jnp.concatenate([inside, across], axis=1)


def _with_least(
    rules: Rules,
    pairs: Pairs,
    edges: Bool[Array, "M tokens"],
    log_odds: Float[Array, "M tokens"],
) -> Bool[Array, "M tokens"]:
    """Gives nodes that have too few parts those of the best odds that no other node has taken."""
    num_block, num_tokens = edges.shape
    old = jnp.arange(num_tokens) >= num_block
    for _ in range(max(concept.least_parts for concept in rules.ontology.concepts)):
        poor = jnp.sum(edges & pairs.part, axis=-1) < rules.least[pairs.label]
        claimed = (pairs.rival.astype(jnp.float32) @ (edges & pairs.down).astype(jnp.float32)) > 0
        offered = pairs.part & old[None, :] & ~edges & ~claimed
        best = jnp.argmax(jnp.where(offered, log_odds, NEVER), axis=-1)
        given = poor[:, None] & offered & (jnp.arange(num_tokens)[None, :] == best[:, None])
        edges |= given
    return edges


def _sound(
    rules: Rules, pairs: Pairs, edges: Bool[Array, "M tokens"], mask: Bool[Array, " M"]
) -> tuple[Bool[Array, "M tokens"], Bool[Array, " M"]]:
    """Leaves out nodes of a block that still have too few parts, and their edges.

    Two that were given the same part are told apart here: the first keeps it.
    """
    num_block = mask.shape[0]
    before = jnp.tril(pairs.rival, -1).astype(jnp.float32)
    edges &= ~(pairs.down & ((before @ (edges & pairs.down).astype(jnp.float32)) > 0))
    edges = jnp.concatenate(
        [edges[:, :num_block] & edges[:, :num_block].T, edges[:, num_block:]], 1
    )
    for _ in range(rules.ontology.num_concepts if num_block > 1 else 1):
        parts = jnp.sum(edges & pairs.part, axis=-1)
        mask &= parts >= rules.least[pairs.label]
        inside = edges[:, :num_block] & mask[None, :]
        edges = jnp.concatenate([inside, edges[:, num_block:]], axis=1) & mask[:, None]
    return edges, mask
