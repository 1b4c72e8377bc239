"""The scores that the paper reports: means over its seeds, on the test splits of its data sets.

Source: paper, Tables "Evaluation results for synthetic and MSD datasets" and "Evaluation results
for real environments".
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

SCORES: Final = ("fgw", "gw", "w", "degree", "spectrum", "clustering", "gin")
HEADINGS: Final = ("FGW", "GW", "W", "Deg.", "Spec.", "Clust.", "GIN")

# Methods by name, in the paper's order; the paper has one Rand.
TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "rand": "Rand",
        "rand-sized": "Rand, sized",
        "ec-square": "EC-□",
        "ec-l": "EC-L",
        "midi-or": "MiDi+Or",
        "fd4": "FD4",
        "midi": "MiDi",
    }
)

# By data set and method; recordings have no MMDs.
PAPER: Final[Mapping[str, Mapping[str, tuple[float, ...]]]] = MappingProxyType(
    {
        "s-f-square": {
            "rand": (0.65, 0.50, 0.80, 0.84, 0.55, 1.41, 0.69),
            "ec-square": (0.12, 0.17, 0.08, 0.18, 0.12, 0.00, 0.40),
            "ec-l": (0.08, 0.07, 0.09, 0.26, 0.08, 0.00, 0.20),
            "midi-or": (0.03, 0.00, 0.07, 0.00, 0.01, 0.00, 0.00),
            "fd4": (0.04, 0.03, 0.05, 0.02, 0.00, 0.04, 0.02),
            "midi": (0.04, 0.03, 0.04, 0.04, 0.05, 0.00, 0.05),
        },
        "s-f": {
            "rand": (0.69, 0.54, 0.83, 1.04, 0.73, 1.49, 0.74),
            "ec-square": (0.13, 0.17, 0.08, 0.19, 0.12, 0.00, 0.36),
            "ec-l": (0.08, 0.07, 0.09, 0.26, 0.08, 0.00, 0.20),
            "midi-or": (0.03, 0.00, 0.06, 0.00, 0.01, 0.00, 0.00),
            "fd4": (0.05, 0.04, 0.06, 0.03, 0.00, 0.01, 0.01),
            "midi": (0.04, 0.03, 0.04, 0.01, 0.01, 0.00, 0.01),
        },
        "s-c": {
            "rand": (0.65, 0.55, 0.75, 1.43, 1.23, 1.60, 0.95),
            "midi-or": (0.05, 0.07, 0.03, 0.18, 0.07, 0.00, 0.06),
            "fd4": (0.28, 0.25, 0.32, 0.76, 0.40, 0.24, 0.25),
        },
        "m-f": {
            "rand": (0.75, 0.63, 0.86, 1.50, 1.48, 1.80, 0.95),
            "ec-square": (0.27, 0.27, 0.28, 0.80, 1.16, 0.00, 1.00),
            "ec-l": (0.20, 0.18, 0.23, 0.31, 0.52, 0.00, 0.06),
            "midi-or": (0.02, 0.00, 0.04, 0.08, 0.03, 0.00, 0.02),
            "fd4": (0.09, 0.08, 0.09, 0.21, 0.00, 0.08, 0.08),
            "midi": (0.07, 0.06, 0.07, 0.04, 0.02, 0.00, 0.02),
        },
        "m-b": {
            "rand": (0.74, 0.64, 0.85, 1.57, 1.83, 1.57, 1.03),
            "midi-or": (0.04, 0.01, 0.08, 0.18, 0.06, 0.02, 0.06),
            "fd4": (0.09, 0.09, 0.09, 0.35, 0.07, 0.13, 0.29),
            "midi": (0.05, 0.05, 0.06, 0.06, 0.04, 0.00, 0.08),
        },
        "m-c": {
            "rand": (0.75, 0.65, 0.85, 1.66, 1.85, 1.73, 1.11),
            "midi-or": (0.28, 0.48, 0.09, 0.89, 0.86, 0.96, 0.30),
            "fd4": (0.20, 0.25, 0.15, 0.68, 0.29, 0.26, 0.29),
        },
        "r-f": {
            "rand": (1.05, 0.83, 1.27),
            "ec-square": (0.30, 0.38, 0.23),
            "ec-l": (0.22, 0.27, 0.17),
            "midi-or": (0.32, 0.46, 0.18),
            "fd4": (0.13, 0.12, 0.14),
            "midi": (0.16, 0.12, 0.20),
        },
        "r-b": {
            "rand": (0.81, 0.70, 0.92),
            "midi-or": (0.10, 0.03, 0.16),
            "fd4": (0.16, 0.22, 0.11),
            "midi": (0.34, 0.33, 0.36),
        },
        "r-c": {
            "rand": (0.92, 0.78, 1.06),
            "midi-or": (0.16, 0.20, 0.12),
            "fd4": (0.24, 0.28, 0.20),
        },
    }
)
