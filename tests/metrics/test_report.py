import json

import numpy as np
import pytest

from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.report import score
from sg3d_jax.scene.concepts import FLOOR, PLANE, ROOM
from sg3d_jax.scene.graph import make_graph


def room_of_three_planes(floor: bool):
    label = [PLANE] * 3 + [ROOM] + [FLOOR] * floor
    count = len(label)
    position = np.array([[0.0, 0, 1], [2, 0, 1], [1, 2, 1], [1, 1, 1], [1, 1, 0]])[:count]
    part_of = [(0, 3), (1, 3), (2, 3), (3, 4)][: 3 + floor]
    return make_graph(label, position, np.zeros((count, 3)), np.zeros(count), part_of)


def test_report__sums_up_the_pairs_and_survives_json():
    truth = [room_of_three_planes(floor=True)] * 4
    generated = [room_of_three_planes(floor=False), *truth[1:]]
    report = score(generated, truth)
    assert json.loads(json.dumps(report)) == report
    assert report["graphs"] == 4
    assert report["exact_structure"] == 0.75
    assert report["node_count_error"]["signed"]["total"] == -0.25
    assert report["node_count_error"]["absolute"]["floor"] == 0.25
    assert report["node_count_error"]["absolute"]["room"] == 0
    assert report["failures"] == {
        "missing floor": {"count": 1, "share": 0.25},
        "room without floor": {"count": 1, "share": 0.25},
    }
    expected = fgw_pairs(generated, truth)
    np.testing.assert_allclose(report["fgw_per_graph"], expected.value)
    assert report["fgw"] == pytest.approx(expected.value[0] / 4)
    assert report["fgw"] == pytest.approx((report["gw"] + report["w"]) / 2)
