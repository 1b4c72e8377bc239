import html
import json
import os
import re
import shutil
import signal
import subprocess
import threading

import numpy as np
import numpy.testing as npt
import plotly.graph_objects as go
import pytest

from sg3d_jax.scene.graph import make_graph, subgraph
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PLANE, ROOM
from sg3d_jax.viz.hover import hover_text
from sg3d_jax.viz.page import save_page
from sg3d_jax.viz.space import graph_traces
from sg3d_jax.viz.style import EDGE_COLOUR, faded, lifted, styles_of
from tests.viz.small_city import FLOORS, TOP, one_room, small_city

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE = 40  # seconds until a browser is given up
BROWSER_FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",  # WebGL in software
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-sync",
    "--enable-logging=stderr",
    "--no-first-run",
    "--window-size=900,700",
]
# Watches the page for errors and refused loads.
WATCH = """<script>
const problems = [];
addEventListener("error", event => problems.push(event.message));
addEventListener("unhandledrejection", event => problems.push(String(event.reason)));
addEventListener("securitypolicyviolation", event => problems.push(event.blockedURI));
</script>"""
# Uses the page as a person does, then reports what was seen on the console.
USE = """<script>
const wait = ms => new Promise(done => setTimeout(done, ms));
const plot = document.getElementById("space");
const layers = () => Object.fromEntries(plot._fullData.map(layer => [layer.uid, layer.visible]));
async function until(ready) { for (let i = 0; i < 400 && !ready(); i++) await wait(50); }
async function click(name) {
  const item = [...document.querySelectorAll(".legend .traces")].find(
    layer => layer.textContent === name).querySelector(".legendtoggle");
  for (const kind of ["mousedown", "mouseup"]) item.dispatchEvent(new MouseEvent(kind));
  const before = layers()[name];
  await until(() => layers()[name] !== before);
}
function middleOf(uid, index) {  // where a node is on the screen
  const scene = plot._fullLayout.scene._scene;
  const {model, view, projection} = scene.glplot.cameraParams;
  const trace = plot._fullData.find(layer => layer.uid === uid), scale = scene.dataScale;
  let point = [...["x", "y", "z"].map((axis, i) => trace[axis][index] * scale[i]), 1];
  const rows = [0, 1, 2, 3];
  for (const m of [model, view, projection])
    point = rows.map(i => rows.reduce((sum, j) => sum + m[4 * j + i] * point[j], 0));
  const box = scene.container.getBoundingClientRect();
  return {clientX: box.x + (1 + point[0] / point[3]) / 2 * box.width,
          clientY: box.y + (1 - point[1] / point[3]) / 2 * box.height};
}
async function hover(uid, index) {
  const place = middleOf(uid, index), shown = () => document.querySelector(".hovertext");
  const target = document.elementFromPoint(place.clientX, place.clientY);
  for (let i = 0; i < 200 && !shown(); i++) {
    target.dispatchEvent(new MouseEvent("mousemove", {...place, bubbles: true}));
    await wait(50);
  }
  return shown()?.textContent;
}
(async () => {
  const report = {webgl: !!document.createElement("canvas").getContext("webgl")};
  try {
    await until(() => plot._fullLayout?.scene?._scene?.glplot);
    await wait(300);
    report.first = layers();
    report.hover = await hover("city", 0);
    await click("plane");
    await click("room");
    report.clicked = layers();
    choice.value = 1;
    choice.dispatchEvent(new Event("change"));
    await wait(300);
    report.second = layers();
    report.buttons = [...document.querySelectorAll(".modebar-btn")].map(b => b.dataset.title);
  } catch (error) { problems.push(String(error)); }
  report.problems = problems;
  console.info("REPORT" + JSON.stringify(report) + "TROPER");
})();
</script>"""


def embedded(path):
    """Returns what a page holds as JSON: what it is told at once, and each graph for later."""
    kinds = ('id="page"', 'class="graph"')
    (page, *_), graphs = (
        [
            json.loads(text)
            for text in re.findall(f'<script {kind} type="application/json">(.*?)</script>', markup)
        ]
        for markup in [path.read_text()]
        for kind in kinds
    )
    return {**page, "graphs": graphs}


def own_markup(path):
    """Returns a page without plotly's program, which is all that we did not write."""
    return re.sub(r"<script>(?!\s*const page).*?</script>", "", path.read_text(), flags=re.DOTALL)


def layer(traces, uid):
    (found,) = (trace for trace in traces if trace["uid"] == uid)
    return found


def points_of(trace):
    return np.array([trace[axis] for axis in "xyz"], float).T


def seen_by_a_browser(path):
    """Returns the report of USE on a page; skips where no browser with WebGL can be run."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("there is no Chromium to try the page in")
    text = (
        path.read_text().replace("<style>", WATCH + "<style>").replace("</body>", USE + "</body>")
    )
    tried, profile = path.with_name("tried.html"), path.with_name("profile")
    tried.write_text(text)
    command = [browser, *BROWSER_FLAGS, f"--user-data-dir={profile}", tried.as_uri()]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        deadline = threading.Timer(PATIENCE, os.killpg, [process.pid, signal.SIGKILL])
        deadline.start()
        found = next(filter(None, map(re.compile("REPORT(.*)TROPER").search, process.stderr)), None)
        deadline.cancel()
        os.killpg(process.pid, signal.SIGTERM)  # its children too
    if found is None:
        pytest.skip(f"{browser} does not run pages here")
    report = json.loads(found[1])
    if not report["webgl"]:
        pytest.skip(f"{browser} has no WebGL here")
    return report


def test_plotly_knows_every_property_of_the_traces_and_of_the_view(tmp_path):
    save_page([one_room(), small_city()], tmp_path / "a.html")
    for graph in embedded(tmp_path / "a.html")["graphs"]:
        for drawn in (graph, *graph["plans"]):
            figure = go.Figure(drawn["data"], drawn["layout"])
            assert len(figure.data) == len(drawn["data"])


@pytest.mark.parametrize("graph", [one_room(), small_city()], ids=["room", "city"])
def test_every_concept_is_a_layer_in_the_colour_and_place_of_the_pictures(graph):
    traces = graph_traces(graph)
    for concept, name in enumerate(PAPER_ONTOLOGY.names):
        dots = layer(traces, name)
        rows = np.flatnonzero(graph.nodes.label == concept)
        assert dots["customdata"] == rows.tolist()
        assert dots["marker"]["color"] == styles_of(PAPER_ONTOLOGY)[concept].colour
        npt.assert_allclose(points_of(dots).reshape(-1, 3), lifted(graph)[rows], atol=1e-3)


def test_edges_are_layers_and_proximity_is_off_at_first():
    traces = graph_traces(one_room())
    part_of, proximity = layer(traces, "part of"), layer(traces, "proximity")
    assert "visible" not in part_of
    assert proximity["visible"] == "legendonly"
    drawn = lifted(one_room())
    npt.assert_allclose(points_of(part_of)[[0, 1]], drawn[[0, 3]], atol=1e-3)
    assert np.isnan(points_of(part_of)[2::3]).all()
    assert len(part_of["x"]) == 3 * 4
    assert len(proximity["x"]) == 3 * 3


def test_planes_are_upright_strips_as_wide_as_they_are_with_a_tick_along_the_normal():
    graph = one_room()
    traces = graph_traces(graph)
    strips = layer(traces, "strips")
    corners = points_of(strips).reshape(3, 4, 3)
    npt.assert_allclose(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=-1), [6, 4, 5])
    npt.assert_allclose(corners[:, 2] - corners[:, 0], [[0, 0, 0.5]] * 3, atol=1e-9)
    npt.assert_allclose(corners.mean(axis=1), graph.nodes.position[:3])
    triangles = np.array([strips[name] for name in "ijk"]).T
    assert sorted(set((triangles // 4).ravel().tolist())) == [0, 1, 2]
    sides = points_of(strips)[triangles]
    area = np.linalg.norm(
        np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=-1
    ).sum()
    npt.assert_allclose(area / 2, 0.5 * (6 + 4 + 5))
    ticks = points_of(layer(traces, "plane lines")).reshape(6, 3, 3)[3:]
    npt.assert_allclose(ticks[:, 1] - ticks[:, 0], 0.3 * graph.nodes.normal[:3], atol=1e-9)
    assert layer(traces, "plane lines")["customdata"][9:] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    groups = {layer(traces, uid)["legendgroup"] for uid in ("strips", "plane lines", "plane")}
    assert groups == {"plane"}  # one click hides all of it


def test_hover_text_holds_label_centroid_width_normal_parents_and_children():
    text = hover_text(one_room())
    assert text[0] == (
        "<b>plane 0</b><br>centroid (0.00, 2.00, 1.00) m<br>width 6.00 m"
        "<br>normal (0.00, -1.00, 0.00)<br>part of room 3"
    )
    assert text[3] == (
        "<b>room 3</b><br>centroid (1.00, 0.00, 1.00) m<br>part of floor 4"
        "<br>3 children: plane 0, plane 1, plane 2"
    )
    assert text[4] == "<b>floor 4</b><br>centroid (1.00, 0.00, 1.00) m<br>1 child: room 3"


def test_nodes_are_called_what_they_are_said_to_be(tmp_path):
    called = ["p<1>", 7, "p3", "hall", "F"]
    save_page([one_room()], tmp_path / "a.html", node_names=[called])
    (graph,) = embedded(tmp_path / "a.html")["graphs"]
    assert graph["text"] == hover_text(one_room(), node_names=called)
    assert graph["text"][0].startswith("<b>plane p&lt;1&gt;</b>")
    assert graph["text"][3].endswith(
        "part of floor F<br>3 children: plane p&lt;1&gt;, plane 7, plane p3"
    )
    (plan,) = graph["plans"]
    assert ["hall"] in [trace.get("text") for trace in plan["data"]]


def test_below_a_plan_is_that_of_the_truth_whose_nodes_have_their_own_text(tmp_path):
    room, nothing = one_room(), make_graph([ROOM], np.zeros((1, 3)))
    save_page([room, nothing], tmp_path / "a.html", truth=[room, nothing])
    first, second = embedded(tmp_path / "a.html")["graphs"]
    assert [plan["title"] for plan in first["plans"]][1:] == ["truth"]
    assert first["plans"][1]["text"] == hover_text(room)
    assert second["plans"] == []


def test_what_the_truth_has_is_called_by_its_names(tmp_path):
    truth = small_city()
    made, names = subgraph(truth, np.arange(TOP)), [f"n{row}" for row in range(TOP + 1)]
    save_page([made], tmp_path / "a.html", truth=[truth], truth_names=[names])
    (page,) = embedded(tmp_path / "a.html")["graphs"]
    assert any(f"n{TOP}" in text for text in page["text"])
    below = page["plans"][1]
    assert below["text"] == hover_text(truth, node_names=names)
    captions = next(trace for trace in below["data"][-2::-1] if "text" in trace)["text"]
    assert captions[0].endswith(f"floor n{FLOORS[0]}")
    with pytest.raises(ValueError, match=r"0 names of truths for 1 graphs"):
        save_page([made], tmp_path / "a.html", truth=[truth], truth_names=[])


def test_what_the_truth_alone_has_is_marked_in_view_and_has_its_text(tmp_path):
    truth = small_city()
    made = subgraph(truth, np.arange(TOP))
    save_page([made, truth], tmp_path / "a.html", truth=[truth, truth])
    first, second = embedded(tmp_path / "a.html")["graphs"]
    circles, same = (
        next(trace for trace in graph["data"] if trace["uid"] == "missing")
        for graph in (first, second)
    )
    assert [first["text"][row] for row in circles["customdata"]] == [hover_text(truth)[TOP]]
    assert first["layout"]["scene"]["zaxis"]["range"][1] > circles["z"][0]
    assert same["customdata"] == []
    assert second["text"] == hover_text(truth)


def test_hover_text_gives_true_heights_and_cuts_long_lists():
    text = hover_text(small_city())
    assert "centroid (4.00, 4.00, 3.00) m" in text[FLOORS[1]]
    label = [PLANE] * 20 + [ROOM]
    plane = np.arange(21)[:, None] < 20
    crowd = make_graph(
        label,
        np.zeros((21, 3)),
        plane * [[1, 0, 0]],
        plane[:, 0] * 1.0,
        [[i, 20] for i in range(20)],
    )
    assert hover_text(crowd)[20].endswith("plane 10, plane 11, 8 more")


NODES, EDGES = np.array([1, 0.5, 0.25, 0.75, np.nan]), np.array([1, 0.5, 0.25, 0])


def test_hover_text_says_how_sure_nodes_and_edges_are():
    text = hover_text(one_room(), NODES, EDGES)
    assert text[1].endswith("<br>confidence 0.50<br>part of room 3 (0.50)")
    assert text[3] == (
        "<b>room 3</b><br>centroid (1.00, 0.00, 1.00) m<br>confidence 0.75"
        "<br>part of floor 4 (0.00)<br>3 children: plane 0 (1.00), plane 1 (0.50), plane 2 (0.25)"
    )
    assert text[4].endswith("m<br>1 child: room 3 (0.00)")  # it does not say
    assert hover_text(one_room(), NODES)[1].endswith("<br>confidence 0.50<br>part of room 3")
    assert hover_text(one_room(), None, EDGES)[1].endswith(")<br>part of room 3 (0.50)")


def test_what_is_unsure_is_faint():
    traces = graph_traces(one_room(), None, NODES, EDGES)
    blue = faded(styles_of(PAPER_ONTOLOGY)[PLANE].colour, NODES[:3])
    assert layer(traces, "plane")["marker"]["color"] == blue
    assert layer(traces, "strips")["vertexcolor"] == np.repeat(blue, 4).tolist()
    lines = np.concatenate([np.repeat(blue, 3)] * 2).tolist()
    assert layer(traces, "plane lines")["line"]["color"] == lines
    grey = faded(EDGE_COLOUR, EDGES)
    assert layer(traces, "part of")["line"]["color"] == np.repeat(grey, 3).tolist()
    (green,) = layer(traces, "floor")["marker"]["color"]
    assert green == styles_of(PAPER_ONTOLOGY)[FLOOR].colour


def test_the_legend_keeps_full_colours_and_says_what_faint_means():
    plain, unsure = graph_traces(one_room()), graph_traces(one_room(), None, NODES, EDGES)
    assert [trace["uid"] for trace in unsure[: len(plain)]] == [trace["uid"] for trace in plain]

    def shown(traces):
        listed = [t for t in traces if t.get("showlegend", True) and t["type"] != "mesh3d"]
        paint = [(t["name"], t["legendgroup"], t["mode"], t.get("legendrank")) for t in listed]
        colours = [t["line" if t["mode"] == "lines" else "marker"]["color"] for t in listed]
        assert len(set(paint)) == len(paint)
        return dict(zip(paint, colours, strict=True))

    assert list(shown(unsure).items() - shown(plain).items()) == [
        (("faint: unsure", "faint: unsure", "lines", 1003), faded(EDGE_COLOUR, np.array([0.5]))[0])
    ]
    assert shown(plain).items() < shown(unsure).items()
    keys = [trace["uid"] for trace in graph_traces(one_room(), None, None, EDGES)[len(plain) :]]
    assert keys == ["part of key", "faint key"]


def test_plotly_knows_what_makes_things_faint(tmp_path):
    # Plotly makes uids selectors of CSS, which a colon ends.
    said = {"node_confidence": [NODES, None], "edge_confidence": [None, EDGES]}
    save_page([one_room()] * 2, tmp_path / "a.html", **said)
    for graph in embedded(tmp_path / "a.html")["graphs"]:
        assert len(go.Figure(graph["data"], graph["layout"]).data) == len(graph["data"])
        uids = [trace["uid"] for trace in graph["data"]]
        assert len(set(uids)) == len(uids)
        assert not any(":" in uid for uid in uids)
        assert "faint key" in uids
    assert "confidence 0.50" in embedded(tmp_path / "a.html")["graphs"][0]["text"][1]


def test_confidence_of_other_nodes_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"node_confidence has shape \[5\], expected \[27\]"):
        save_page([small_city()], tmp_path / "a.html", node_confidence=[NODES])
    with pytest.raises(ValueError, match=r"edge_confidence has shape \[5\], expected \[4\]"):
        save_page([one_room()], tmp_path / "a.html", edge_confidence=[NODES])
    assert not list(tmp_path.iterdir())


def test_a_graph_that_breaks_the_hierarchy_is_shown():
    two_floors = make_graph([FLOOR, FLOOR], np.zeros((2, 3)), np.zeros((2, 3)), [0, 0], [[0, 1]])
    assert hover_text(two_floors)[1].endswith("1 child: floor 0")
    assert len(layer(graph_traces(two_floors), "part of")["x"]) == 3


def test_a_page_is_one_file_that_loads_nothing(tmp_path):
    save_page([small_city()], tmp_path / "a.html")
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]
    markup = own_markup(tmp_path / "a.html")
    assert len(markup) < 40_000
    assert not re.search(r"https?:|//[a-z]|\ssrc=|\shref=|@import|url\(", markup)
    policy = re.search(r'Content-Security-Policy" content="(.*?)"', markup)[1]
    assert policy.startswith("default-src 'none'; form-action 'none';")
    assert "connect-src" not in policy
    assert "Plotly" in (tmp_path / "a.html").read_text()


def test_the_same_graphs_give_the_same_bytes(tmp_path):
    for name in ("a.html", "b.html"):
        save_page([one_room(), small_city()], tmp_path / name, "twice")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_titles_and_names_are_text_not_markup(tmp_path):
    hostile = '</script><b onload="x">{{data}}&'
    save_page([one_room(), one_room()], tmp_path / "a.html", hostile, [hostile, "grown"])
    assert embedded(tmp_path / "a.html")["names"] == [hostile, "grown"]
    markup = own_markup(tmp_path / "a.html")
    assert "<b" not in markup.replace("<body", "")
    assert markup.count(html.escape(hostile)) == 2


def test_graphs_of_a_page_share_their_layers_and_are_numbered(tmp_path):
    save_page([one_room(), small_city()], tmp_path / "a.html")
    first, second = embedded(tmp_path / "a.html")["graphs"]
    assert [t["uid"] for t in first["data"]] == [t["uid"] for t in second["data"]]
    assert "wall" not in [t["uid"] for t in first["data"]]  # no graph of the page has one
    assert embedded(tmp_path / "a.html")["names"] == ["graph 0", "graph 1"]
    assert second["counts"] == "plane 16 · room 4 · floor 4 · building 2 · city 1"


def test_a_metre_is_equally_long_on_every_axis(tmp_path):
    save_page([small_city()], tmp_path / "a.html")
    scene = embedded(tmp_path / "a.html")["graphs"][0]["layout"]["scene"]
    length = [np.ptp(scene[f"{axis}axis"]["range"]) for axis in "xyz"]
    ratio = np.array([scene["aspectratio"][axis] for axis in "xyz"]) / length
    npt.assert_allclose(ratio, ratio[0], rtol=1e-3)


def test_what_cannot_be_shown_or_written_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.html: there are no graphs"):
        save_page([], tmp_path / "a.html")
    with pytest.raises(ValueError, match=r"a\.html: 2 names for 1 graphs"):
        save_page([one_room()], tmp_path / "a.html", names=["a", "b"])
    with pytest.raises(ValueError, match=r"a\.html: 1 truths for 2 graphs"):
        save_page([one_room()] * 2, tmp_path / "a.html", truth=[one_room()])
    with pytest.raises(ValueError, match="which is no folder"):
        save_page([one_room()], tmp_path / "missing" / "a.html")
    assert not list(tmp_path.iterdir())


def test_in_a_browser_layers_toggle_labels_appear_and_nothing_goes_wrong(tmp_path):
    save_page([small_city(), one_room()], tmp_path / "a.html")
    report = seen_by_a_browser(tmp_path / "a.html")
    assert report["problems"] == []
    nodes = ("plane", "room", "floor", "building", "city")
    assert all(report["first"][name] is True for name in (*nodes, "part of"))
    assert report["hover"] == re.sub("<.*?>", "", hover_text(small_city())[26])
    changed = {k for k, v in report["clicked"].items() if v != report["first"][k]}
    assert changed == {"strips", "plane lines", "plane", "room"}
    assert report["clicked"]["room"] == "legendonly"
    assert report["second"]["room"] == "legendonly"
    assert not any("share" in title.lower() for title in report["buttons"])
