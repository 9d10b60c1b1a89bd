"""The artist's additions to a solved room, composited onto the image sequence behind the camera of the scene.

The camera is tracked and animated, and shows the plate as its background: a movie clip or an image of a sequence. Every
frame is rendered as :mod:`.photo_composite` does it, at the exposure at which the room looks like that frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.color_spaces import ColorSpace
from ...base.errors import BadInput
from ...model.device import Device
from ...model.render_settings import RenderSettings
from ...response.matching import match_exposure
from .differential import change_photo, write_layers
from .photo_composite import additions, write_photo
from .plate import plate_picture, read_plate

MAX_ASPECT_ERROR = 0.005
"""Relative, between the shape of the plate and that of the scene's renders: a pixel in 200."""


class FrameLayers(NamedTuple):
    """An EXR of layers (:func:`~.differential.write_layers`) and its color space, None for Rec.709."""

    path: Path
    space: ColorSpace | None


@dataclass(frozen=True)
class CompositedFrame:
    """A frame that was written.

    Attributes:
        exposure: (3,) at which the room looks like the plate.
        shows_added: whether anything that was added is visible.
    """

    picture: Path
    exposure: NDArray[np.float64]
    shows_added: bool


def composite_frame(
    scene: bpy.types.Scene,
    frame: int,
    out: Path,
    device: Device,
    settings: RenderSettings,
    light_state: str | None = None,
    layers: FrameLayers | None = None,
) -> CompositedFrame:
    """Write the frame ``frame`` of the plate of ``scene`` with what was added to the room as ``out``.

    Changes the frame and the render settings of ``scene``.

    Args:
        device: the camera of the plate.
        out: .exr of radiance for plates of radiance, else .png.
        light_state: in which the plate was filmed, of a room that was photographed in several.
        layers: that are written as well; None for none.

    Raises:
        BadInput: the plate has no such frame, or one of another shape than the scene renders, or the scene does not
            keep that light state.
        IrisError: ``out`` cannot be written.
    """
    scene.frame_set(frame)
    picture, photo = plate_picture(scene, frame), read_plate(scene, frame)
    values = photo.values
    _check_shape(scene, values, picture)
    changed = additions(scene, values.shape, settings, light_state)
    gain = np.ones(1) if photo.hdr else device.gain(values)
    exposure = match_exposure(changed.without, photo, device.response, gain)
    made = change_photo(values, changed, None if photo.hdr else device.response, gain * exposure)
    if layers is not None:
        write_layers(layers.path, made, layers.space)
    write_photo(out, made, scene)
    return CompositedFrame(picture, exposure, made.shows_added)


def _check_shape(scene: bpy.types.Scene, values: NDArray[np.floating], picture: Path) -> None:
    """Raise BadInput if the camera of ``scene`` would frame a picture of this shape otherwise than it does."""
    height, width = values.shape[:2]
    wanted = scene.render.resolution_x / scene.render.resolution_y
    if abs(width / height / wanted - 1) > MAX_ASPECT_ERROR:
        size = f"{scene.render.resolution_x}x{scene.render.resolution_y}"
        raise BadInput(
            f"is {width}x{height} pixels, the scene renders {size}",
            "give the scene the resolution of the plate",
            picture,
        )
