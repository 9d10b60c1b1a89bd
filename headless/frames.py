"""Frames of an animation on disk: which there are, which are finished, whether they are of this job, and the film.

A frame is written under another name and moved in place, so that a file by its name is whole. ``frames.json`` beside
the frames says what they were made of; frames of another job are not mixed in.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.files import plain, read_json, write_json

RECORD = "frames.json"


@dataclass(frozen=True)
class Frames:
    """The frames of one job in ``folder``.

    Attributes:
        length: frames of the whole animation; time 0 is frame 1.
        suffix: ".png" or ".exr".
        facts: what is kept beside the frames, for instance the exposure that all of them share.
    """

    folder: Path
    length: int
    suffix: str
    facts: dict[str, Any]

    def path(self, frame: int) -> Path:
        """Where ``frame`` lies."""
        return self.folder / f"frame_{frame:04d}{self.suffix}"

    def time(self, frame: int) -> float:
        """The moment of ``frame``: 0 for the first; 1 would be the one after the last."""
        return (frame - 1) / self.length

    def finished(self, frame: int) -> bool:
        """Whether ``frame`` need not be rendered again."""
        path = self.path(frame)
        return path.is_file() and path.stat().st_size > 0

    def remember(self, **facts: Any) -> None:
        """Keep ``facts`` beside the frames."""
        self.facts.update(facts)
        write_json(self.folder / RECORD, self.facts)


def open_frames(folder: Path, length: int, suffix: str, job: Mapping[str, Any]) -> Frames:
    """The frames in ``folder``, which must be of this job if there are any.

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
        facts = {}  # those of a job that ended before its first frame
    frames = Frames(folder, length, suffix, facts)
    if not facts:
        frames.remember(fingerprint=fingerprint)
    return frames


def find_ffmpeg() -> str | None:
    """ffmpeg in one of the folders that PATH names in full; None where there is none.

    A plain search begins in the current folder on Windows, and includes it where PATH has a relative entry: that of
    somebody else's capture may hold a program of that name.
    """
    name = "ffmpeg.exe" if os.name == "nt" else "ffmpeg"
    folders = (folder for folder in map(Path, os.get_exec_path()) if folder.is_absolute())
    return next(filter(None, (shutil.which(str(folder / name)) for folder in folders)), None)


def write_film(frames: Frames, fps: float) -> Path | None:
    """The frames from 1 on as ``film.mp4``, or None without ffmpeg, for EXR, and while one is missing between others.

    Raises:
        IrisError: ffmpeg fails.
    """
    ffmpeg = find_ffmpeg()
    there = [frame for frame in range(1, frames.length + 1) if frames.finished(frame)]
    if ffmpeg is None or frames.suffix != ".png" or not there or there[-1] != len(there):
        return None
    film, unfinished = frames.folder / "film.mp4", frames.folder / ".film.mp4"
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # H.264 in 4:2:0 has no odd sizes
    command: Sequence[str] = [
        *(ffmpeg, "-y", "-loglevel", "error", "-framerate", str(fps), "-start_number", "1"),
        *("-i", "frame_%04d.png", "-vf", even, "-pix_fmt", "yuv420p", unfinished.name),
    ]
    # In the folder, whose name may hold what ffmpeg takes for a pattern.
    ran = subprocess.run(
        command, cwd=frames.folder, capture_output=True, encoding="utf-8", errors="replace", check=False
    )
    if ran.returncode != 0:
        unfinished.unlink(missing_ok=True)
        said = (ran.stderr.strip().splitlines() or ["no message"])[-1]
        raise IrisError(f"ffmpeg failed ({said})", "the frames are finished: make the film by hand", film)
    os.replace(unfinished, film)
    return film
