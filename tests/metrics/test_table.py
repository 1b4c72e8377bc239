"""Tables hold what results and paper say."""

import math
import re

import pytest

from sg3d_jax.metrics.paper import HEADINGS, PAPER, SCORES, TITLES
from sg3d_jax.metrics.table import render, rows_by_data

RESULT = {
    "method": "fd4",
    "weights": "fd4-s-f",
    "data": "s-f",
    "scores": {name: {"mean": 0.1 * i, "sd": 0.01} for i, name in enumerate(SCORES)},
}
ONE_SEED = RESULT | {
    "method": "some_file.json",
    "weights": None,
    "scores": {"fgw": {"mean": 0.5, "sd": None}},
}


def test_fgw_is_the_mean_of_its_parts_wherever_the_paper_has_it():
    for data, methods in PAPER.items():
        for method, (fgw, gw, w, *_) in methods.items():
            assert fgw == pytest.approx((gw + w) / 2, abs=0.016), (data, method)


def test_recordings_alone_have_no_distribution_scores():
    for data, methods in PAPER.items():
        expected = 3 if data.startswith("r-") else len(SCORES)
        assert {len(values) for values in methods.values()} == {expected}


def test_our_row_of_a_method_is_under_that_of_the_paper_in_its_order():
    ours = [RESULT | {"method": method} for method in reversed(TITLES)]
    rows = rows_by_data([ONE_SEED, *ours])["s-f"]
    assert [row.method for row in rows] == [
        *("Rand (paper)", "Rand", "Rand, sized"),
        *("EC-□ (paper)", "EC-□"),
        *("EC-L (paper)", "EC-L"),
        *("MiDi+Or (paper)", "MiDi+Or"),
        *("FD4 (paper)", "FD4"),
        *("MiDi (paper)", "MiDi"),
        "some_file.json",
    ]
    assert rows[0].cells[0] == "0.69"
    assert rows[1].cells[1] == "0.100 ± 0.010"
    assert rows[-1].cells == ("0.500", *["-"] * 6)


def test_a_consensus_of_several_candidates_is_told():
    rows = [row.method for row in rows_by_data([RESULT | {"candidates": 4}])["s-f"]]
    assert rows[rows.index("FD4 (paper)") + 1] == "FD4, consensus of 4"
    assert rows_by_data([RESULT | {"candidates": 1}]) == rows_by_data([RESULT])


def test_a_result_of_a_part_of_the_scenes_tells_how_many():
    part, whole = RESULT | {"graphs": 60}, RESULT | {"method": "midi", "graphs": 600}
    rows = [row.method for row in rows_by_data([part, whole])["s-f"]]
    assert rows[rows.index("FD4 (paper)") + 1] == "FD4, 60 scenes"
    assert rows[rows.index("MiDi (paper)") + 1] == "MiDi"
    elsewhere = part | {"split": "validation"}
    assert "FD4" in [row.method for row in rows_by_data([elsewhere, whole])["s-f"]]


@pytest.mark.parametrize(
    ("about", "title"),
    [
        ({"graphs": 60, "split_graphs": 600}, "FD4, 60 scenes"),
        ({"graphs": 600, "split_graphs": 600, "command": "sg3d --num-graphs 600"}, "FD4"),
        ({"graphs": 60, "command": "sg3d evaluate fd4-s-f --num-graphs 60"}, "FD4, 60 scenes"),
        ({"graphs": 60, "command": "sg3d evaluate fd4-s-f"}, "FD4"),
    ],
)
def test_a_lone_result_of_a_part_of_the_scenes_tells_so_too(about, title):
    rows = [row.method for row in rows_by_data([RESULT | about])["s-f"]]
    assert rows[rows.index("FD4 (paper)") + 1] == title


def test_several_results_of_a_method_tell_their_weights():
    other = RESULT | {"weights": "runs/new/weights.npz"}
    elsewhere = RESULT | {"data": "r-f"}
    tables = rows_by_data([RESULT, other, elsewhere])
    rows = [row.method for row in tables["s-f"]]
    first = rows.index("FD4 (paper)") + 1
    assert rows[first : first + 2] == ["FD4 (fd4-s-f)", "FD4 (runs/new/weights.npz)"]
    assert "FD4" in [row.method for row in tables["r-f"]]


def test_every_method_of_the_paper_has_a_title():
    assert {method for methods in PAPER.values() for method in methods} < TITLES.keys()


def test_every_data_set_has_a_table_of_its_own():
    tables = rows_by_data([RESULT, RESULT | {"data": "p-f"}, RESULT | {"data": "r-b"}])
    assert list(tables) == ["s-f", "p-f", "r-b"]
    assert len(tables["p-f"]) == 1
    assert tables["r-b"][0].cells == ("0.81", "0.70", "0.92", "-", "-", "-", "-")


def test_markdown_has_as_many_cells_in_every_line():
    lines = render([RESULT, ONE_SEED]).strip().split("\n")
    assert {line.count("|") for line in lines} == {len(HEADINGS) + 2}


def test_latex_has_as_many_cells_in_every_line_and_escapes():
    text = render([RESULT, ONE_SEED], "latex")
    lines = [line for line in text.split("\n") if line.endswith(r"\\")]
    assert {len(re.findall(r"(?<!\\)&", line)) for line in lines} == {len(HEADINGS)}
    assert r"some\_file.json" in text
    assert r"EC-$\square$" in text
    assert "±" not in text


@pytest.mark.parametrize("field", ["method", "data", "scores"])
def test_a_result_without_a_field_is_refused(field):
    broken = {key: value for key, value in RESULT.items() if key != field}
    with pytest.raises(ValueError, match=f"result 1 lacks '{field}'"):
        render([RESULT, broken])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"method": ["fd4"]}, r"method is \['fd4'\], expected a name of one line"),
        ({"method": "a|b"}, "method is 'a|b', expected a name of one line"),
        ({"data": {}}, "data is {}, expected a name of one line"),
        ({"weights": 3}, "weights is 3, expected a name of one line, or null"),
        ({"scores": []}, r"scores is \[\], expected an object"),
        ({"graphs": "many"}, "graphs is 'many', expected a number from 1"),
        ({"candidates": 1.5}, "candidates is 1.5, expected a number from 1"),
        ({"scores": {"fgw": 3}}, "scores.'fgw' has the mean None, expected a finite number"),
        ({"scores": {"fgw": {"mean": math.nan}}}, "scores.'fgw' has the mean nan, expected a fin"),
        ({"scores": {"fgw": {"mean": True}}}, "scores.'fgw' has the mean True, expected a finite"),
        ({"scores": {"fgw": {"mean": 10**400}}}, "scores.'fgw' has the mean 10*, expected a fini"),
        ({"scores": {"fgw": {"mean": 1, "sd": "a"}}}, "scores.'fgw' has the sd 'a', expected a n"),
        ({"scores": {"fgw": {"mean": 1, "sd": -1}}}, "scores.'fgw' has the sd -1, expected a num"),
    ],
)
def test_what_no_evaluation_writes_is_refused_by_its_field(change, sentence):
    with pytest.raises(ValueError, match=f"result 0: {sentence}"):
        render([RESULT | change])


def test_an_unknown_format_is_refused():
    with pytest.raises(ValueError, match="the format is 'html', expected one of markdown, latex"):
        render([RESULT], "html")
