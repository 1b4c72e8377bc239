"""A made-up ontology in pictures and pages."""

import dataclasses
import json

import numpy as np
import numpy.testing as npt
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.image import imread

from sg3d_jax.data import registry
from sg3d_jax.scene.graph import SceneGraph, make_graph, subgraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Concept, Ontology, Rule
from sg3d_jax.viz import plan
from sg3d_jax.viz.figure import contact_sheet, draw_graph, save_picture
from sg3d_jax.viz.hover import hover_text
from sg3d_jax.viz.page import save_page
from sg3d_jax.viz.space import graph_traces
from sg3d_jax.viz.style import (
    AZIMUTH,
    floor_concept,
    floor_of,
    lifted,
    plane_segments,
    styles_of,
    view_of,
)
from tests.own_world import FLAT, FLOOR, NUM_PLANES, ONTOLOGY, PILLAR, PLANE, WALL, own_world
from tests.viz.test_page import embedded


def layer(traces, uid):
    (found,) = (trace for trace in traces if trace["uid"] == uid)
    return found


def test_what_is_observed_stays_down_and_the_others_are_lifted_one_by_one():
    styles = styles_of(ONTOLOGY)
    assert [style.lift for style in styles] == [0, 0, 1, 2, 3, 4]
    assert [style.size for style in styles] == [4, 4, 5, 7, 9, 11]
    assert [style.colour for style in styles] == [c.colour for c in ONTOLOGY.concepts]


def test_the_sizes_of_the_paper_s_concepts_grow_up_to_twelve():
    assert [style.size for style in styles_of(PAPER_ONTOLOGY)] == [4, 5, 7, 9, 11, 12]


def test_planes_are_segments_and_pillars_dots_alone():
    graph = own_world()
    assert len(plane_segments(graph)) == NUM_PLANES
    assert len(plane_segments(graph, PILLAR)) == 0
    axes = draw_graph(graph)
    _, planes = (item for item in axes.collections if isinstance(item, LineCollection))
    assert len(planes.get_segments()) == NUM_PLANES
    dots = [item for item in axes.collections if isinstance(item, PathCollection)]
    drawn = {tuple(item.get_facecolor()[0]): len(item.get_offsets()) for item in dots}
    counts = np.bincount(graph.nodes.label).tolist()
    expected = zip(ONTOLOGY.concepts, counts, strict=True)
    assert drawn == {to_rgba(concept.colour): count for concept, count in expected}


def test_two_kinds_of_planes_are_drawn_each_in_its_colour():
    plane, pillar, *others = ONTOLOGY.concepts
    door = dataclasses.replace(pillar, name="door", features=("normal", "width"))
    ontology = Ontology((plane, door, *others), ONTOLOGY.rules[:2] + ONTOLOGY.rules[3:])
    nodes = subgraph(own_world(), np.arange(14), edges=False).nodes
    normal, width = nodes.normal.copy(), nodes.width.copy()
    normal[12:], width[12:] = [1, 0, 0], 0.9
    graph = make_graph(nodes.label, nodes.position, normal, width, ontology=ontology)
    lines = [item for item in draw_graph(graph).collections if isinstance(item, LineCollection)]
    assert [len(item.get_segments()) for item in lines] == [0, 12, 2]  # part-of edges first
    assert tuple(lines[2].get_color()[0]) == to_rgba(door.colour)
    traces = graph_traces(graph)
    assert layer(traces, "strips")["color"] == plane.colour
    assert layer(traces, "door strips")["color"] == door.colour
    assert layer(traces, "door lines")["legendgroup"] == "door"
    assert len(layer(traces, "door strips")["x"]) == 8


def test_a_picture_holds_the_colours_of_its_ontology(tmp_path):
    save_picture(own_world(), tmp_path / "a.png")
    pixels = imread(tmp_path / "a.png")[..., :3]
    for concept in (PLANE, PILLAR, WALL, FLAT, FLOOR):
        colour = to_rgba(ONTOLOGY.concepts[concept].colour)[:3]
        assert (np.abs(pixels - colour).max(axis=-1) < 0.02).sum() > 20


def test_a_plan_has_pillars_as_dots_and_a_legend_that_fits(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(plan, "save_figure", lambda figure, path: figures.append(figure))
    graph = own_world()
    plan.save_plan(graph, tmp_path / "plan.png", None, np.ones(len(graph.nodes.label)), graph)
    (figure,) = figures
    dots = [item for item in figure.axes[0].collections if isinstance(item, PathCollection)]
    (pillars,) = (item for item in dots if len(item.get_offsets()))
    npt.assert_allclose(
        pillars.get_offsets(), graph.nodes.position[graph.nodes.label == PILLAR, :2]
    )
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert "pillar" in [text.get_text() for text in legend.get_texts()]
    box = legend.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width


def test_one_legend_names_the_concepts_of_all_ontologies(tmp_path, monkeypatch):
    legends = []
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig",
        lambda figure, path, **_: (legends.extend(figure.legends), path.touch()),
    )
    contact_sheet([("", [own_world(), registry.make("s-f", 1)[0]])], tmp_path / "a.png")
    names = [text.get_text() for text in legends[0].get_texts()]
    assert names == ["plane", "pillar", "wall", "room", "flat", "floor"]


def test_the_floor_is_the_uppermost_that_is_amid_its_parts():
    assert floor_concept(ONTOLOGY) == FLOOR
    assert floor_concept(PAPER_ONTOLOGY) == 3
    assert floor_of(own_world()).tolist() == [20] * 21
    assert view_of(own_world()) == AZIMUTH


TOWER = Ontology(
    concepts=(
        Concept("post", "#111111", "p", "POSTS", observed=True),
        Concept("frame", "#222222", "f", "FRAMES"),
        Concept("deck", "#333333", "d", "DECKS"),
        Concept("tower", "#444444", "t", "TOWERS", above=True),
        Concept("site", "#555555", "s", "SITES", above=True),
    ),
    rules=(
        Rule("post", "frame", single=False),
        Rule("post", "deck"),
        Rule("deck", "tower"),
        Rule("tower", "site"),
    ),
)


def towers() -> SceneGraph:
    """Returns two towers of two decks, each of two posts and a frame; 8 posts first."""
    position = np.zeros((19, 3))
    position[:8, 0] = [0, 10, 0, 10, 40, 50, 40, 50]
    position[[2, 3, 6, 7, 11, 13, 15], 2] = 3  # the second frame hangs down to the deck below
    position[8:16, 0] = [5, 5, 45, 45] * 2
    position[16:, 0], position[16:, 2] = [5, 45, 25], [6, 6, 10]
    label = [0] * 8 + [1] * 4 + [2] * 4 + [3] * 2 + [4]
    deck = [(post, 12 + post // 2) for post in range(8)]
    frame = [(post, 8 + post // 2) for post in range(8)]
    above = [(12, 16), (13, 16), (14, 17), (15, 17), (16, 18), (17, 18)]
    return make_graph(label, position, part_of=deck + frame + above, ontology=TOWER)


def test_storeys_of_any_ontology_are_pulled_apart():
    graph = towers()
    decks = [12, 12, 13, 13, 14, 14, 15, 15, 12, 13, 14, 15, 12, 13, 14, 15, -1, -1, -1]
    assert floor_of(graph).tolist() == decks
    raised = lifted(graph)[:, 2] - graph.nodes.position[:, 2]
    raised -= np.array([style.lift for style in styles_of(TOWER)])[graph.nodes.label]
    storey = [0, 0, 1, 1, 0, 0, 1, 1, 0, 1, 0, 1, 0, 1, 0, 1, 1, 1, 1]
    npt.assert_allclose(raised, 5 * np.array(storey))  # half of a deck of 10 m


def test_towers_are_seen_side_by_side():
    turned = towers()
    turned.nodes.position[:, :2] = turned.nodes.position[:, 1::-1]  # behind one another
    assert view_of(towers()) != view_of(turned)


def test_without_anything_amid_its_parts_there_is_no_floor():
    heap = Ontology(
        (
            Concept("stone", "#111111", "s", "STONES", observed=True),
            Concept("heap", "#222222", "h", "HEAPS", above=True),
        ),
        (Rule("stone", "heap"),),
    )
    graph = make_graph([0, 0, 1], np.eye(3), part_of=[(0, 2), (1, 2)], ontology=heap)
    assert floor_of(graph).tolist() == [-1, -1, -1]
    npt.assert_array_equal(lifted(graph)[:, 2], [0, 0, 2])
    assert view_of(graph) == AZIMUTH


def test_a_page_has_a_layer_for_every_concept(tmp_path):
    save_page([own_world()], tmp_path / "a.html")
    (graph,) = embedded(tmp_path / "a.html")["graphs"]
    assert graph["counts"] == "plane 12 · pillar 2 · wall 1 · room 3 · flat 2 · floor 1"
    pillars = layer(graph["data"], "pillar")
    assert pillars["customdata"] == [12, 13]
    assert pillars["marker"]["color"] == "#7c3aed"
    assert len(layer(graph["data"], "strips")["x"]) == 4 * NUM_PLANES


def test_a_page_says_what_a_node_has_and_belongs_to():
    texts = hover_text(own_world())
    assert texts[0].split("<br>") == [
        "<b>plane 0</b>",
        "centroid (0.00, 1.50, 1.20) m",
        "width 3.00 m",
        "normal (1.00, 0.00, 0.00)",
        "part of room 15",
    ]
    assert texts[12] == "<b>pillar 12</b><br>centroid (2.50, 1.00, 1.20) m<br>part of room 15"
    assert texts[18].endswith("part of floor 20<br>2 children: room 15, room 16")


def test_a_page_of_two_ontologies_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.html: graphs have different ontologies, exp"):
        save_page([own_world(), registry.make("s-f", 1)[0]], tmp_path / "a.html")
    assert not list(tmp_path.iterdir())


def test_names_of_concepts_are_text_not_markup():
    hostile = dataclasses.replace(ONTOLOGY.concepts[FLOOR], name='<a href="x">floor</a>')
    concepts = (*ONTOLOGY.concepts[:FLOOR], hostile)
    ontology = Ontology(concepts, ONTOLOGY.rules[:4])
    graph = make_graph([0, FLOOR], np.eye(3)[:2], np.eye(3)[:2], [1, 0], ontology=ontology)
    assert "<a" not in "".join(hover_text(graph))
    assert "<a" not in json.dumps(graph_traces(graph))
