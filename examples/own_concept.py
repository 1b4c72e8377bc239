"""A class of one's own, in ten lines of configuration: windows, which no weights of ours know.

    python examples/own_concept.py
    sg3d train examples/own_concept.py
    sg3d complete scene.json -o graph.json --weights runs/own_concept/weights.npz

The first line draws windows.npz, furnished floors whose outer sides have windows; yours is a file
of graphs of your own. The second starts from weights that know everything but windows. In
scene.json, windows are then listed among the objects: {"class": "window", "centroid": [...],
"size": [...]}.
"""

import dataclasses

import numpy as np

import sg3d_jax as sg
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.scene.graph import parts_first
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.presets import find_config

PLANE, *OTHERS = FURNISHED_ONTOLOGY.concepts
WINDOW = sg.Concept("window", "#0ea5e9", "i", "WINDOWS", observed=True, features=("width",))
ONTOLOGY = sg.Ontology(
    concepts=(PLANE, WINDOW, *OTHERS),
    rules=(*FURNISHED_ONTOLOGY.rules, sg.Rule("window", "room")),
)
CONFIG = dataclasses.replace(
    find_config("midi-furnished"),
    data=DataConfig(name="windows.npz"),
    ontology=ONTOLOGY,
    initial="midi-furnished",
    steps=2_000,
)

LEAST_WIDTH = 1.5  # of a side that has a window, metres
HEIGHT = 1.4  # of the middle of a window, metres


def with_windows(graph: sg.SceneGraph) -> sg.SceneGraph:
    """Returns a furnished scene with a window in every wide side of a room that is in no wall."""
    nodes, known, pairs = graph.nodes, sg.ontology_of(graph), parts_first(graph)
    plane, wall, room = (known.label_of(name) for name in ("plane", "wall", "room"))
    inner = pairs[(nodes.label[pairs] == (plane, wall)).all(axis=1), 0]
    sides = pairs[(nodes.label[pairs] == (plane, room)).all(axis=1)]
    wide = nodes.width[sides[:, 0]] >= LEAST_WIDTH
    side, of_room = sides[wide & ~np.isin(sides[:, 0], inner)].T
    windows = len(nodes.label) + np.arange(len(side))
    label = np.array([ONTOLOGY.label_of(name) for name in known.names])[nodes.label]
    return sg.make_graph(
        np.concatenate([label, np.full(len(side), ONTOLOGY.label_of("window"))]),
        np.concatenate([nodes.position, nodes.position[side] + [0, 0, HEIGHT]]),
        np.concatenate([nodes.normal, np.zeros((len(side), 3))]),
        np.concatenate([nodes.width, nodes.width[side] / 2]),
        part_of=np.concatenate([pairs, np.stack([windows, of_room], axis=1)]),
        ontology=ONTOLOGY,
        kind=np.concatenate([nodes.kind, np.zeros(len(side))]),
    )


def main(path: str = "windows.npz", num_graphs: int = 600) -> None:
    """Writes furnished floors with windows."""
    floors = sg.make_dataset("o-f", num_graphs)
    sg.write_graphs(path, [with_windows(floor) for floor in floors], "npz")


if __name__ == "__main__":
    main()
