"""What is wrong with the cameras of a capture as a whole: a focal length, a principal point, an offset from the poses.

RGB-D recorders often give the poses and the focal length of the depth camera to photos of the colour camera beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .types import Camera, View

SAME_FIELD = 1e-3


@dataclass(frozen=True)
class CameraCorrection:
    """One correction for all photos of one camera.

    Attributes:
        fx_over_width: of the cameras as given, by which the views that it applies to are known.
        focal: factor of the focal lengths.
        principal: shift of the principal point in image widths, right and down.
        offset: shift of the centre of projection, metres along the camera's x (right) and y (up).
    """

    fx_over_width: float
    focal: float = 1.0
    principal: tuple[float, float] = (0.0, 0.0)
    offset: tuple[float, float] = (0.0, 0.0)

    def camera(self, camera: Camera) -> Camera:
        """The camera as it was; one with another field of view is none of this capture's and stays as it is."""
        if abs(camera.fx / camera.width - self.fx_over_width) > SAME_FIELD * self.fx_over_width:
            return camera
        c2w = np.array(camera.c2w, np.float64)
        c2w[:3, 3] += c2w[:3, :2] @ self.offset
        return replace(
            camera,
            fx=camera.fx * self.focal,
            fy=camera.fy * self.focal,
            cx=camera.cx + self.principal[0] * camera.width,
            cy=camera.cy + self.principal[1] * camera.width,
            c2w=c2w,
        )

    def view(self, view: View) -> View:
        """``view`` with its camera corrected; a distorted photo is left alone, its lens was calibrated."""
        return view if view.distortion is not None else replace(view, camera=self.camera(view.camera))

    def content(self) -> dict[str, Any]:
        """Plain values for report.json."""
        return {
            "fx_over_width": self.fx_over_width,
            "focal": round(self.focal, 5),
            "principal": [round(x, 5) for x in self.principal],
            "offset": [round(x, 5) for x in self.offset],
        }

    @staticmethod
    def from_content(content: Mapping[str, Any]) -> CameraCorrection:
        """Inverse of :meth:`content`; raises KeyError, TypeError or ValueError for anything else."""
        numbers = np.array(
            [content["fx_over_width"], content["focal"], *content["principal"], *content["offset"]], float
        )
        if numbers.shape != (6,) or not np.isfinite(numbers).all() or (numbers[:2] <= 0).any():
            raise ValueError("not a camera correction")
        of, focal, cx, cy, x, y = numbers.tolist()
        return CameraCorrection(of, focal, (cx, cy), (x, y))
