"""EC-square and EC-L: pairs of near planes are classified, then grouped into rooms and walls.

Neither knows a concept above the room. EC-square finds rectangular rooms: one graph attention
network of pairs in the same room, one of pairs in the same wall, and rooms along cycles of pairs.
EC-L finds rooms of any shape: one edge-aware attention network of three classes, and rooms as
communities. Only planes and the proximity edges between them enter the networks.

Source: Millan-Romera et al. 2024 (EC-square, arXiv 2310.00401; EC-L, arXiv 2409.11972), as in the
authors' code (snt-arg/situational_graphs_reasoning); paper, Sec. "Baselines".
Differs: the proximity graph is that of this paper, in both directions; pairs beyond it are never
seen, where the original EC-L trains on all true pairs. Both are trained as our own model is: AdamW
with warm-up and decay, batches of graphs, averaged parameters of the best validation FGW.
"""

import abc
import dataclasses
import functools
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.baselines.edge_clusters import (
    Pairs,
    Rooms,
    rooms_by_communities,
    rooms_by_cycles,
    with_rooms_and_walls,
)
from sg3d_jax.baselines.edge_features import (
    Scales,
    absolute_features,
    near_planes,
    relative_features,
)
from sg3d_jax.fill.protocol import Params, Terms
from sg3d_jax.flagg.grow import ONE_SHOT, Grown
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.edge_attention import (
    NO_ROOM,
    EdgeAttentionClassifier,
    EdgeBranchGAT,
    RoomReadout,
    reverse_of,
    room_means,
)
from sg3d_jax.scene.graph import PackedGraph, SceneGraph, observed_of, subgraph
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, ROOM, WALL, Ontology
from sg3d_jax.scene.padding import Capacity, bucket, part_of_adjacency, stack
from sg3d_jax.scene.proximity import NEIGHBOURS, connect_observed

NEITHER, SAME_ROOM, SAME_WALL = range(3)
TOP = FLOOR  # of the graphs that they are trained and scored on; what is above rooms is left out


@dataclasses.dataclass(frozen=True)
class ECSquareConfig:
    """Sizes of the two networks of EC-square, 21,985 parameters each, and its threshold."""

    heads: int = 8
    width: int = 16
    decoder: tuple[int, ...] = (128, 64)
    threshold: float = 0.0  # of the logit; the original has 0.5


@dataclasses.dataclass(frozen=True)
class ECLConfig:
    """Sizes of the networks of EC-L, 106,963 parameters in the classifier, and its options."""

    node_width: int = 18
    heads: int = 6
    edge_width: int = 55
    decoder: tuple[int, ...] = (188, 236)
    dropout: float = 0.2
    certainty_passes: int = 10  # with dropout, to weigh the pairs of a room; 0: all weigh the same
    room_centroids: Literal["regressed", "mean"] = "regressed"  # mean: of the planes
    readout_width: int = 48


class Classified(NamedTuple):
    """What became of the edges of a padded graph; both directions agree."""

    same_room: Array  # bool[E]
    same_wall: Array  # bool[E]
    certainty: Array  # float[E], 0 to 1, of being in the same room


class EdgeClassifier(abc.ABC):
    """What EC-square and EC-L have in common: pure functions, and a rule of rooms on the host."""

    @property
    def ontology(self) -> Ontology:
        """The paper's: both know walls and rooms alone."""
        return PAPER_ONTOLOGY

    @abc.abstractmethod
    def classify(self, params: Params, key: Key[Array, ""], graph: SceneGraph) -> Classified:
        """Classifies the edges of a padded graph."""

    @abc.abstractmethod
    def offset(
        self, params: Params, graph: SceneGraph, room: Int[Array, " N"]
    ) -> Float[Array, "N 2"]:
        """Returns, metres, from the mean of the planes of each room to its centroid."""

    @abc.abstractmethod
    def rooms(self, pairs: Pairs, certainty: np.ndarray) -> Rooms:
        """Returns the rooms of pairs in the same room, given how certain these are."""

    def capacity(self, num_observed: int, num_missing: int) -> Capacity:
        """Returns the bucket of a scene, with as many edges as nearest neighbours can be."""
        nodes = bucket(num_observed).nodes
        return Capacity(nodes, 2 * NEIGHBOURS * nodes)

    def complete_lanes(
        self,
        params: Params,
        keys: Key[Array, " B"],
        given: PackedGraph,
        num_missing: Int[Array, " B"],
    ) -> Grown:
        """Completes stacked planes: networks on the device, rooms and walls on the host.

        Planes are as given, then come walls, then rooms, if any. The keys decide on the dropout
        that tells how certain a pair is; EC-square has none.
        """
        connected, classified = classify_batch(self, params, keys, given)
        lanes = _unstacked((connected, classified))
        found = [_rooms_and_walls(self, *lane) for lane in lanes]
        room = np.full(given.nodes.mask.shape, NO_ROOM)
        for row, (rooms, _) in zip(room, found, strict=True):
            for index, members in enumerate(rooms):
                row[list(members)] = index
        offset = np.asarray(offset_batch(self, params, given, jnp.asarray(room)))
        graphs = [
            with_rooms_and_walls(observed_of(graph), rooms, walls, row[: len(rooms)])
            for (graph, _), (rooms, walls), row in zip(lanes, found, offset, strict=True)
        ]
        capacity = Capacity(
            max(len(graph.nodes.label) for graph in graphs),
            max(len(graph.senders) for graph in graphs),
        )
        steps = jnp.ones(len(graphs), jnp.int32)
        return Grown(stack(graphs, capacity), ONE_SHOT * steps, steps)


@dataclasses.dataclass(frozen=True)
class ECSquare(EdgeClassifier):
    """EC-square.

    Attributes:
      config: sizes and options.
      scales: limits of the training set.
    """

    config: ECSquareConfig
    scales: Scales

    @property
    def network(self) -> EdgeBranchGAT:
        """The network of rooms, and that of walls."""
        return EdgeBranchGAT(self.config.heads, self.config.width, self.config.decoder)

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Params:
        """Draws initial parameters."""
        inputs = (*absolute_features(graph, self.scales), near_planes(graph))
        keys = dict(zip(("room", "wall"), jax.random.split(key), strict=True))
        return {name: self.network.init(of_network, *inputs) for name, of_network in keys.items()}

    def _logits(
        self, params: Params, graph: SceneGraph
    ) -> tuple[Float[Array, " E"], Float[Array, " E"]]:
        inputs = (*absolute_features(graph, self.scales), near_planes(graph))
        return (
            apply(self.network, params["room"], *inputs),
            apply(self.network, params["wall"], *inputs),
        )

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss on a complete graph with proximity edges, and its terms."""
        angle = jax.random.uniform(key, maxval=2 * jnp.pi)
        of_room, of_wall = self._logits(params, turned(graph, angle))
        near = near_planes(graph).mask
        error = optax.sigmoid_binary_cross_entropy
        terms = {
            "room": _mean(error(of_room, sharing(graph, ROOM).astype(jnp.float32)), near),
            "wall": _mean(error(of_wall, sharing(graph, WALL).astype(jnp.float32)), near),
        }
        return terms["room"] + terms["wall"], terms

    def classify(self, params: Params, key: Key[Array, ""], graph: SceneGraph) -> Classified:
        """Classifies the edges of a padded graph."""
        near = near_planes(graph)
        reverse = reverse_of(near, graph.nodes.mask.shape[0])
        chosen = [
            near.mask & ((both + both[reverse]) / 2 > self.config.threshold)
            for both in self._logits(params, graph)
        ]
        return Classified(*chosen, certainty=jnp.ones(reverse.shape))

    def offset(
        self, params: Params, graph: SceneGraph, room: Int[Array, " N"]
    ) -> Float[Array, "N 2"]:
        """Returns zero: a room stands at the mean of its planes."""
        return jnp.zeros((*room.shape, 2))

    def rooms(self, pairs: Pairs, certainty: np.ndarray) -> Rooms:
        """Returns the rooms along cycles of pairs."""
        return rooms_by_cycles(pairs)


@dataclasses.dataclass(frozen=True)
class ECL(EdgeClassifier):
    """EC-L.

    Attributes:
      config: sizes and options.
      scales: limits of the training set.
    """

    config: ECLConfig
    scales: Scales

    @property
    def network(self) -> EdgeAttentionClassifier:
        """The network that classifies pairs."""
        config = self.config
        sizes = config.heads, config.node_width, config.edge_width, config.decoder
        return EdgeAttentionClassifier(*sizes, num_classes=3, dropout=config.dropout)

    @property
    def readout(self) -> RoomReadout:
        """The network that places rooms."""
        return RoomReadout(self.config.readout_width)

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Params:
        """Draws initial parameters."""
        of_edges, of_rooms = jax.random.split(key)
        inputs = (*relative_features(graph, self.scales), near_planes(graph))
        alone = jnp.full(graph.nodes.mask.shape, NO_ROOM)
        return {
            "classifier": self.network.init(of_edges, *inputs),
            "readout": self.readout.init(of_rooms, *_on_ground(graph), alone),
        }

    def _logits(
        self, params: Params, key: Key[Array, ""] | None, graph: SceneGraph
    ) -> Float[Array, "E 3"]:
        inputs = (*relative_features(graph, self.scales), near_planes(graph))
        return apply(self.network, params["classifier"], *inputs, key)

    def offset(
        self, params: Params, graph: SceneGraph, room: Int[Array, " N"]
    ) -> Float[Array, "N 2"]:
        """Returns, metres, from the mean of the planes of each room to its centroid."""
        if self.config.room_centroids == "mean":
            return jnp.zeros((*room.shape, 2))
        return self._regressed(params, graph, room)

    def _regressed(
        self, params: Params, graph: SceneGraph, room: Int[Array, " N"]
    ) -> Float[Array, "N 2"]:
        unit = self.scales.width_max
        position, normal, width = _on_ground(graph)
        inputs = position / unit, normal, width / unit, room
        return unit * apply(self.readout, params["readout"], *inputs)

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss on a complete graph with proximity edges, and its terms."""
        truth = jnp.where(sharing(graph, WALL), SAME_WALL, NEITHER)
        truth = jnp.where(sharing(graph, ROOM), SAME_ROOM, truth)
        logits = self._logits(params, key, graph)
        error = optax.softmax_cross_entropy_with_integer_labels(logits, truth)
        room = _true_rooms(graph)
        means = room_means(graph.nodes.position[:, :2], room)
        centroid = means + self._regressed(params, graph, room)
        squared = jnp.sum((centroid - graph.nodes.position[:, :2]) ** 2, axis=-1)
        is_room = graph.nodes.mask & (graph.nodes.label == ROOM)
        terms = {"edge": _mean(error, near_planes(graph).mask), "centroid": _mean(squared, is_room)}
        return terms["edge"] + terms["centroid"], terms

    def classify(self, params: Params, key: Key[Array, ""], graph: SceneGraph) -> Classified:
        """Classifies the edges of a padded graph."""
        found = jnp.argmax(self._logits(params, None, graph), axis=-1)
        near, certainty = near_planes(graph).mask, jnp.ones(found.shape)
        if self.config.certainty_passes:
            keys = jax.random.split(key, self.config.certainty_passes)
            passes = jax.vmap(lambda key: self._logits(params, key, graph))(keys)
            certainty = certainty_of(passes)
        return Classified(near & (found == SAME_ROOM), near & (found == SAME_WALL), certainty)

    def rooms(self, pairs: Pairs, certainty: np.ndarray) -> Rooms:
        """Returns the communities of pairs."""
        return rooms_by_communities(pairs, certainty)


def certainty_of(logits: Float[Array, "passes E K"]) -> Float[Array, " E"]:
    """Returns 1 less the entropy, in nats, of the mean prediction; at least 0.

    Source: EC-L (MC dropout).
    """
    share = jnp.mean(jax.nn.softmax(logits, axis=-1), axis=0)
    entropy = -jnp.sum(jax.scipy.special.xlogy(share, share), axis=-1)
    return jnp.clip(1 - entropy, 0.0, 1.0)


def turned(graph: SceneGraph, angle: Float[Array, ""]) -> SceneGraph:
    """Turns the planes of a padded graph about the vertical through the origin."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    matrix = jnp.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    nodes = graph.nodes
    position, normal = nodes.position @ matrix.T, nodes.normal @ matrix.T
    return graph._replace(nodes=nodes._replace(position=position, normal=normal))


def sharing(graph: SceneGraph, concept: int) -> Bool[Array, " E"]:
    """Returns whether the ends of each edge are parts of one node of a concept."""
    chosen = graph.nodes.mask & (graph.nodes.label == concept)
    part_of = (part_of_adjacency(graph) & chosen[None, :]).astype(jnp.float32)
    return (part_of @ part_of.T)[graph.senders, graph.receivers] > 0


def _true_rooms(graph: SceneGraph) -> Int[Array, " N"]:
    """Returns the slot of the room of each plane, NO_ROOM for all that have none."""
    nodes = graph.nodes
    room = nodes.mask & (nodes.label == ROOM)
    part_of = part_of_adjacency(graph) & room[None, :] & nodes.observed[:, None]
    return jnp.where(jnp.any(part_of, axis=-1), jnp.argmax(part_of, axis=-1), NO_ROOM)


def _on_ground(graph: SceneGraph) -> tuple[Array, Array, Array]:
    """Returns position and normal of the nodes in the ground plane, and their width."""
    return graph.nodes.position[:, :2], graph.nodes.normal[:, :2], graph.nodes.width


def _mean(values: Float[Array, " K"], mask: Bool[Array, " K"]) -> Float[Array, ""]:
    return jnp.sum(jnp.where(mask, values, 0.0)) / jnp.maximum(jnp.sum(mask), 1)


def target(graph: SceneGraph) -> SceneGraph:
    """Returns what a completed graph is scored against: the truth without its floors.

    Raises:
      ValueError: the host graph has buildings or cities.

    Source: paper, Sec. "Baselines".
    """
    label = np.asarray(graph.nodes.label)
    if (label > TOP).any():
        raise ValueError(
            "edge classifiers know no concept above the room and are scored on floors, expected "
            "graphs without buildings or cities"
        )
    return subgraph(graph, label != FLOOR)


@functools.partial(jax.jit, static_argnums=0)
def classify_batch(
    model: EdgeClassifier, params: Params, keys: Key[Array, " B"], planes: PackedGraph
) -> tuple[SceneGraph, Classified]:
    """Connects the planes of stacked scenes and classifies their edges."""
    connected = jax.vmap(connect_observed)(planes)
    classify = functools.partial(model.classify, params)
    return connected, jax.vmap(classify)(keys, connected)


@functools.partial(jax.jit, static_argnums=0)
def offset_batch(
    model: EdgeClassifier, params: Params, planes: SceneGraph, room: Int[Array, "B N"]
) -> Float[Array, "B N 2"]:
    """Returns the offset of each room's centroid from the mean of its planes, metres."""
    return jax.vmap(functools.partial(model.offset, params))(planes, room)


def _rooms_and_walls(
    model: EdgeClassifier, graph: SceneGraph, classified: Classified
) -> tuple[Rooms, Pairs]:
    """Returns the rooms and the pairs of planes that are walls, of one padded graph."""
    pairs = np.stack([graph.senders, graph.receivers], axis=-1)
    once = pairs[:, 0] < pairs[:, 1]
    in_room, in_wall = once & classified.same_room, once & classified.same_wall
    certainty = np.asarray(classified.certainty)[in_room]
    return model.rooms(pairs[in_room], certainty), pairs[in_wall]


def _unstacked(stacked: Any) -> list[Any]:
    """Returns the items of a stack of trees, on the host."""
    leaves, tree = jax.tree.flatten(jax.tree.map(np.asarray, stacked))
    return [tree.unflatten(items) for items in zip(*leaves, strict=True)]
