"""The scores that the paper reports: means over its seeds, on the test splits of its data sets.

Source: paper, Tables "Evaluation results for synthetic and MSD datasets" and "Evaluation results
for real environments".
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

SCORES: Final = ("fgw", "gw", "w", "degree", "spectrum", "clustering", "gin")
HEADINGS: Final = ("FGW", "GW", "W", "Deg.", "Spec.", "Clust.", "GIN")

# By data set, as `sg3d data` names it, and method, as the paper names it; recordings have no MMDs.
PAPER: Final[Mapping[str, Mapping[str, tuple[float, ...]]]] = MappingProxyType(
    {
        "s-f-square": {
            "Rand": (0.65, 0.50, 0.80, 0.84, 0.55, 1.41, 0.69),
            "EC-□": (0.12, 0.17, 0.08, 0.18, 0.12, 0.00, 0.40),
            "EC-L": (0.08, 0.07, 0.09, 0.26, 0.08, 0.00, 0.20),
            "MiDi+Or": (0.03, 0.00, 0.07, 0.00, 0.01, 0.00, 0.00),
            "Ours-FD4": (0.04, 0.03, 0.05, 0.02, 0.00, 0.04, 0.02),
            "Ours-MiDi": (0.04, 0.03, 0.04, 0.04, 0.05, 0.00, 0.05),
        },
        "s-f": {
            "Rand": (0.69, 0.54, 0.83, 1.04, 0.73, 1.49, 0.74),
            "EC-□": (0.13, 0.17, 0.08, 0.19, 0.12, 0.00, 0.36),
            "EC-L": (0.08, 0.07, 0.09, 0.26, 0.08, 0.00, 0.20),
            "MiDi+Or": (0.03, 0.00, 0.06, 0.00, 0.01, 0.00, 0.00),
            "Ours-FD4": (0.05, 0.04, 0.06, 0.03, 0.00, 0.01, 0.01),
            "Ours-MiDi": (0.04, 0.03, 0.04, 0.01, 0.01, 0.00, 0.01),
        },
        "s-c": {
            "Rand": (0.65, 0.55, 0.75, 1.43, 1.23, 1.60, 0.95),
            "MiDi+Or": (0.05, 0.07, 0.03, 0.18, 0.07, 0.00, 0.06),
            "Ours-FD4": (0.28, 0.25, 0.32, 0.76, 0.40, 0.24, 0.25),
        },
        "m-f": {
            "Rand": (0.75, 0.63, 0.86, 1.50, 1.48, 1.80, 0.95),
            "EC-□": (0.27, 0.27, 0.28, 0.80, 1.16, 0.00, 1.00),
            "EC-L": (0.20, 0.18, 0.23, 0.31, 0.52, 0.00, 0.06),
            "MiDi+Or": (0.02, 0.00, 0.04, 0.08, 0.03, 0.00, 0.02),
            "Ours-FD4": (0.09, 0.08, 0.09, 0.21, 0.00, 0.08, 0.08),
            "Ours-MiDi": (0.07, 0.06, 0.07, 0.04, 0.02, 0.00, 0.02),
        },
        "m-b": {
            "Rand": (0.74, 0.64, 0.85, 1.57, 1.83, 1.57, 1.03),
            "MiDi+Or": (0.04, 0.01, 0.08, 0.18, 0.06, 0.02, 0.06),
            "Ours-FD4": (0.09, 0.09, 0.09, 0.35, 0.07, 0.13, 0.29),
            "Ours-MiDi": (0.05, 0.05, 0.06, 0.06, 0.04, 0.00, 0.08),
        },
        "m-c": {
            "Rand": (0.75, 0.65, 0.85, 1.66, 1.85, 1.73, 1.11),
            "MiDi+Or": (0.28, 0.48, 0.09, 0.89, 0.86, 0.96, 0.30),
            "Ours-FD4": (0.20, 0.25, 0.15, 0.68, 0.29, 0.26, 0.29),
        },
        "r-f": {
            "Rand": (1.05, 0.83, 1.27),
            "EC-□": (0.30, 0.38, 0.23),
            "EC-L": (0.22, 0.27, 0.17),
            "MiDi+Or": (0.32, 0.46, 0.18),
            "Ours-FD4": (0.13, 0.12, 0.14),
            "Ours-MiDi": (0.16, 0.12, 0.20),
        },
        "r-b": {
            "Rand": (0.81, 0.70, 0.92),
            "MiDi+Or": (0.10, 0.03, 0.16),
            "Ours-FD4": (0.16, 0.22, 0.11),
            "Ours-MiDi": (0.34, 0.33, 0.36),
        },
        "r-c": {
            "Rand": (0.92, 0.78, 1.06),
            "MiDi+Or": (0.16, 0.20, 0.12),
            "Ours-FD4": (0.24, 0.28, 0.20),
        },
    }
)
