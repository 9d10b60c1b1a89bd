"""One photo with objects inserted: the photo, its exposure and the renders that edits of it share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from iris_addon.base.color_spaces import ACESCG
from iris_addon.base.errors import BadInput
from iris_addon.capture.photos import load_photo
from iris_addon.edits.scene_edit import SceneEdit
from iris_addon.model.capture import Photo, View
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import Response
from iris_addon.results.result import Result

from .pictures import FloatArray, known_exposure, write_picture

if TYPE_CHECKING:
    from iris_addon.blender.insert.differential import Differential


@dataclass(frozen=True)
class ChangedPhoto:
    """A photo with an edit in it.

    Attributes:
        display: (H, W, 3) display values, or None where the photo holds radiance.
        radiance: (H, W, 3) linear; in the unit of the photo where that holds radiance.
        shows_added: whether anything of the inserted objects is visible.
        plate: (H, W, 3) ``radiance`` without the edit; None where the edit changes nothing.
        covered: (H, W) share of each pixel that inserted objects cover; None where there are none.
    """

    display: FloatArray | None
    radiance: FloatArray
    shows_added: bool
    plate: FloatArray | None = None
    covered: FloatArray | None = None

    @staticmethod
    def of(values: FloatArray, changed: Differential, exposure: FloatArray, response: Response | None) -> ChangedPhoto:
        """A photo with the change that was rendered for it.

        Args:
            values: (H, W, 3) of the photo.
            exposure: under which the render looks like it, broadcastable to it.
            response: that it was taken with; None where it holds radiance.
        """
        from iris_addon.blender.insert.differential import change_light, change_photo, no_change

        shows_added = bool(changed.covered.any())
        if response is None:
            light = change_light(values, changed, exposure)
            return ChangedPhoto(None, light, shows_added, plate=values, covered=changed.covered)
        return ChangedPhoto(
            *change_photo(values, changed, response, exposure),
            shows_added,
            plate=change_photo(values, no_change(changed), response, exposure)[1],
            covered=changed.covered,
        )

    def write(self, folder: Path, name: str, *, linear: bool, acescg: bool) -> Path:
        """Write ``name``.png, or ``name``.exr of radiance where ``linear`` or the photo holds radiance, that in
        Rec.709 or ``acescg``."""
        if linear or self.display is None:
            return write_picture(folder / f"{name}.exr", self.radiance, acescg=acescg)
        return write_picture(folder / f"{name}.png", self.display)

    def write_layers(self, path: Path, *, acescg: bool) -> Path:
        """Write the picture and what it is made of as one EXR (:func:`~.differential.write_layers`)."""
        from iris_addon.blender.insert.differential import write_layers

        plate = self.radiance if self.plate is None else self.plate
        covered = np.zeros(plate.shape[:2]) if self.covered is None else self.covered
        write_layers(path, self.radiance, plate, covered, ACESCG if acescg else None)
        return path


def require_response(result: Result, photo: Photo, view: View) -> None:
    """Raise BadInput if ``result`` does not know the response that ``photo`` of ``view`` was taken with."""
    if not photo.hdr and result.response.family == "identity":
        raise BadInput(
            "the room was solved from radiance, so the response of this photo is not known",
            "solve the photos, or give photos that are EXR files of radiance",
            view.photo,
        )


class PhotoInsertion:
    """Differential rendering onto the photo of one view; the room without edits is rendered once."""

    def __init__(self, result: Result, view: View, settings: RenderSettings) -> None:
        """Read the photo; raises BadInput if the result has no response that it was taken with."""
        self.result, self.view = result, view
        self.photo = load_photo(view)
        require_response(result, self.photo, view)
        self._device = result.device_of(view)
        self._gain = np.ones(1) if self.photo.hdr else self._device.gain(self.photo.values)
        self.settings = settings
        self._without: tuple[FloatArray, FloatArray] | None = None

    def picture(self, edit: SceneEdit) -> ChangedPhoto:
        """The photo as it would have been with ``edit`` in the room; the photo itself if that changes nothing."""
        from iris_addon.blender.insert.differential import render_change, render_pair

        values, response = self.photo.values.astype(np.float64), self._device.response
        known = known_exposure(self.result, self.view)
        if known is not None:
            known = known * self._gain
        if edit.changes_nothing:
            linear = values if self.photo.hdr else response.invert(values) / (1.0 if known is None else known)
            return ChangedPhoto(None if self.photo.hdr else values, linear, shows_added=False)
        if self._without is None:
            self._without = render_pair(self.result, self.view.camera, None, self.settings)
        changed = render_change(self.result, self.view.camera, edit, self._without, self.settings)
        if self.photo.hdr:
            return ChangedPhoto.of(values, changed, np.ones(1) if known is None else known, None)
        exposure = self._fitted_exposure(changed.without) if known is None else known
        return ChangedPhoto.of(values, changed, exposure, response)

    def _fitted_exposure(self, without: FloatArray) -> FloatArray:
        """The exposure that makes the render look like the photo, (H, W, 3) or broadcastable to it."""
        from iris_addon.evaluate.pictures import fit_gains

        return self._gain * fit_gains(without * self._gain, self.photo, self._device.response)
