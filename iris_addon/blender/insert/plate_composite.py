"""The artist's additions to a solved room, composited onto the image sequence behind the camera of the scene.

The camera is tracked and animated, and shows the plate as its background: a movie clip or an image of a sequence. Every
frame is rendered as :mod:`.photo_composite` does it, at the exposure at which the room looks like that frame.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...model.capture import Photo
from ...model.local_exposure import LocalSettings
from ...model.render_settings import RenderSettings
from ...model.response import Response
from ...response.matching import match_exposure
from ..images import read_image
from .differential import change_light, change_photo
from .photo_composite import additions, write_png, write_radiance

RADIANCE_SUFFIX = ".exr"
MAX_ASPECT_ERROR = 0.005
"""Relative, between the shape of the plate and that of the scene's renders: a pixel in 200."""


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
    response: Response,
    local: LocalSettings,
    settings: RenderSettings,
) -> CompositedFrame:
    """Write the frame ``frame`` of the plate of ``scene`` with what was added to the room as ``out``.

    Changes the frame and the render settings of ``scene``.

    Args:
        out: .exr of radiance for plates of radiance, else .png.

    Raises:
        BadInput: the plate has no such frame, or one of another shape than the scene renders.
        IrisError: ``out`` cannot be written.
    """
    scene.frame_set(frame)
    picture = plate_picture(scene, frame)
    hdr = picture.suffix.lower() == RADIANCE_SUFFIX
    values = read_image(picture)
    _check_shape(scene, values, picture)
    changed = additions(scene, values.shape, settings)
    gain = np.ones(1) if hdr else local.gain(values, response)
    photo = Photo(values=values, valid=np.isfinite(values).all(-1), hdr=hdr)
    exposure = match_exposure(changed.without, photo, response, gain)
    if hdr:
        write_radiance(out, change_light(values, changed, exposure), scene)
    else:
        write_png(out, change_photo(values, changed, response, gain * exposure)[0])
    return CompositedFrame(picture, exposure, bool(changed.covered.any()))


def shows_plate(scene: bpy.types.Scene) -> bool:
    """Whether the camera of ``scene`` has a sequence behind it; looks at no file."""
    return _behind(scene) is not None


def plate_picture(scene: bpy.types.Scene, frame: int) -> Path:
    """The file that the camera of ``scene`` shows at ``frame`` of the scene.

    Raises:
        BadInput: there is no camera, it shows no sequence, or the sequence does not reach so far.
    """
    if scene.camera is None:
        raise BadInput("the scene has no active camera", "make the tracked camera the active one")
    behind = _behind(scene)
    if behind is None:
        what, fix = f"the camera {scene.camera.name} shows no plate", "give it a movie clip or an image sequence as its"
        raise BadInput(what, f"{fix} background image")
    if behind.source == "MOVIE_CLIP":
        return _of_clip(scene.active_clip if behind.use_camera_clip else behind.clip, frame)
    return _of_image(behind.image, behind.image_user, frame)


def _behind(scene: bpy.types.Scene) -> bpy.types.CameraBackgroundImage | None:
    """The first background of the active camera that is a sequence."""
    if scene.camera is None or scene.camera.type != "CAMERA":
        return None
    for behind in scene.camera.data.background_images:
        if behind.source == "MOVIE_CLIP" and (scene.active_clip if behind.use_camera_clip else behind.clip) is not None:
            return behind
        if behind.source == "IMAGE" and behind.image is not None and behind.image.source in ("SEQUENCE", "MOVIE"):
            return behind
    return None


def _of_clip(clip: bpy.types.MovieClip, frame: int) -> Path:
    if clip.source != "SEQUENCE":
        raise BadInput(
            f"the clip {clip.name} is a movie file", "render it as an image sequence, and use that as the clip"
        )
    if _distorts(clip.tracking.camera):
        raise BadInput(
            f"the clip {clip.name} has lens distortion",
            "render it undistorted as an image sequence, and use that instead",
        )
    first = Path(bpy.path.abspath(clip.filepath, library=clip.library))
    return _numbered(first, frame - clip.frame_start + clip.frame_offset, from_its_own=True)


def _of_image(image: bpy.types.Image, user: bpy.types.ImageUser, frame: int) -> Path:
    if image.source == "MOVIE":
        raise BadInput(f"{image.name} is a movie file", "render it as an image sequence, and show that")
    at = frame - user.frame_start + 1
    if user.use_cyclic:
        at = (at - 1) % max(user.frame_duration, 1) + 1
    if not 1 <= at <= user.frame_duration:
        raise BadInput(
            f"{image.name} shows frames {user.frame_start} to {user.frame_start + user.frame_duration - 1}",
            "set its number of frames, or shorten the range of the scene",
        )
    return _numbered(Path(bpy.path.abspath(image.filepath, library=image.library)), at + user.frame_offset)


def _numbered(path: Path, number: int, *, from_its_own: bool = False) -> Path:
    """The file of the sequence of ``path`` with ``number``, or so many after ``path``."""
    found = re.search(r"\d+(?=\D*$)", path.stem)
    if found is None:
        raise BadInput("has no frame number in its name", "name the frames as shot.1001.png", path)
    number += int(found[0]) if from_its_own else 0
    digits = f"{max(number, 0):0{len(found[0])}d}"
    named = path.with_name(path.stem[: found.start()] + digits + path.stem[found.end() :] + path.suffix)
    if number < 0 or not named.is_file():
        raise BadInput("is missing", "add the picture, or shorten the range of the scene", named)
    return named


_COEFFICIENTS = {
    "POLYNOMIAL": ("k1", "k2", "k3"),
    "DIVISION": ("division_k1", "division_k2"),
    "NUKE": ("nuke_k1", "nuke_k2"),
    "BROWN": ("brown_k1", "brown_k2", "brown_k3", "brown_k4", "brown_p1", "brown_p2"),
}


def _distorts(lens: bpy.types.MovieTrackingCamera) -> bool:
    return any(getattr(lens, name, 0.0) != 0 for name in _COEFFICIENTS.get(lens.distortion_model, ()))


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
