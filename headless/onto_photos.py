"""One photo with objects inserted: the photo, its exposure and the renders that edits of it share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from iris_addon.base.errors import BadInput
from iris_addon.capture.photos import load_photo
from iris_addon.edits.scene_edit import SceneEdit
from iris_addon.model.capture import Photo, View
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.result import Result

from .pictures import FloatArray, known_exposure, write_picture

if TYPE_CHECKING:
    from iris_addon.blender.insert.differential import ChangedPhoto


def write_changed(photo: ChangedPhoto, folder: Path, name: str, *, linear: bool, acescg: bool) -> Path:
    """Write ``photo`` as ``name``.png, or as ``name``.exr of radiance where ``linear`` or it holds radiance, that in
    Rec.709 or ``acescg``."""
    if linear or photo.display is None:
        return write_picture(folder / f"{name}.exr", photo.radiance, acescg=acescg)
    return write_picture(folder / f"{name}.png", photo.display)


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
        from iris_addon.blender.insert.differential import change_photo, render_change, render_pair, unchanged_photo

        values, response = self.photo.values.astype(np.float64), self._device.response
        known = known_exposure(self.result, self.view)
        if known is not None:
            known = known * self._gain
        if edit.changes_nothing:
            return unchanged_photo(values, None if self.photo.hdr else response, 1.0 if known is None else known)
        if self._without is None:
            self._without = render_pair(self.result, self.view.camera, None, self.settings)
        changed = render_change(self.result, self.view.camera, edit, self._without, self.settings)
        if self.photo.hdr:
            return change_photo(values, changed, None, np.ones(1) if known is None else known)
        exposure = self._fitted_exposure(changed.without) if known is None else known
        return change_photo(values, changed, response, exposure)

    def _fitted_exposure(self, without: FloatArray) -> FloatArray:
        """The exposure that makes the render look like the photo, (H, W, 3) or broadcastable to it."""
        from iris_addon.evaluate.pictures import fit_gains

        return self._gain * fit_gains(without * self._gain, self.photo, self._device.response)
