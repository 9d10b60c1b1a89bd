"""Animations: the frames of a job on disk, those still missing rendered, and the film made of them.

A frame is written under another name and moved into place, so that a file by its name is whole. ``frames.json`` beside
the frames records what they were made of; frames of different jobs are not mixed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.files import plain, replace_when_free, write_json
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import MAX_JSON_BYTES, finite, read_bytes, read_json
from iris_addon.edits.motion import at_time, camera_at
from iris_addon.edits.parsing import json_map, whole
from iris_addon.edits.scene_edit import SceneEdit
from iris_addon.model.capture import Camera, View
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.files import EMITTERS, REPORT, RESPONSE, result_file
from iris_addon.results.result import Result

from .onto_photos import PhotoInsertion
from .outcome import Outcome
from .pictures import Developer, FloatArray, write_picture

RECORD = "frames.json"


@dataclass(frozen=True)
class Frames:
    """The frames of one job in ``folder``.

    Attributes:
        length: frames of the whole animation; time 0 is frame 1.
        suffix: ".png" or ".exr".
        facts: kept beside the frames, for instance the exposure that all of them share.
    """

    folder: Path
    length: int
    suffix: str
    facts: dict[str, Any]

    def path(self, frame: int) -> Path:
        """Where ``frame`` lies."""
        return self.folder / f"frame_{frame:04d}{self.suffix}"

    def time(self, frame: int) -> float:
        """Time of ``frame`` as a share of the animation: 0 for the first, 1 for the one after the last."""
        return (frame - 1) / self.length

    def finished(self, frame: int) -> bool:
        """Whether ``frame`` need not be rendered again."""
        path = self.path(frame)
        return path.is_file() and path.stat().st_size > 0

    def exposure(self) -> FloatArray:
        """The exposure that all frames share, one number or three; raises BadInput if the record is damaged."""
        kept = self.facts["exposure"]
        found = finite(kept, (3,) if isinstance(kept, list) else ())
        if found is None or not (found > 0).all():
            raise BadInput(
                "'exposure' is no exposure", "choose another --out, or delete the folder", self.folder / RECORD
            )
        return found

    def all_finished(self) -> list[int]:
        """The frames that need not be rendered again, in order: those that lie in the folder, whatever the length."""
        names = re.compile(rf"frame_(\d{{4,9}}){re.escape(self.suffix)}")
        found = [int(match[1]) for path in self.folder.iterdir() if (match := names.fullmatch(path.name))]
        return sorted(frame for frame in set(found) if 1 <= frame <= self.length and self.finished(frame))

    def remember(self, **facts: Any) -> None:
        """Keep ``facts`` beside the frames."""
        self.facts.update(facts)
        write_json(self.folder / RECORD, self.facts)


def open_frames(folder: Path, length: int, suffix: str, job: Mapping[str, Any]) -> Frames:
    """The frames in ``folder``; those that exist must belong to this job.

    Args:
        job: everything that decides what the frames show, as JSON.

    Raises:
        BadInput: the folder holds frames of another job.
    """
    text = json.dumps([plain(job), length, suffix], sort_keys=True)
    fingerprint = hashlib.sha256(text.encode()).hexdigest()
    facts = read_json(folder / RECORD) if (folder / RECORD).is_file() else {}
    if facts.get("fingerprint") != fingerprint:
        if any(folder.glob("frame_*")):
            raise BadInput("holds frames of another job", "choose another --out, or delete the folder", folder)
        facts = {}  # the record of a job that ended before its first frame
    frames = Frames(folder, length, suffix, facts)
    if not facts:
        frames.remember(fingerprint=fingerprint)
    return frames


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
            if "exposure" not in frames.facts:
                base = views[_first_view(at_time(move, 0.0))]
                factor = Developer(result, args.out, args.exposure).factor(base, radiance)
                frames.remember(exposure=np.asarray(factor).tolist())
            radiance = result.response.apply(radiance * frames.exposure())
        write_picture(frames.path(frame), radiance)

    todo = [frame for frame in args.frames if not frames.finished(frame)]
    # A room in which nothing moves is built once for all frames.
    batches = [[frame] for frame in todo] if _moves(job) else [todo]
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
            picture.write(frames.folder, frames.path(frame).stem, linear=args.linear)
            _tell(progress, args, frames)
    return _finish(args, frames, len(todo))


def _open(args: argparse.Namespace, views: Sequence[View], job: Mapping[str, Any], *, linear: bool = False) -> Frames:
    length = whole(job.get("length", args.length or args.frames.last), "length")
    made_of = {
        "command": args.command,
        "result": [_digest(result_file(args.result, name)) for name in (REPORT, RESPONSE, EMITTERS)],
        "views": [[view.name, view.camera.fx, view.camera.fy, view.camera.c2w] for view in views],
        "job": job,
        "onto_photos": getattr(args, "onto_photos", False),
        "look": [args.samples, args.seed, args.exposure],
    }
    return open_frames(args.out, max(length, 1), ".exr" if args.linear or linear else ".png", made_of)


def _finish(args: argparse.Namespace, frames: Frames, rendered: int) -> Outcome:
    film = write_film(frames, args.fps)
    figures = {"frames": len(args.frames), "rendered now": rendered, "folder": frames.folder, "film": film}
    return Outcome.of("Rendered the frames", {key: value for key, value in figures.items() if value is not None})


def _tell(progress: Progress, args: argparse.Namespace, frames: Frames) -> None:
    done = sum(frames.finished(frame) for frame in args.frames)
    progress.update(done / len(args.frames))


def _moves(job: Mapping[str, Any]) -> bool:
    """Whether anything but the camera of ``job`` changes with time."""
    return any(_has_motion(value) for key, value in job.items() if key != "camera")


def _has_motion(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(key in ("keys", "turntable") or _has_motion(item) for key, item in value.items())
    return isinstance(value, list) and any(_has_motion(item) for item in value)


def _first_view(move: Mapping[str, Any]) -> int:
    path = move.get("path", "all")
    return move.get("view", 0) if path == "all" else path[0]


def _digest(path: Path) -> str:
    return hashlib.sha256(read_bytes(path, MAX_JSON_BYTES)).hexdigest() if path.is_file() else ""


# ---- the film -------------------------------------------------------------------------------------------------------


def find_ffmpeg() -> str | None:
    """ffmpeg in one of the folders that PATH names in full; None where there is none.

    A plain search begins in the current folder on Windows, and includes it where PATH has a relative entry. That folder
    may be somebody else's capture and hold a program of that name.
    """
    name = "ffmpeg.exe" if os.name == "nt" else "ffmpeg"
    folders = (folder for folder in map(Path, os.get_exec_path()) if folder.is_absolute())
    return next(filter(None, (shutil.which(str(folder / name)) for folder in folders)), None)


def write_film(frames: Frames, fps: float) -> Path | None:
    """Write the frames from 1 on as ``film.mp4``; None without ffmpeg, for EXR, and while one in between is missing.

    Raises:
        IrisError: ffmpeg fails.
    """
    ffmpeg = find_ffmpeg()
    finished = frames.all_finished() if ffmpeg is not None and frames.suffix == ".png" else []
    if ffmpeg is None or not finished or finished[-1] != len(finished):
        return None
    film, unfinished = frames.folder / "film.mp4", frames.folder / ".film.mp4"
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # H.264 in 4:2:0 has no odd sizes
    command: Sequence[str] = [
        *(ffmpeg, "-y", "-loglevel", "error", "-framerate", str(fps), "-start_number", "1"),
        *("-i", "frame_%04d.png", "-vf", even, "-pix_fmt", "yuv420p", unfinished.name),
    ]
    unfinished.unlink(missing_ok=True)  # in a folder from an untrusted source a link, which ffmpeg would follow
    # In the folder, whose name may hold what ffmpeg takes for a pattern.
    ran = subprocess.run(
        command, cwd=frames.folder, capture_output=True, encoding="utf-8", errors="replace", check=False
    )
    if ran.returncode != 0:
        unfinished.unlink(missing_ok=True)
        said = (ran.stderr.strip().splitlines() or ["no message"])[-1]
        raise IrisError(f"ffmpeg failed ({said})", "the frames are finished: make the film by hand", film)
    replace_when_free(unfinished, film)
    return film
