"""How far apart colours are for eyes of every kind: distances in CIE Lab, of which 2 is just seen.

Source: Machado, Oliveira and Fernandes, 2009, full severity.
"""

import numpy as np
from matplotlib.colors import to_rgb

EYES = {  # what they see of linear red, green and blue
    "usual": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "deutan": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "protan": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "tritan": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
TO_XYZ = [[0.412, 0.358, 0.180], [0.213, 0.715, 0.072], [0.019, 0.119, 0.950]]
WHITE = [0.950, 1.0, 1.089]


def least_apart(colours, eye):
    """Returns the distance between the two most alike of some colours, as an eye sees them."""
    shades = np.array([to_rgb(colour) for colour in colours])
    linear = np.where(shades <= 0.04045, shades / 12.92, ((shades + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.array(EYES[eye]).T, 0, 1) @ np.array(TO_XYZ).T / WHITE
    dark = 24389 / 27 * seen / 116 + 16 / 116
    x, y, z = np.where(seen > 216 / 24389, np.cbrt(seen), dark).T
    lab = np.stack([116 * y, 500 * (x - y), 200 * (y - z)], axis=1)
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=-1)
    return apart[~np.eye(len(lab), dtype=bool)].min()
