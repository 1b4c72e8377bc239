"""What `docs/schema` tells readers in other languages of our JSON is so."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from sg3d_jax.io.json import graph_to_dict
from tests.own_world import own_world
from tests.two_rooms import two_rooms

SCHEMA = json.loads(
    (Path(__file__).parents[2] / "docs" / "schema" / "graph.schema.json").read_text()
)
TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "number": (int, float),
    "integer": int,
    "boolean": bool,
    "null": type(None),
}


def faults(value, schema, where="graph"):
    """Returns where a value is not as a schema says; of the words of JSON Schema, those we use."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix("#/$defs/")
        return faults(value, SCHEMA["$defs"][name], where)
    if "oneOf" in schema:
        fits = [not faults(value, option) for option in schema["oneOf"]]
        return [] if sum(fits) == 1 else [f"{where}: fits {sum(fits)} options"]
    names = schema.get("type", [*TYPES])
    kinds = [TYPES[name] for name in ([names] if isinstance(names, str) else names)]
    if not any(isinstance(value, kind) and (kind is bool or value is not True) for kind in kinds):
        return [f"{where}: is no {names}"]
    if isinstance(value, dict):
        found = [f"{where}: lacks {key}" for key in schema.get("required", ()) if key not in value]
        known = schema.get("properties", {})
        for key in known.keys() & value.keys():
            found += faults(value[key], known[key], f"{where}.{key}")
        return found
    if isinstance(value, list):
        odd = not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", np.inf)
        found = [f"{where}: {len(value)} items"] * odd
        for index, item in enumerate(value):
            found += faults(item, schema.get("items", {}), f"{where}[{index}]")
        return found
    if isinstance(value, str):
        fits = re.search(schema.get("pattern", ""), value)
        return [] if fits else [f"{where}: {value!r} does not match"]
    if isinstance(value, (int, float)):
        odd = not schema.get("minimum", -np.inf) <= value <= schema.get("maximum", np.inf)
        return [f"{where}: {value} is out of range"] * odd
    return []


def document():
    graph = two_rooms()
    count = len(graph_to_dict(graph)["edges"])
    held = [
        {"id": f"n{row}", "name": "hall", "seen": [None]} for row in range(len(graph.nodes.label))
    ]
    return graph_to_dict(graph, held, np.linspace(0, 1, count), halt_reason="HALTED")


@pytest.mark.parametrize("made", [document, lambda: graph_to_dict(own_world())], ids=["all", "own"])
def test_what_we_write_is_as_the_schema_says(made):
    assert faults(json.loads(json.dumps(made())), SCHEMA) == []


@pytest.mark.parametrize(
    ("path", "value", "fault"),
    [
        (("nodes", 0, "position"), [1, 2], "graph.nodes[0].position: 2 items"),
        (("nodes", 0, "normal"), "x", "graph.nodes[0].normal: fits 0 options"),
        (("nodes", 0, "width"), -1, "graph.nodes[0].width: -1 is out of range"),
        (("nodes", 0, "id"), 1.5, "graph.nodes[0].id: is no ['integer', 'string']"),
        (("edges", 0), [1], "graph.edges[0]: 1 items"),
        (("edge_confidence", 0), 2, "graph.edge_confidence[0]: 2 is out of range"),
        (("nodes",), [], "graph.nodes: 0 items"),
    ],
)
def test_what_no_graph_is_does_not_fit(path, value, fault):
    made = document()
    holder = made
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    assert fault in faults(made, SCHEMA)


def test_every_key_of_ours_is_described():
    made = document() | graph_to_dict(own_world())
    described = SCHEMA["properties"]
    assert made.keys() - described.keys() <= {"halt_reason"}
    keys = {key for node in graph_to_dict(two_rooms())["nodes"] for key in node}
    assert keys <= SCHEMA["$defs"]["node"]["properties"].keys()
