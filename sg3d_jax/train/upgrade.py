"""Weights of format 2, as commit d42529f and those before it wrote them, in the present format.

Since then equal layers are stacked along a first axis, and a configuration has no `max_added`.
"""

import re
from typing import Any, Final

import numpy as np

FORMAT_2: Final = "sg3d_jax weights 2"

# In which module a layer's number stood behind a name, and what the name is within a layer now.
# Edge classifiers have numbered layers, too, which are not alike and stay as they are.
_LAYERED: Final = (
    (re.compile(r"(.*/gine)/(norm|hidden|out)_(\d+)/(.*)"), "{1}/{3}"),
    (re.compile(r"(.*/topology/params)/(layer)_(\d+)/(.*)"), "{3}"),
    (re.compile(r"(.*/denoiser/params)/(layer)_(\d+)/(.*)"), "rectangle/{3}"),
    (re.compile(r"(.*/denoiser/params)/(geometry|back|position)_(\d+)/(.*)"), "{1}/{3}"),
    (
        re.compile(r"(.*/distance/params)/(norm|message|block_norm|block|mix|pairs)_(\d+)/(.*)"),
        "{1}/{3}",
    ),
)


def upgraded(
    arrays: dict[str, np.ndarray], config: dict[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Returns the arrays and the configuration of a weights file of format 2 as of the present one.

    Args:
      arrays: by path, as the file holds them.
      config: the parsed configuration.
    """
    kept: dict[str, np.ndarray] = {}
    layers: dict[str, dict[int, np.ndarray]] = {}
    for path, array in arrays.items():
        place = _place(path)
        if place is None:
            kept[path] = array
        else:
            layers.setdefault(place[0], {})[place[1]] = array
    stacked = {
        path: np.stack([of_path[number] for number in range(len(of_path))])
        for path, of_path in layers.items()
    }
    flagg = config.get("flagg")
    if flagg is not None:
        corruption = {k: v for k, v in flagg["corruption"].items() if k != "max_added"}
        config = {**config, "flagg": {**flagg, "corruption": corruption}}
    return kept | stacked, config


def _place(path: str) -> tuple[str, int] | None:
    """Returns the path of the stack that an array belongs to, and its layer; None for others."""
    for pattern, inside in _LAYERED:
        if match := pattern.fullmatch(path):
            module, number = match[1], int(match[3])
            return f"{module}/layers/{inside.format(*match.groups())}", number
    return None
