"""Where a lens puts what a pinhole camera sees.

The distortion models are OpenCV's (https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html and, for the fisheye,
group__calib3d__fisheye.html). Both map a pinhole direction to its place in the photo, which is what resampling onto the
pinhole needs, so nothing has to be inverted. k4 of the perspective model multiplies r^8, as in nerfstudio, unless there
are k5 and k6: then the three are OpenCV's, of the denominator. The FOV model is that of Devernay and Faugeras, Straight
Lines Have to Be Straight (2001), as COLMAP has it. Needs no package but numpy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.capture import Distortion, FloatArray


def distort(x: FloatArray, y: FloatArray, lens: Distortion) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Where the lens puts pinhole coordinates x = X/Z, y = Y/Z (image axes: x right, y down).

    Returns:
        Distorted x and y, and whether the radial mapping is still one-to-one there: beyond its turning point a
        polynomial folds the image back and would show a second, false copy of its centre.
    """
    r = np.hypot(x, y)
    if lens.omega:
        scale = np.where(r > 1e-9, _by_angle(r, lens.omega) / np.maximum(r, 1e-9), _by_angle(1e-9, lens.omega) / 1e-9)
        return x * scale, y * scale, np.ones(r.shape, bool)
    if lens.fisheye:
        # The angle takes the place of the radius, in the direction of the pixel.
        angle = np.arctan(r)
        scale = np.where(r > 1e-9, angle / np.maximum(r, 1e-9), 1.0)
        x, y, r = x * scale, y * scale, angle
    radial = np.where(r > 1e-9, _radial(r, lens) / np.maximum(r, 1e-9), 1.0)
    x_distorted = x * radial + 2 * lens.p1 * x * y + lens.p2 * (r**2 + 2 * x**2) + lens.sx1 * r**2
    y_distorted = y * radial + lens.p1 * (r**2 + 2 * y**2) + 2 * lens.p2 * x * y + lens.sy1 * r**2
    return x_distorted, y_distorted, r < _turning_point(lens, np.pi / 2 if lens.fisheye else float(r.max()) + 1.0)


def _radial(t: FloatArray, lens: Distortion) -> FloatArray:
    """t (1 + k1 t² + k2 t⁴ + k3 t⁶ + k4 t⁸) / (1 + d1 t² + d2 t⁴ + d3 t⁶), t the radius, or the angle of a fisheye."""
    t2 = t * t
    numerator = 1 + t2 * (lens.k1 + t2 * (lens.k2 + t2 * (lens.k3 + t2 * lens.k4)))
    return t * numerator / (1 + t2 * (lens.d1 + t2 * (lens.d2 + t2 * lens.d3)))


def _by_angle(r: FloatArray | float, omega: float) -> FloatArray:
    """The distorted radius of a lens on which distances from the middle grow as angles do: arctan(2 r tan(ω/2)) / ω."""
    return np.arctan(2 * np.asarray(r) * np.tan(omega / 2)) / omega


def _turning_point(lens: Distortion, limit: float) -> float:
    """First t in (0, limit] where the radial mapping stops growing; a little beyond ``limit`` when it never does."""
    t = np.linspace(0, limit, 4097)
    falling = np.flatnonzero(np.diff(_radial(t, lens)) <= 0)
    return float(t[falling[0]]) if len(falling) else limit * (1 + 1e-9)
