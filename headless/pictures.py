"""Rendered radiance as pictures: through the recovered response, with the chosen exposure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.color_spaces import ACESCG
from iris_addon.base.images import to_codes, write_exr, write_png
from iris_addon.model.capture import View
from iris_addon.model.response import grey_exposure
from iris_addon.results.records import median_exposure
from iris_addon.results.result import Result

FloatArray = NDArray[np.floating]


def known_exposure(result: Result, view: View) -> FloatArray | None:
    """(3,) the exposure of ``view``'s photo as recovered or as recorded, None if it is neither."""
    if view.split == "train" and view.name in result.exposures:
        return result.exposures[view.name]
    return None if view.exposure is None else view.exposure * np.array(result.device_of(view).exposure_factor)


def photo_exposure(result: Result, view: View) -> FloatArray:
    """(3,) the exposure of ``view``'s photo: as recovered, as recorded, or the median of the recovered ones."""
    known = known_exposure(result, view)
    return median_exposure(result.exposures) if known is None else known


@dataclass(frozen=True)
class Developer:
    """Writes radiance as pictures into ``folder``.

    Attributes:
        exposure: "photo", "auto" or a factor.
        linear: EXR of radiance instead of PNG.
        acescg: in ACEScg instead of Rec.709.
    """

    result: Result
    folder: Path
    exposure: str | float = "photo"
    linear: bool = False
    acescg: bool = False

    def factor(self, view: View, radiance: FloatArray) -> FloatArray | float:
        """The exposure by which ``radiance`` (H, W, 3) of ``view`` is multiplied before the response."""
        if self.exposure == "photo":
            return photo_exposure(self.result, view)
        return grey_exposure(radiance) if self.exposure == "auto" else float(self.exposure)

    def develop(self, view: View, radiance: FloatArray) -> FloatArray:
        """(H, W, 3) display values in [0, 1] of ``radiance`` (H, W, 3)."""
        return self.result.device_of(view).response.apply(radiance * self.factor(view, radiance))

    def write(self, view: View, radiance: FloatArray) -> Path:
        """Write ``radiance`` under the view's name; raises IrisError if it cannot be written."""
        if not self.linear:
            return self.write_display(view, self.develop(view, radiance))
        return write_picture(self.folder / f"{view.name}.exr", radiance, acescg=self.acescg)

    def write_display(self, view: View, values: FloatArray) -> Path:
        """Write display values (H, W, 3) under the view's name; raises IrisError if it cannot be written."""
        return write_picture(self.folder / f"{view.name}.png", values)


def write_picture(path: Path, values: FloatArray, *, acescg: bool = False) -> Path:
    """Write (H, W, 3) linear radiance as .exr, in Rec.709 or ACEScg, or display values as .png.

    Raises:
        IrisError: it cannot be written.
    """
    if path.suffix == ".exr":
        write_exr(path, values, space=ACESCG if acescg else None)
    else:
        write_png(path, to_codes(values))
    return path
