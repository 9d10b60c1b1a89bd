"""Animations of a job: the frames that are still missing, rendered or put onto one photo, and the film made of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from iris_addon.base.progress import Progress
from iris_addon.edits.motion import at_time, camera_at
from iris_addon.edits.parsing import json_map, whole
from iris_addon.edits.scene_edit import SceneEdit
from iris_addon.model.capture import Camera, View
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.result import Result

from .asked_state import state_of_frames
from .frame_folder import Frames, open_frames, result_digests, write_film
from .onto_photos import PhotoInsertion, write_changed
from .outcome import Outcome
from .pictures import Developer, FloatArray, write_picture

# ---- rendering ------------------------------------------------------------------------------------------------------


def render_frames(
    args: argparse.Namespace,
    progress: Progress,
    result: Result,
    views: Sequence[View],
    job: Mapping[str, Any],
    edit_at: Callable[[float], SceneEdit | None],
    settings: RenderSettings,
) -> Outcome:
    """Render frames completely, from a camera that may move; all of them share the exposure of the first."""
    from iris_addon.blender.render.cycles import render_views

    cameras = [view.camera for view in views]
    frames = _open(args, views, job)
    move = json_map(job.get("camera", {}), "camera")

    def camera(frame: int) -> Camera:
        return camera_at(at_time(move, frames.time(frame)), cameras, result.up, frames.time(frame))

    def save(frame: int, radiance: FloatArray) -> None:
        if not args.linear:
            base = views[_first_view(at_time(move, 0.0))]
            if "exposure" not in frames.facts:
                factor = Developer(result, args.out, args.exposure).factor(base, radiance)
                frames.remember(exposure=np.asarray(factor).tolist())
            radiance = result.device_of(base).response.apply(radiance * frames.exposure())
        write_picture(frames.path(frame), radiance, acescg=args.acescg)

    todo = [frame for frame in args.frames if not frames.finished(frame)]
    # A room in which nothing moves is built once for all frames.
    batches = [[frame] for frame in todo] if moves(job) else [todo]
    with progress.stage("frames"):
        for batch in filter(None, batches):

            def on_view(index: int, radiance: FloatArray, batch: Sequence[int] = batch) -> None:
                save(batch[index], radiance)
                _tell(progress, args, frames)

            edit = edit_at(frames.time(batch[0]))
            render_views(result, [camera(frame) for frame in batch], edit=edit, settings=settings, on_view=on_view)
    return _finish(args, frames, len(todo))


def insert_frames(
    args: argparse.Namespace,
    progress: Progress,
    insertion: PhotoInsertion,
    job: Mapping[str, Any],
    edit_at: Callable[[float], SceneEdit],
) -> Outcome:
    """Render frames of one photo in which objects move."""
    frames = _open(args, [insertion.view], job, linear=insertion.photo.hdr)
    todo = [frame for frame in args.frames if not frames.finished(frame)]
    with progress.stage("frames"):
        for frame in todo:
            picture = insertion.picture(edit_at(frames.time(frame)))
            write_changed(picture, frames.folder, frames.path(frame).stem, linear=args.linear, acescg=args.acescg)
            _tell(progress, args, frames)
    return _finish(args, frames, len(todo))


def _open(args: argparse.Namespace, views: Sequence[View], job: Mapping[str, Any], *, linear: bool = False) -> Frames:
    length = whole(job.get("length", args.length or args.frames.last), "length")
    made_of = {
        "command": args.command,
        "result": result_digests(args.result),
        "views": [[view.name, view.camera.fx, view.camera.fy, view.camera.c2w] for view in views],
        "job": job,
        "onto_photos": getattr(args, "onto_photos", False),
        "look": [args.samples, args.seed, args.exposure, *(["acescg"] if args.acescg else [])],
        **state_of_frames(args, views),
    }
    return open_frames(args.out, max(length, 1), ".exr" if args.linear or linear else ".png", made_of)


def _finish(args: argparse.Namespace, frames: Frames, rendered: int) -> Outcome:
    film = write_film(frames, args.fps)
    figures = {"frames": len(args.frames), "rendered now": rendered, "folder": frames.folder, "film": film}
    return Outcome.of("Rendered the frames", {key: value for key, value in figures.items() if value is not None})


def _tell(progress: Progress, args: argparse.Namespace, frames: Frames) -> None:
    done = sum(frames.finished(frame) for frame in args.frames)
    progress.update(done / len(args.frames))


def moves(job: Mapping[str, Any]) -> bool:
    """Whether anything but the camera of ``job`` changes with time."""
    return any(_has_motion(value) for key, value in job.items() if key != "camera")


def _has_motion(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(key in ("keys", "turntable") or _has_motion(item) for key, item in value.items())
    return isinstance(value, list) and any(_has_motion(item) for item in value)


def _first_view(move: Mapping[str, Any]) -> int:
    path = move.get("path", "all")
    return move.get("view", 0) if path == "all" else path[0]
