"""The plate behind the camera of a scene: the file and the pixels of each frame.

It is the camera's background, a movie clip, or an image that is a sequence or a movie. Frames are counted as Blender
shows them. Lens distortion that the tracking of a clip has found is taken out, because what is rendered has none. Needs
no package but numpy.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...capture.lens import distort
from ...model.capture import Distortion, Photo
from ..images import DATA, read_image
from ..render.cycles import empty_scene, render_linear
from ..version import compositor_output, own_compositor_tree

RADIANCE_SUFFIX = ".exr"


def read_plate(scene: bpy.types.Scene, frame: int) -> Photo:
    """The pixels behind the camera of ``scene`` at ``frame``, without lens distortion.

    Raises:
        BadInput: there are none (:func:`plate_picture`), the file cannot be read, or the lens is of another model.
    """
    picture, clip = plate_picture(scene, frame), _clip(scene)
    hdr = picture.suffix.lower() == RADIANCE_SUFFIX
    lens = None if clip is None else _lens(clip)
    movie = _movie_frame(scene, frame)
    values = read_image(picture) if movie is None else _of_movie(picture, *movie)
    valid = np.isfinite(values).all(-1)
    if clip is not None and lens is not None:
        values, valid = _undistorted(values, valid, clip.tracking.camera, lens)
    return Photo(values=values, valid=valid, hdr=hdr)


def _movie_frame(scene: bpy.types.Scene, frame: int) -> tuple[bpy.types.MovieClip | None, int] | None:
    """The movie clip behind the camera and the frame of the scene, or None and the number of the frame in the movie
    that is shown as an image; None where there is no movie."""
    behind, clip = _behind(scene), _clip(scene)
    if clip is not None:
        return (clip, frame) if clip.source == "MOVIE" else None
    if behind is None or behind.image.source != "MOVIE":
        return None
    return None, _shown_by_image(behind.image, behind.image_user, frame)


def _of_movie(path: Path, clip: bpy.types.MovieClip | None, frame: int) -> NDArray[np.float32]:
    """:func:`_decoded` of a clip, or of the movie file ``path`` from its first frame on."""
    if clip is not None:
        return _decoded(clip, frame)
    whole = bpy.data.movieclips.load(str(path))
    try:
        whole.frame_start = 1
        return _decoded(whole, frame)
    finally:
        bpy.data.movieclips.remove(whole)


def _decoded(clip: bpy.types.MovieClip, frame: int) -> NDArray[np.float32]:
    """(H, W, 3) the frame of a movie file as Blender's compositor has it: the stored values, whatever their space."""
    before = {kind: set(getattr(bpy.data, kind)) for kind in ("scenes", "cameras", "objects", "node_groups")}
    space = clip.colorspace_settings.name
    try:
        clip.colorspace_settings.name = DATA
        empty = empty_scene(*clip.size)
        tree = own_compositor_tree(empty)
        output, source = compositor_output(tree), tree.nodes.new("CompositorNodeMovieClip")
        source.clip = clip
        tree.links.new(source.outputs["Image"], output)
        empty.frame_set(frame)
        with _in_window(empty):
            return render_linear(empty)
    finally:
        clip.colorspace_settings.name = space
        for kind, kept in before.items():
            bpy.data.batch_remove(set(getattr(bpy.data, kind)) - kept)


def _lens(clip: bpy.types.MovieClip) -> Distortion | None:
    """The distortion of the clip's lens as tracking has found it, None where there is none."""
    lens = clip.tracking.camera
    model = lens.distortion_model
    found = {name.rpartition("_")[2]: float(getattr(lens, name)) for name in _COEFFICIENTS[model]}
    if not any(found.values()):
        return None
    if model not in _OURS:
        what = f"the lens of the clip {clip.name} is of the model {model.title()}"
        raise BadInput(what, "choose Polynomial or Brown in the Movie Clip Editor, and solve the camera again")
    return replace(Distortion(), **found)


def _undistorted(
    values: NDArray[np.floating], valid: NDArray[np.bool_], lens: bpy.types.MovieTrackingCamera, distortion: Distortion
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Like :func:`iris_addon.capture.photos.undistort`, about the principal point that tracking has.

    Not by Blender's node, which moves the picture by a pixel in both directions, even without distortion (5.0).
    """
    height, width = values.shape[:2]
    focal, (cx, up) = lens.focal_length_pixels, lens.principal_point_pixels
    cy = height - up
    i, j = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y, unique = distort((i - cx) / focal, (j - cy) / focal, distortion)
    u, v = x * focal + cx, y * focal + cy
    seen = unique & (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
    column, row = (np.clip(np.where(seen, at, 0.5) - 0.5, 0, n - 1) for at, n in ((u, width), (v, height)))
    left, top = np.minimum(column.astype(int), width - 2), np.minimum(row.astype(int), height - 2)
    s, t = (column - left)[..., None], (row - top)[..., None]
    mixed = np.zeros_like(values)
    for down, right, weight in ((0, 0, (1 - t) * (1 - s)), (0, 1, (1 - t) * s), (1, 0, t * (1 - s)), (1, 1, t * s)):
        mixed += (weight * np.nan_to_num(values[top + down, left + right])).astype(values.dtype)
        seen &= valid[top + down, left + right]
    return np.where(seen[..., None], mixed, 0).astype(np.float32), seen


@contextmanager
def _in_window(scene: bpy.types.Scene) -> Iterator[None]:
    """Inside, ``scene`` is that of the window: clips in a compositing tree show the frame of that one."""
    window = bpy.context.window
    before = None if window is None else window.scene
    try:
        if window is not None:
            window.scene = scene
        yield
    finally:
        if window is not None:
            window.scene = before


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
        what, fix = (
            f"the camera {scene.camera.name} shows no plate",
            "give it a movie clip, an image sequence or a movie as its",
        )
        raise BadInput(what, f"{fix} background image")
    clip = _clip(scene)
    if clip is not None:
        return _of_clip(clip, frame)
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


def _clip(scene: bpy.types.Scene) -> bpy.types.MovieClip | None:
    """The clip behind the active camera; None where an image is there."""
    behind = _behind(scene)
    if behind is None or behind.source != "MOVIE_CLIP":
        return None
    return scene.active_clip if behind.use_camera_clip else behind.clip


def _of_clip(clip: bpy.types.MovieClip, frame: int) -> Path:
    path = Path(bpy.path.abspath(clip.filepath, library=clip.library))
    after = frame - clip.frame_start + clip.frame_offset
    if clip.source == "SEQUENCE":
        return _numbered(path, after, from_its_own=True)
    if not path.is_file():
        raise BadInput("is missing", "give the clip its file", path)
    if not 0 <= after < clip.frame_duration:
        what = f"has {clip.frame_duration} frames, from {clip.frame_start} of the scene on"
        raise BadInput(what, "shorten the range of the scene", path)
    return path


def _of_image(image: bpy.types.Image, user: bpy.types.ImageUser, frame: int) -> Path:
    path = Path(bpy.path.abspath(image.filepath, library=image.library))
    number = _shown_by_image(image, user, frame)
    if image.source == "SEQUENCE":
        return _numbered(path, number)
    if not path.is_file():
        raise BadInput("is missing", "give the image its file", path)
    if not 1 <= number <= image.frame_duration:
        what = f"has {image.frame_duration} frames, and none with the number {number}"
        raise BadInput(what, "shorten the range of the scene", path)
    return path


def _shown_by_image(image: bpy.types.Image, user: bpy.types.ImageUser, frame: int) -> int:
    """Number of the picture, of a movie from 1 on, that an image shows at ``frame`` of the scene; raises BadInput."""
    at = frame - user.frame_start + 1
    if user.use_cyclic:
        at = (at - 1) % max(user.frame_duration, 1) + 1
    if not 1 <= at <= user.frame_duration:
        raise BadInput(
            f"{image.name} shows frames {user.frame_start} to {user.frame_start + user.frame_duration - 1}",
            "set its number of frames, or shorten the range of the scene",
        )
    return at + user.frame_offset


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
    "BROWN": ("brown_k1", "brown_k2", "brown_k3", "brown_k4", "brown_p1", "brown_p2"),
    "DIVISION": ("division_k1", "division_k2"),
    "NUKE": ("nuke_k1", "nuke_k2"),
}
"""Of Blender's models of a lens."""
_OURS = ("POLYNOMIAL", "BROWN")
"""Those that are OpenCV's, with k4 of r^8."""
