"""The frames of a job on disk: which are finished, what they were made of, and the film made of them.

A frame is written under another name and moved into place, so that a file by its name is whole. ``frames.json`` beside
the frames records what they were made of; frames of different jobs are not mixed. Needs no package but numpy, so that
Blender's own Python can use it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.files import digest_of, plain, replace_when_free, write_json
from iris_addon.base.untrusted import MAX_JSON_BYTES, finite, read_bytes, read_json
from iris_addon.results.files import EMITTERS, REPORT, RESPONSE, result_file

FloatArray = NDArray[np.floating]

RECORD, SCENE_RECORD = "frames.json", "scene.json"


@dataclass(frozen=True)
class Frames:
    """The frames of one job in ``folder``.

    Attributes:
        length: frames of the whole animation.
        suffix: ".png" or ".exr".
        facts: kept beside the frames, for instance the exposure that all of them share.
        first: number of the first frame, at which time is 0.
    """

    folder: Path
    length: int
    suffix: str
    facts: dict[str, Any]
    first: int = 1

    def path(self, frame: int) -> Path:
        """Where ``frame`` lies."""
        return self.folder / f"frame_{frame:04d}{self.suffix}"

    def time(self, frame: int) -> float:
        """Time of ``frame`` as a share of the animation: 0 for the first, 1 for the one after the last."""
        return (frame - self.first) / self.length

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
        there = frames_in(self.folder, range(self.first, self.first + self.length), self.suffix)
        return sorted(frame for frame in there if self.finished(frame))

    def remember(self, **facts: Any) -> None:
        """Keep ``facts`` beside the frames."""
        self.facts.update(facts)
        write_json(self.folder / RECORD, self.facts)


def frames_in(folder: Path, wanted: range, suffix: str | None = None) -> set[int]:
    """Those of the frames ``wanted`` that lie in ``folder``; the folder is looked at, however many are wanted.

    Args:
        suffix: of the frames; None for any.
    """
    names = re.compile(r"frame_(\d{4,9})" + (r"\.\w+" if suffix is None else re.escape(suffix)))
    there = folder.iterdir() if folder.is_dir() else ()
    return {int(match[1]) for path in there if (match := names.fullmatch(path.name)) and int(match[1]) in wanted}


def open_frames(folder: Path, length: int, suffix: str, job: Mapping[str, Any], first: int = 1) -> Frames:
    """The frames in ``folder``; those that exist must belong to this job.

    Args:
        job: everything that decides what the frames show, as JSON.
        first: number of the first frame.

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
    frames = Frames(folder=folder, length=length, suffix=suffix, facts=facts, first=first)
    if not facts:
        frames.remember(fingerprint=fingerprint)
    return frames


def require_frames_of(folder: Path, blend: Path) -> None:
    """Require that the frames in ``folder``, if there are any, were rendered of ``blend`` as it is now.

    Raises:
        BadInput: the scene has changed since, so that finished frames would be kept beside new ones.
    """
    if not blend.is_file():  # who renders it names it
        return
    record, now = folder / SCENE_RECORD, digest_of(blend)
    kept = read_json(record).get("sha256") if record.is_file() else None
    if kept == now:
        return
    if kept is not None and any(folder.glob("frame_*")):
        what = f"holds frames of {blend.name} as it was before"
        raise BadInput(what, "choose another out, or delete the folder", folder)
    write_json(record, {"sha256": now})


def result_digests(result: Path) -> list[str]:
    """What tells one result folder from another."""
    return [_digest(result_file(result, name)) for name in (REPORT, RESPONSE, EMITTERS)]


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
    """Write the frames from the first on as ``film.mp4``; None without ffmpeg, for EXR, and while one is missing.

    Raises:
        IrisError: ffmpeg fails.
    """
    ffmpeg = find_ffmpeg()
    finished = frames.all_finished() if ffmpeg is not None and frames.suffix == ".png" else []
    if ffmpeg is None or not finished or finished != list(range(frames.first, frames.first + len(finished))):
        return None
    film, unfinished = frames.folder / "film.mp4", frames.folder / ".film.mp4"
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # H.264 in 4:2:0 has no odd sizes
    command: Sequence[str] = [
        *(ffmpeg, "-y", "-loglevel", "error", "-framerate", str(fps), "-start_number", str(frames.first)),
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
