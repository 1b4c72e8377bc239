"""One growth step and its loss: Insert, Fill and Halt put together.

Source: paper, Eq. (flagg_transition).
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.diffusion.threefry import unrolled
from sg3d_jax.fill.constraints import Rules, is_whole, rules_of
from sg3d_jax.fill.protocol import Fill, Terms
from sg3d_jax.flagg.compiled import in_32_bits, own_types
from sg3d_jax.flagg.corrupt import CorruptionConfig, corrupt
from sg3d_jax.flagg.halt import Halt, draw_halt, halt_loss
from sg3d_jax.flagg.insert import Insert, draw_size, insert_loss
from sg3d_jax.flagg.kinds import Kinds, kind_loss
from sg3d_jax.flagg.ordering import Ordering, grown_layers, is_upper
from sg3d_jax.flagg.placement import Placement, placement_loss
from sg3d_jax.flagg.removal import Cut, draw_continuations, draw_cut
from sg3d_jax.nn.kin import kin_fit
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import Block, append_block


@dataclasses.dataclass(frozen=True)
class FlaggConfig:
    """The removal process, the noise augmentation, and the sizes of Insert and Halt."""

    coins: tuple[int, ...] = (1, 4)  # block sizes
    ordering: Ordering = "H"
    layers: tuple[str, ...] = ()  # sigma_C, the order in which concepts come; empty: bottom-up
    continuations: int = 1  # blocks that may come next, trained on one encoded graph
    any_cuts: float = 0.0  # share of the training cuts that remove any nodes, not only the last
    upper: str = ""  # concept from which on Fill has parameters of its own; empty: none
    corruption: CorruptionConfig = CorruptionConfig()
    width: int = 32  # of Insert, Halt and Kinds
    depth: int = 2  # GINE layers of Insert, Halt and Kinds
    placement: tuple[int, ...] = ()  # width, channels and layers of Placement; empty: none
    halt_by_threshold: bool = True  # False: by a draw
    constrained: bool = True  # whether what is grown obeys the rules of the ontology

    def __post_init__(self) -> None:
        """Refuses continuations where one node alone may come next, and sizes that are none."""
        if len(self.placement) not in (0, 3) or min(self.placement, default=1) < 1:
            raise ValueError(
                f"flagg.placement is {self.placement}, expected a width, channels and layers, or "
                "nothing"
            )
        if self.continuations < 1 or (self.continuations > 1 and self.ordering != "H"):
            raise ValueError(
                f"flagg.continuations is {self.continuations}, expected 1, or more in the order H: "
                "HP leaves one node that comes next"
            )


class Params(NamedTuple):
    """Parameters of the modules; nothing else holds any."""

    insert: Any  # of Insert; empty where there is one block size
    fill: Any  # of the Fill model
    halt: Any  # of Halt
    kinds: Any = None  # of Kinds; None where what is grown has none
    upper: Any = None  # of Fill, for `FlaggConfig.upper` and what comes after it; None for `fill`
    placement: Any = None  # of Placement; None where centroids stay as they are drawn


def with_upper(params: Params, config: FlaggConfig) -> Params:
    """Returns parameters with those of the upper layers if a configuration has any, else without.

    Where they have none yet they begin with those of Fill, and so draw what it draws.
    """
    if not config.upper:
        return params._replace(upper=None)
    return params if params.upper is not None else params._replace(upper=params.fill)


class Growth(NamedTuple):
    """What one growth step leaves."""

    graph: PackedGraph  # with the block, if it was inserted
    inserted: Array  # bool[], whether it was: it had room, and was not drawn in vain
    halted: Array  # bool[], Halt's decision
    fits: Array  # bool[], whether the block had room
    closing: Array  # bool[], Halt would end, but something grown still lacks its whole
    upper: Array  # bool[], whether blocks are drawn by the parameters of the upper layers


@dataclasses.dataclass(frozen=True)
class Flagg:
    """A model that grows: a Fill model with Insert and Halt around it; see `make_flagg`.

    Attributes:
      config: how it grows.
      insert: how many nodes come next.
      fill: what they are.
      halt: whether the graph is complete.
      kinds: what kind the grown nodes of a graph are of; None if their concepts have none.
      placement: where the grown nodes of a graph stand; None to leave them where they are drawn.

    Raises:
      ValueError: the order of the layers is none of the concepts of the Fill model, or the first
        of the upper layers is none that is grown.
    """

    config: FlaggConfig
    insert: Insert
    fill: Fill
    halt: Halt
    kinds: Kinds | None = None
    placement: Placement | None = None

    def __post_init__(self) -> None:
        """Refuses an order of other concepts, and upper layers of what is not grown."""
        layers, upper = grown_layers(self.ontology, self.config.layers), self.config.upper
        if upper and upper not in layers:
            raise ValueError(
                f"flagg.upper is {upper!r:.40}, expected a concept that is grown: "
                f"{', '.join(layers)}"
            )

    @property
    def ontology(self) -> Ontology:
        """The concepts."""
        return self.fill.ontology

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Params:
        """Draws initial parameters; `graph` is any padded graph."""
        key = unrolled(key)
        keys = jax.random.split(key, 4)
        cut = cut_graph(self.config, keys[0], graph)
        fill = self.fill.init(keys[2], cut.survivors, cut.block)
        return Params(
            insert=self.insert.init(keys[1], cut.survivors),
            fill=fill,
            halt=self.halt.init(keys[3], cut.survivors),
            kinds=self.kinds and self.kinds.init(jax.random.fold_in(key, 4), cut.survivors),
            upper=fill if self.config.upper else None,
            placement=self.placement
            and self.placement.init(jax.random.fold_in(key, 5), cut.survivors),
        )

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the sum of all losses on one random cut of one complete graph, and its terms.

        All modules see the perturbed conditioning graph; the clean block is the target. Kinds are
        asked of it, too, and not only of complete graphs: it costs no further encoder of edges.

        Source: FLAGG (one sum of the losses of all modules); paper, Sec. "Noise augmentation".
        """
        key_upper, key_placement = (jax.random.fold_in(key, number) for number in (1, 2))
        with own_types():
            total, terms = self._loss(params, key, in_32_bits(graph))
        if self.config.upper:
            upper, of_upper = self.upper_loss(params, key_upper, graph)
            total, terms = total + upper, terms | of_upper
        if self.placement is not None:
            placement, of_placement = self.placement_loss(params, key_placement, graph)
            total, terms = total + placement, terms | of_placement
        return total, terms

    def upper_loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss of Fill's parameters for the upper layers, and its terms.

        On a cut of their own, from which nothing below `FlaggConfig.upper` is missing: whoever
        trains these alone, on what a model has seldom seen, leaves all else as it is.

        Source: ours.
        """
        with own_types():
            graph = in_32_bits(graph)
            keys = jax.random.split(unrolled(key), 4)
            _, _, loss, terms = self._fill_loss(params.upper, keys, graph, self.config.upper)
        return loss, {f"upper_{name}": term for name, term in terms.items()}

    def placement_loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss of Placement on a complete graph, perturbed as in all training."""
        assert self.placement is not None
        with own_types():
            graph = in_32_bits(graph)
            seen = corrupt(graph, unrolled(key), self.config.corruption)
            position = self.placement.positions(params.placement, seen)
            loss = placement_loss(position, seen, graph)
        return loss, {"placement": loss}

    def _loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        keys = jax.random.split(unrolled(key), 4)
        cut, old, fill_loss, terms = self._fill_loss(params.fill, keys, graph)
        terms["insert"] = insert_loss(self.insert.logits(params.insert, old), cut.insert_probs)
        terms["halt"] = halt_loss(self.halt.logit(params.halt, old), cut.complete, cut.inserted)
        total = fill_loss + terms["insert"] + terms["halt"]
        if self.kinds is None:
            return total, terms
        terms["kind"] = kind_loss(self.kinds.logits(params.kinds, old), old, cut.survivors)
        return total + terms["kind"], terms

    def _fill_loss(
        self, fill_params: Any, keys: Key[Array, "4"], graph: SceneGraph, upper: str = ""
    ) -> tuple[Cut, SceneGraph, Float[Array, ""], Terms]:
        """Returns a cut, its old graph as the modules see it, and Fill's loss with its terms."""
        key_cut, key_corrupt, key_blocks, key_fill = keys
        config, number = self.config, self.config.continuations
        cut = cut_graph(config, key_cut, graph, upper)
        old = corrupt(cut.survivors, key_corrupt, config.corruption)
        if number == 1:
            blocks = jax.tree.map(lambda leaf: leaf[None], cut.block)
        else:
            blocks = draw_continuations(graph, cut, key_blocks, number, config.layers)

        def fill(key: Key[Array, ""], block: Block) -> Any:  # encodes the old graph once under vmap
            return self.fill.loss(fill_params, key, old, block)

        losses = jax.vmap(fill)(jax.random.split(key_fill, number), blocks)
        return cut, old, *jax.tree.map(jnp.mean, losses)

    def step(
        self,
        params: Params,
        key: Key[Array, ""],
        graph: PackedGraph,
        closing: Bool[Array, ""] | bool = False,
        upper: Bool[Array, ""] | bool = False,
    ) -> Growth:
        """Inserts one block into a packed graph and asks Halt.

        Where the upper layers have parameters of their own, the first block of those is not
        inserted: it only says that what is below them is there, and they draw what comes next.
        Where that is plain from the order and the rules (`_ends_lower`) none is drawn in vain.

        Args:
          params: of the modules, `fill` being what the block is drawn by (`drawing`).
          key: of all that is drawn.
          graph: to be grown.
          closing: whether only what gives a node the whole that it lacks may come.
          upper: whether those are the parameters of the upper layers.

        Source: paper, Eq. (flagg_transition).
        Differs: parameters for the upper layers are ours.
        """
        key_insert, key_fill, key_halt = jax.random.split(key, 3)
        coins = self.config.coins
        size = draw_size(key_insert, self.insert.logits(params.insert, graph), coins)
        block_mask: Bool[Array, " M"] = jnp.arange(max(coins)) < size
        rules = self._rules(graph, closing)
        block: Block = self.fill.sample(params.fill, key_fill, graph, block_mask, rules)
        grown, fits = append_block(graph, block)
        if self.fill.kin:
            fits &= kin_fit(grown)
        upper = jnp.asarray(upper)
        turns = ~upper & jnp.any(block.mask) & jnp.all(self._upper[block.label] | ~block.mask)
        inserted = fits & ~turns
        grown = jax.tree.map(lambda new, old: jnp.where(inserted, new, old), grown, graph)
        rules = self._rules(grown)
        halted, closes = self._halts(params, key_halt, grown, rules)
        closes = jnp.where(turns, closing, closes)
        upper |= turns | (inserted & self._ends_lower(grown, rules))
        return Growth(grown, inserted, halted & ~turns, fits | turns, closes, upper)

    def drawing(self, params: Params, upper: Bool[Array, ""]) -> Params:
        """Returns the parameters with those in the place of `fill` that draw blocks now."""
        if not self.config.upper:
            return params
        choose = functools.partial(jnp.where, upper)
        return params._replace(fill=jax.tree.map(choose, params.upper, params.fill))

    def ends_upper(self, graph: PackedGraph) -> Bool[Array, ""]:
        """Returns whether the last node of a packed graph is of the upper layers."""
        return self._upper[_last_label(graph)]

    def _ends_lower(self, graph: PackedGraph, rules: Rules | None) -> Bool[Array, ""] | bool:
        """Returns whether nothing but the upper layers can come after the last node of a graph.

        That is where it is of the layer below them, which comes last in the order of insertion, and
        the rules allow no more of that: every plane has its room.
        """
        order = grown_layers(self.ontology, self.config.layers)
        place = order.index(self.config.upper) if self.config.upper else 0
        if place == 0 or rules is None:
            return False
        below = self.ontology.label_of(order[place - 1])
        return (_last_label(graph) == below) & ~rules.label[below]

    @property
    def _upper(self) -> Bool[Array, " C"]:
        return jnp.asarray(is_upper(self.ontology, self.config.upper, self.config.layers))

    def halts(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
        """Returns whether a padded graph is at its end, and whether it is but for what closes it.

        A graph in which something grown lacks the whole that is due does not end while a block can
        mend that; one to which nothing can be added does.
        """
        return self._halts(params, key, graph, self._rules(graph))

    def _halts(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph, rules: Rules | None
    ) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
        """Returns what `halts` does, given the rules of the graph; None where none are kept."""
        logit = self.halt.logit(params.halt, graph)
        wants = draw_halt(key, logit, self.config.halt_by_threshold)
        if rules is None:
            return wants, jnp.zeros((), bool)
        ends = is_whole(graph, self.config.layers) | ~jnp.any(rules.closes)
        halted = (wants & ends) | ~jnp.any(rules.label)
        return halted, wants & ~halted

    def _rules(self, graph: SceneGraph, closing: Bool[Array, ""] | bool = False) -> Rules | None:
        if not self.config.constrained:
            return None
        return rules_of(graph, max(self.config.coins), self.config.layers, closing)


def _last_label(graph: PackedGraph) -> Int[Array, ""]:
    """Returns the label of the last node of a packed graph."""
    return graph.nodes.label[jnp.sum(graph.nodes.mask) - 1]


def check_grows(model: Any, params: Any) -> None:
    """Refuses what does not grow, and what are no parameters of what does.

    Raises:
      ValueError: one sentence that says what it is.
    """
    if not isinstance(model, Flagg):
        raise ValueError(f"the model is a {type(model).__name__}, expected one that grows, a Flagg")
    if not isinstance(params, Params):
        held = type(params).__name__
        raise ValueError(f"the parameters are a {held}, expected Params of a model that grows")
    if model.config.upper and params.upper is None:
        expected = f"those from {model.config.upper} on, too (with_upper)"
        raise ValueError(f"the parameters have none of upper layers, expected {expected}")


def make_flagg(config: FlaggConfig, fill: Fill) -> Flagg:
    """Puts the other modules, of the sizes of a configuration, around a Fill model."""
    insert = Insert(config.width, config.depth, len(config.coins))
    kinds = Kinds(config.width, config.depth, fill.ontology)
    kinds = kinds if kinds.most else None
    placement = Placement(*config.placement) if config.placement else None
    return Flagg(config, insert, fill, Halt(config.width, config.depth), kinds, placement)


def cut_graph(config: FlaggConfig, key: Key[Array, ""], graph: SceneGraph, upper: str = "") -> Cut:
    """Cuts a complete padded graph at a random step of a random insertion sequence.

    Nothing below the concept `upper` is removed, if there is one.
    """
    order = config.ordering, config.layers
    return draw_cut(graph, key, config.coins, *order, config.any_cuts, upper)
