"""Inspection of a capture before a solve, written as files that Blender's own Python can read.

::

    capture.json     name, root, up, metres_per_unit, warnings, the most that textures take; per photo: file, camera,
                     exposure, luminance by EXIF, share of saturated and black channels, histogram, share of the mesh
                     in view, alignment with it, and what is wrong with it
    mesh.npz         vertices, faces, and uv and regions where the mesh has them
    photos/          photos with the lens distortion taken out, where there was any

capture.json is written last: a folder without it is incomplete.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.files import require_own_folder, write_arrays, write_json
from ..base.images import to_codes, write_png
from ..base.progress import Progress
from ..config import PRESETS, SolveConfig
from ..model.capture import Camera, Capture, Mesh, View, first_of_pose
from ..model.response import SATURATED
from ..model.texture_size import blender_bytes, in_blender
from ..rays.tracer import Tracer
from .alignment import EdgePair, alignment
from .exchanged_photos import exchanged
from .exposures import metered_luminance
from .photos import load_photo
from .reader import MIN_SEEN_SHARE

BLACK_VALUE = 0.5 / 255
HISTOGRAM_BINS = 32
MAX_SATURATED_SHARE = 0.25
"""Of pixels; a photo with more is warned about, unless another of its pose has fewer."""


def inspect(
    capture: Capture, folder: Path, progress: Progress, config: SolveConfig = PRESETS["balanced"]
) -> dict[str, Any]:
    """Measure every training photo of ``capture`` and write ``folder``.

    Args:
        config: of the solve to come.

    Returns:
        The content of capture.json.

    Raises:
        BadInput: a photo cannot be read, or ``folder/photos`` is a link.
        Cancelled: nothing that is in ``folder`` counts.
        IrisError: the disk is full.
    """
    require_own_folder(folder / "photos")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.json").unlink(missing_ok=True)
    tracer = Tracer(capture.mesh)
    rows, photos, poses = [], [], []
    with progress.stage("photos"):
        for index, view in enumerate(capture.views):
            row, (of_photo, of_mesh) = _inspect_view(view, tracer, folder)
            rows.append(row)
            photos.append(of_photo.astype(np.float32))
            poses.append(of_mesh.astype(np.float32))
            progress.update((index + 1) / len(capture.views))
    _write_mesh(folder / "mesh.npz", capture.mesh)
    under_another = exchanged(photos, poses)
    clipped = _clipped([row["saturated"] for row in rows], [view.camera for view in capture.views])
    for k, row in enumerate(rows):
        row["problem"] = _problem(row, rows[under_another[k]]["name"] if k in under_another else None, k in clipped)
    asked = config.texture_size
    content = {
        "name": capture.name,
        "root": capture.root.resolve(),
        "up": capture.up,
        "metres_per_unit": capture.metres_per_unit,
        "warnings": [
            *capture.warnings,
            *_mismatch(capture),
            *_exchanged(rows, under_another),
            *_warnings(rows, clipped),
        ],
        "textures": {
            "side": asked.most,
            "bytes_in_blender": blender_bytes(asked.most),
            "text": f"{'' if asked.side else 'up to '}{in_blender(asked.most)} in Blender",
        },
        "views": rows,
    }
    write_json(folder / "capture.json", content)
    return content


def _inspect_view(view: View, tracer: Tracer, folder: Path) -> tuple[dict[str, Any], EdgePair]:
    """The row of a photo, and the band-passed edges (h, w) of the photo and of the mesh under its pose."""
    photo = load_photo(view)
    shown = view.photo
    if view.distortion is not None and not photo.hdr:
        shown = folder / "photos" / f"{view.name}.png"
        write_png(shown, to_codes(photo.values))
    seen, fit, edges = alignment(view.camera, photo, tracer)
    values = photo.values[photo.valid]
    histogram, _ = (
        np.histogram(values.max(axis=1), HISTOGRAM_BINS, (0.0, 1.0))
        if not photo.hdr
        else (np.zeros(HISTOGRAM_BINS), None)
    )
    camera = view.camera
    return {
        "name": view.name,
        "photo": None if shown is None else shown.resolve(),
        "camera": asdict(camera),
        "exposure": view.exposure,
        "metered": None if view.photo is None else metered_luminance(view.photo),
        "light_state": view.light_state,
        "saturated": 0.0 if photo.hdr else float((values >= SATURATED).any(axis=1).mean()),
        "black": 0.0 if photo.hdr else float((values <= BLACK_VALUE).all(axis=1).mean()),
        "histogram": histogram / max(int(np.sum(histogram)), 1),
        "seen": seen,
        "alignment": asdict(fit),
    }, edges


def _clipped(shares: Sequence[float], cameras: Sequence[Camera]) -> set[int]:
    """Photos with too many saturated pixels that no other photo of their pose, as in a bracket, has fewer of."""
    pose = first_of_pose(cameras)
    least = np.full(len(pose), np.inf)
    np.minimum.at(least, pose, shares)
    return set(np.flatnonzero(least[pose] > MAX_SATURATED_SHARE).tolist())


def _problem(row: dict[str, Any], other: str | None, clipped: bool) -> str:
    """Why the photo of a row should be looked at, empty where it need not be; ``other`` is the photo that it is
    exchanged with."""
    if other is not None:
        return f"it shows what {other} should"
    if row["alignment"]["verdict"] == "shifted":
        return f"it lies {row['alignment']['shift']:.0f} pixels beside the mesh"
    if row["seen"] < MIN_SEEN_SHARE:
        return f"it sees less than {MIN_SEEN_SHARE:.0%} of the mesh"
    return f"{row['saturated']:.0%} of its pixels are saturated" if clipped else ""


def _exchanged(rows: list[dict[str, Any]], found: dict[int, int]) -> list[str]:
    if not found:
        return []
    pairs = _some([f"{rows[k]['name']} shows what {rows[j]['name']} should" for k, j in found.items()])
    return [f"{len(found)} photos lie under the pose of another ({pairs}): check that each photo belongs to its pose"]


def _mismatch(capture: Capture) -> list[str]:
    return [] if capture.mismatch is None else [f"{capture.mismatch.what} — {capture.mismatch.fix}"]


def _warnings(rows: list[dict[str, Any]], clipped: set[int]) -> list[str]:
    warnings = []
    if clipped:
        names = _some([rows[k]["name"] for k in sorted(clipped)])
        warnings.append(
            f"{len(clipped)} of {len(rows)} photos have more than {MAX_SATURATED_SHARE:.0%} saturated pixels "
            f"({names}): expose darker, or add darker photos"
        )
    shifted = [row for row in rows if row["alignment"]["verdict"] == "shifted"]
    if shifted:
        worst = max(row["alignment"]["shift"] for row in shifted)
        warnings.append(
            f"{len(shifted)} of {len(rows)} photos lie up to {worst:.0f} pixels beside the mesh "
            f"({_some([row['name'] for row in shifted])}): look at their overlay, align poses and mesh"
        )
    return warnings


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (" …" if len(names) > 3 else "")


def _write_mesh(path: Path, mesh: Mesh) -> None:
    arrays: dict[str, NDArray] = {"vertices": mesh.vertices, "faces": mesh.faces.astype(np.int32)}
    for name in ("uv", "regions"):
        if getattr(mesh, name) is not None:
            arrays[name] = getattr(mesh, name)
    write_arrays(path, arrays)
