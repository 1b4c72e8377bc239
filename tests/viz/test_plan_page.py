import numpy as np
import plotly.graph_objects as go
import pytest

from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import ROOM
from sg3d_jax.viz.outline import PALETTE, plan_of
from sg3d_jax.viz.plan_page import plan_of_page
from sg3d_jax.viz.style import faded
from tests.two_rooms import two_rooms
from tests.viz.small_city import FLOORS, small_city
from tests.viz.test_plan import without_wholes

ROOMS = (9, 10)  # of `two_rooms`


def points_of(trace):
    return np.array([trace["x"], trace["y"]], float).T


def planned(graph, **said):
    return plan_of_page(graph, "", range(len(graph.nodes.label)), **said)["data"]


def areas_of(data):
    return [trace for trace in data if trace.get("fill") == "toself"]


def test_areas_are_filled_each_in_its_colour_and_have_their_names_inside():
    areas = areas_of(planned(two_rooms()))
    assert {trace["fillcolor"] for trace in areas} <= {*PALETTE}
    assert len(areas) == 2
    names = next(trace for trace in planned(two_rooms()) if trace["mode"] == "text")
    assert names["text"] == ["9", "10"]
    assert names["customdata"] == [*ROOMS]
    drawn = {tuple(points_of(trace)[:-1].mean(axis=0).round(1)) for trace in areas}
    assert len(drawn) == 2


def test_every_point_that_can_be_hovered_over_knows_its_node():
    graph = two_rooms()
    named = [trace for trace in planned(graph) if trace["hoverinfo"] == "text"]
    assert all(len(trace["customdata"]) == len(trace["x"]) for trace in named)
    rows = {row for trace in named for row in trace["customdata"]}
    assert rows == {*range(11)}  # all but the floor
    planes = next(trace for trace in named if trace["customdata"][:4] == [0] * 4)
    start, middle, end, gap = points_of(planes)[:4]
    np.testing.assert_allclose(middle, (start + end) / 2, atol=2e-3)
    assert np.linalg.norm(end - start) == pytest.approx(graph.nodes.width[0], abs=2e-3)
    assert np.isnan(gap).all()


def test_storeys_lie_apart():
    graph = small_city()
    named = [
        trace for trace in planned(graph) if "customdata" in trace and trace["mode"] == "lines"
    ]
    points = np.concatenate([points_of(trace) for trace in named])
    rows = np.concatenate([trace["customdata"] for trace in named])
    boxes = [
        (np.nanmin(seen, axis=0), np.nanmax(seen, axis=0))
        for floor in FLOORS
        for seen in [points[(rows >= floor - 5) & (rows < floor)]]
    ]
    for index, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:index]:
            assert (low > other_high).any() or (other_low > high).any()


def test_a_storey_is_named_below_its_building_and_above_what_it_shows():
    data = planned(small_city())
    captions = next(trace for trace in reversed(data) if trace["mode"] == "text")
    assert captions["text"][0].split("<br>")[1] == f"floor {FLOORS[0]}"
    assert all(len(text.split("<br>")) == 2 for text in captions["text"])
    high = max(np.nanmax(points_of(trace)[:, 1]) for trace in areas_of(data))
    (low, _) = plan_of_page(small_city(), "", range(27))["layout"]["yaxis"]["range"]
    cell = -low / len({*captions["y"]})
    assert max(captions["y"]) - high > 0.15 * cell  # for two lines


def test_what_differs_from_the_truth_is_hatched_and_what_is_lacking_dashed():
    truth = two_rooms()
    same, other = planned(truth, truth=truth), planned(without_wholes(truth, 7), truth=truth)
    assert ["fillpattern" in trace for trace in areas_of(same)] == [False, False]
    assert sorted("fillpattern" in trace for trace in areas_of(other)) == [False, True]
    dashed = [
        next(trace for trace in data if trace.get("line", {}).get("dash") == "dash")
        for data in (same, other)
    ]
    assert [len(trace["x"]) for trace in dashed] == [0, 6]  # four corners, the first again, a gap


def test_what_is_unsure_is_faint():
    sure = np.ones(12)
    sure[ROOMS[0]], sure[8] = 0.32, 0.5  # a room, the wall
    data = planned(two_rooms(), node_confidence=sure)
    shades = {shade for colour in PALETTE for shade in faded(colour, np.array([0.3]))}
    assert len({trace["fillcolor"] for trace in areas_of(data)} & shades) == 1
    plain = planned(two_rooms())
    walls = [next(t for t in kind if t.get("customdata", [])[:1] == [8]) for kind in (plain, data)]
    (faint,) = faded(walls[0]["line"]["color"], np.array([0.5]))
    assert walls[1]["line"]["color"] == faint


def test_without_segments_there_is_no_plan():
    assert plan_of_page(make_graph([ROOM], [[0, 0, 0]]), "", [0]) is None


def test_plotly_knows_every_property():
    truth = two_rooms()
    plan = plan_of_page(without_wholes(truth, 7), "a", range(12), np.full(12, 0.5), truth)
    assert len(go.Figure(plan["data"], plan["layout"]).data) == len(plan["data"])
    assert len(plan_of(truth).areas) == 2
