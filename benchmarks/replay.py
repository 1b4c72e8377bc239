"""How a map fares while a robot drives: quality, ids that stay, latency, compilations, memory.

    python benchmarks/replay.py midi-general --data s-f p-f.npz s-b p-c.npz --scenes 10
    python benchmarks/replay.py midi-general --data s-f --how loop
    python benchmarks/replay.py midi-general --data s-c --scenes 1 --updates 10000
    python benchmarks/replay.py midi-general --data s-c --scenes 1 --planes 600 -o large_map.json

Test scenes are driven through (`data.replay`), and every step is an update of a session. Told are
FGW at the end, and once the map has been thought over four times, against that of completing the
same planes all at once with the same weights and steps, drawn once and as `sg3d complete` does; FGW
on the way; of the rooms of whose planes an update says nothing, the share that keep id,
planes and centroid to the last bit; how often the id of a true room changes, which is that of the
grown room with the most of its planes, at least half; the median time of an update, by the number
of planes; what is compiled once all is warmed up; with --updates, memory while one plane after
the other moves; and, with --planes, the median time of an update of a map of so many, where other
scenes of the set stand beside the first one, which is driven through. Writes
benchmarks/results/replay_HOW.json, its curves as replay_HOW.png, and eight pictures of the longest
replay of the first data set as replay_HOW_film.png.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import jax
import numpy as np

from sg3d_jax.cli.provenance import provenance_of_script
from sg3d_jax.data.replay import REPLAYS, Step, replay
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.complete import complete
from sg3d_jax.infer.session import Session, begin, graph_of, ids_of, nodes_of, update, warm_up
from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.scene.changes import Changes, GraphChanges, GrownNode
from sg3d_jax.scene.graph import SceneGraph, observed_of, parts_first, subgraph
from sg3d_jax.scene.ontology import ROOM
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import Trained, load_weights, with_diffusion_steps

RESULTS: Final = Path(__file__).parent / "results"
SHARES: Final = np.linspace(0.1, 1, 10)  # of the way, at which FGW is taken
SIZES: Final = (50, 200, 600)  # planes
PICTURES: Final = 8
PIECES: Final = 2  # of a plane, for which is warmed up
THOUGHTS: Final = 4  # when the robot is done
MOVE: Final = 0.05  # metres, standard deviation
APART: Final = 100.0  # metres, from a scene to the next


class Update(NamedTuple):
    """An update, and the map after it."""

    step: Step
    session: Session
    nodes: Mapping[int, GrownNode]
    done: GraphChanges
    seconds: float


class Compilations:
    """Counts what JAX compiles, or takes from its cache."""

    def __init__(self) -> None:
        """Listens from now on."""
        self.count = 0
        jax.monitoring.register_event_duration_secs_listener(self._hear)

    def _hear(self, event: str, *_: Any, **__: Any) -> None:
        self.count += event.endswith("backend_compile_duration")


def grows(trained: Trained) -> Flagg:
    """Returns the model of weights, which a session can use.

    Raises:
      ValueError: it does not grow.
    """
    if not isinstance(trained.model, Flagg):
        raise ValueError(f"{trained.name} does not grow, expected weights of a model that does")
    return trained.model


def driven(trained: Trained, steps: Sequence[Step]) -> list[Update]:
    """Has a session follow a replay."""
    model, updates = grows(trained), []
    session = begin(model.ontology)
    for step in steps:
        began = time.perf_counter()
        session, done = update(model, trained.params, session, step.changes)
        seconds = time.perf_counter() - began
        updates.append(Update(step, session, nodes_of(session), done, seconds))
    return updates


def pair(one: Update) -> tuple[SceneGraph, SceneGraph]:
    """Returns the graph of a map and its truth, over the same planes in the same order."""
    place: dict[int | str, int] = {name: row for row, name in enumerate(one.step.ids)}
    count = len(place)
    order = [place[name] for name in ids_of(one.session)[:count]]
    rest = range(count, len(one.step.truth.nodes.label))
    return graph_of(one.session), subgraph(one.step.truth, np.array([*order, *rest]))


def distances(pairs: Sequence[tuple[SceneGraph, SceneGraph]]) -> np.ndarray:
    """Returns the FGW of pairs of host graphs, float[p]."""
    made, truths = [one for one, _ in pairs], [truth for _, truth in pairs]
    return np.asarray(fgw_pairs(made, truths).value, np.float64)


def curve(drives: Sequence[Sequence[Update]]) -> list[float]:
    """Returns the mean FGW at shares of the way."""
    places = [np.ceil(SHARES * len(updates)).astype(int) - 1 for updates in drives]
    pairs = [
        pair(updates[place])
        for updates, of_drive in zip(drives, places, strict=True)
        for place in of_drive
    ]
    means = distances(pairs).reshape(len(drives), -1).mean(axis=0)
    return [round(value, 4) for value in means.tolist()]


def thought(trained: Trained, drives: Sequence[Sequence[Update]]) -> float:
    """Returns the mean FGW at the end, once each map has been thought over some times."""
    pairs = []
    for updates in drives:
        last = updates[-1]
        for _ in range(THOUGHTS):
            session, _ = update(grows(trained), trained.params, last.session, Changes(think=True))
            last = last._replace(session=session)
        pairs.append(pair(last))
    return float(np.mean(distances(pairs)))


def at_once(trained: Trained, drives: Sequence[Sequence[Update]], candidates: int | None) -> float:
    """Returns the mean FGW of completing what each map has at the end all at once."""
    truths = [updates[-1].step.truth for updates in drives]
    scenes = [observed_of(truth) for truth in truths]
    made = complete(trained.model, trained.params, scenes, candidates=candidates)
    grown = [samples[0].graph for samples in made]
    return float(np.mean(distances([*zip(grown, truths, strict=True)])))


def rooms_kept(updates: Sequence[Update]) -> list[bool]:
    """Returns of each room that an update says nothing of whether it is what it was."""
    kept = []
    for before, after in pairwise(updates):
        told = after.step.changes
        touched = {*told.ids, *told.removed, *(name for each in told.merged for name in each)}
        for node in before.nodes.values():
            if node.label == ROOM and not touched & {*node.observed}:
                now = after.nodes.get(node.id)
                kept.append(
                    now is not None
                    and {*now.observed} == {*node.observed}
                    and now.position == node.position
                )
    return kept


def id_changes(updates: Sequence[Update]) -> list[int]:
    """Returns how often the id of each true room changes on the way."""
    last: dict[int, int] = {}
    changes: dict[int, int] = {}
    for one in updates:
        truth, ids = one.step.truth, one.step.ids
        planes: dict[int, set[int]] = {}
        for part, whole in parts_first(truth).tolist():
            if part < len(ids) and truth.nodes.label[whole] == ROOM:
                planes.setdefault(int(one.step.rows[whole - len(ids)]), set()).add(ids[part])
        grown = [node for node in one.nodes.values() if node.label == ROOM]
        for room, wanted in planes.items():
            fit = [len(wanted & {*n.observed}) / len(wanted | {*n.observed}) for n in grown]
            if fit and max(fit) >= 0.5:
                found = grown[int(np.argmax(fit))].id
                changes[room] = changes.get(room, 0) + (last.get(room, found) != found)
                last[room] = found
    return [*changes.values()]


def milliseconds(drives: Sequence[Sequence[Update]]) -> dict[str, float]:
    """Returns the median time of an update by the number of planes of the map."""
    pairs = [(len(one.step.ids), one.seconds) for updates in drives for one in updates]
    rows = {}
    for low, high in pairwise((0, *SIZES)):
        seconds = [each for count, each in pairs if low < count <= high]
        if seconds:
            rows[f"up to {high} planes"] = round(1e3 * float(np.median(seconds)), 1)
    return rows


def measured(
    trained: Trained, data: str, how: str, scenes: int, counted: Compilations
) -> tuple[dict[str, Any], list[Update]]:
    """Measures replays of the first scenes of a test split; returns the longest, too."""
    graphs = load_split(DataConfig(data), "test")[:scenes]
    replays = [replay(graph, REPLAYS[how], 0, index) for index, graph in enumerate(graphs)]
    warm_up(grows(trained), trained.params, PIECES * max(len(steps[-1].ids) for steps in replays))
    before = counted.count
    drives = [driven(trained, steps) for steps in replays]
    compiled = counted.count - before
    way, after = curve(drives), thought(trained, drives)
    whole, best = at_once(trained, drives, 1), at_once(trained, drives, None)
    kept = [each for updates in drives for each in rooms_kept(updates)]
    changes = [each for updates in drives for each in id_changes(updates)]
    row = {
        "scenes": len(graphs),
        "updates": sum(map(len, drives)),
        "planes": round(float(np.mean([len(updates[-1].step.ids) for updates in drives])), 1),
        "fgw": way[-1],
        "fgw_at_once": round(whole, 4),
        "fgw_thought_over": round(after, 4),
        "fgw_at_once_by_default": round(best, 4),
        "ratio": round(after / whole, 3),
        "fgw_on_the_way": dict(zip(SHARES.round(1).tolist(), way, strict=True)),
        "rooms_kept": round(float(np.mean(kept)), 4),
        "id_changes_a_room": round(float(np.mean(changes)), 3),
        "milliseconds": milliseconds(drives),
        "compilations": compiled,
    }
    return row, max(drives, key=len)


def memory(trained: Trained, last: Update, updates: int) -> list[float]:
    """Returns the resident memory, MiB, at ten places of many updates that move a plane each."""
    model, session, planes = grows(trained), last.session, observed_of(graph_of(last.session))
    ids, rng, held = ids_of(session), np.random.default_rng(0), []
    for number in range(1, updates + 1):
        row = int(rng.integers(len(planes.nodes.label)))
        one = subgraph(planes, [row])
        one.nodes.position[:, :2] += rng.normal(0, MOVE, 2)
        changes = Changes(observed=one, ids=(ids[row],))
        session, _ = update(model, trained.params, session, changes)
        if number % max(1, updates // 10) == 0:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            held.append(round(pages * 4096 / 2**20, 1))
    return held


def among_others(trained: Trained, graphs: Sequence[SceneGraph], planes: int) -> dict[str, float]:
    """Drives through the first scene, while others stand beside it until there are so many planes.

    Returns:
      The number of planes at the end, and the median milliseconds of an update, of wall and of CPU.
    """
    model, steps = grows(trained), replay(graphs[0], REPLAYS["drive"], 0, 0)
    session, count, times = begin(model.ontology), len(steps[-1].ids), []
    for number, graph in enumerate(graphs[1:], 1):
        if count >= planes:
            break
        seen = observed_of(graph)
        seen.nodes.position[:, 0] += number * APART
        ids = tuple(f"{number}/{row}" for row in range(len(seen.nodes.label)))
        session, _ = update(model, trained.params, session, Changes(observed=seen, ids=ids))
        count += len(ids)
    for step in steps:
        began = time.perf_counter(), time.process_time()
        session, _ = update(model, trained.params, session, step.changes)
        times.append((time.perf_counter() - began[0], time.process_time() - began[1]))
    wall, cpu = (1e3 * np.median(times, axis=0)).round(1).tolist()
    return {"planes": count, "updates": len(times), "milliseconds": wall, "cpu_milliseconds": cpu}


def draw_curves(rows: Mapping[str, Any], path: Path) -> None:
    """Plots FGW on the way, and that of completing all at once at the end."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.4), layout="constrained")
    axes = figure.subplots()
    for name, row in rows.items():
        (line,) = axes.plot(100 * SHARES, [*row["fgw_on_the_way"].values()], "o-", label=name)
        axes.plot([100], [row["fgw_at_once"]], "*", color=line.get_color(), markersize=11)
    axes.set(xlabel="share of the way, %", ylabel="FGW", ylim=(0, None))
    axes.set_title("Maps while they come about; stars: all planes at once", fontsize=10)
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


def draw_film(updates: Sequence[Update], path: Path) -> None:
    """Draws a map at eight places of its way."""
    from sg3d_jax.viz.figure import contact_sheet

    places = np.ceil(np.linspace(0, 1, PICTURES + 1)[1:] * len(updates)).astype(int) - 1
    chosen = [updates[place] for place in places]
    values = distances([pair(one) for one in chosen])
    captions = [
        f"update {place + 1} of {len(updates)}: {len(one.step.ids)} planes, FGW {value:.3f}"
        for place, one, value in zip(places, chosen, values, strict=True)
    ]
    graphs = [graph_of(one.session) for one in chosen]
    half = PICTURES // 2
    contact_sheet([("", graphs[:half]), ("", graphs[half:])], path, captions)


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights")
    parser.add_argument("--data", nargs="+", default=["s-f"], help="by name, or files")
    parser.add_argument("--how", choices=[*REPLAYS], default="drive")
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--diffusion-steps", type=int, default=8)
    parser.add_argument("--updates", type=int, default=0, help="for memory")
    parser.add_argument("--planes", type=int, default=0, help="of a large map")
    parser.add_argument("-o", "--output", help="name of the result file, in benchmarks/results")
    given = parser.parse_args()
    trained = with_diffusion_steps(load_weights(given.weights), given.diffusion_steps)
    counted, rows, film = Compilations(), {}, []
    for data in given.data:
        name = Path(data).stem
        rows[name], longest = measured(trained, data, given.how, given.scenes, counted)
        film = film or longest
        if given.updates:
            rows[name]["mebibytes"] = memory(trained, longest[-1], given.updates)
        if given.planes:
            graphs = load_split(DataConfig(data), "test")
            rows[name]["large_map"] = among_others(trained, graphs, given.planes)
        print(name, rows[name], flush=True)
    about = provenance_of_script()
    path = RESULTS / (given.output or f"replay_{given.how}.json")
    path.write_text(json.dumps({**about, "weights": given.weights, "rows": rows}, indent=2) + "\n")
    draw_curves(rows, path.with_suffix(".png"))
    draw_film(film, path.with_name(f"{path.stem}_film.png"))


if __name__ == "__main__":
    main()
