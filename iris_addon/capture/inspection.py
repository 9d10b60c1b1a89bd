"""Inspection of a capture before a solve, written as files that Blender's own Python can read.

::

    capture.json     name, root, up, warnings; per photo: file, camera, exposure, share of saturated and black
                     channels, histogram, share of the mesh in view, alignment with it
    mesh.npz         vertices, faces, and uv and regions where the mesh has them
    photos/          photos with the lens distortion taken out, where there was any

capture.json is written last: a folder without it is incomplete.

The alignment of a photo with the mesh compares edges of the photo with edges of the geometry seen from its camera. Both
are drawn small, blurred and correlated under all shifts of a few pixels. A correct pose has its highest correlation at
no shift, a wrong one elsewhere, at a distance that tells its error. Where all edges of the photo are texture, or the
mesh has no edges in view, there is no clear peak, and the alignment is unclear.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..base.files import require_own_folder, write_arrays, write_json
from ..base.images import to_codes, write_png
from ..base.progress import Progress
from ..model.capture import Camera, Capture, FloatArray, Mesh, Photo, View
from ..model.response import SATURATED
from ..rays.tracer import Tracer
from .photos import load_photo, shrink

BLACK_VALUE = 0.5 / 255
HISTOGRAM_BINS = 32
MAX_SATURATED_SHARE = 0.25
"""Of pixels; a photo with more is warned about."""
ALIGN_WIDTH = 160
"""Pixels in a row of the photo and the geometry that are compared."""
ALIGN_REACH = 12
"""Largest shift that is tried, in pixels of that width."""
ALIGN_TOLERANCE = 1.5
"""A peak within this many of those pixels counts as no shift."""
ALIGN_PEAK_STD = 3.5
"""Standard deviations of all correlations by which a peak must exceed their mean to be clear."""
NORMAL_EDGE = 0.5
"""Change of the normal between neighbours, as a distance of unit vectors, that counts as a full edge."""
DEPTH_EDGE = 0.05
"""Relative bend of the inverse depth between neighbours that counts as a full edge; 0 on any plane."""

Verdict = Literal["aligned", "shifted", "unclear"]


@dataclass(frozen=True)
class Alignment:
    """Result for one photo.

    Attributes:
        score: correlation of the edges at no shift, -1 to 1.
        shift: distance of the best shift in pixels of the photo.
        verdict: "aligned", "shifted" by ``shift``, or "unclear".
    """

    score: float
    shift: float
    verdict: Verdict


def inspect(capture: Capture, folder: Path, progress: Progress) -> dict[str, Any]:
    """Measure every training photo of ``capture`` and write ``folder``.

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
    rows = []
    with progress.stage("photos"):
        for index, view in enumerate(capture.views):
            rows.append(_inspect_view(view, tracer, folder))
            progress.update((index + 1) / len(capture.views))
    _write_mesh(folder / "mesh.npz", capture.mesh)
    content = {
        "name": capture.name,
        "root": capture.root.resolve(),
        "up": capture.up,
        "warnings": [*capture.warnings, *_warnings(rows)],
        "views": rows,
    }
    write_json(folder / "capture.json", content)
    return content


def _inspect_view(view: View, tracer: Tracer, folder: Path) -> dict[str, Any]:
    photo = load_photo(view)
    shown = view.photo
    if view.distortion is not None and not photo.hdr:
        shown = folder / "photos" / f"{view.name}.png"
        write_png(shown, to_codes(photo.values))
    seen, alignment = _alignment(view.camera, photo, tracer)
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
        "saturated": 0.0 if photo.hdr else float((values >= SATURATED).any(axis=1).mean()),
        "black": 0.0 if photo.hdr else float((values <= BLACK_VALUE).all(axis=1).mean()),
        "histogram": histogram / max(int(np.sum(histogram)), 1),
        "seen": seen,
        "alignment": asdict(alignment),
    }


def _alignment(camera: Camera, photo: Photo, tracer: Tracer) -> tuple[float, Alignment]:
    """Share of the photo that shows the mesh, and the alignment of its edges with those of the mesh."""
    small = camera.shrunk(ALIGN_WIDTH)
    origins, directions = small.rays()
    hits = tracer.closest(origins, directions)
    met = hits.face >= 0
    along = hits.distance * (directions @ -small.c2w[:3, 2])
    depth = np.where(met, along, np.inf).reshape(small.height, small.width)
    normal = np.where(met[:, None], tracer.normals[hits.face], 0.0).reshape(small.height, small.width, 3)
    values = photo.values / np.quantile(photo.values, 0.99) if photo.hdr else photo.values
    values = shrink(np.clip(values, 0, 1), small.height, small.width)
    return float(met.mean()), align(values, depth, normal, camera.width / small.width)


def _warnings(rows: list[dict[str, Any]]) -> list[str]:
    warnings = []
    clipped = [row["name"] for row in rows if row["saturated"] > MAX_SATURATED_SHARE]
    if clipped:
        warnings.append(
            f"{len(clipped)} of {len(rows)} photos have more than {MAX_SATURATED_SHARE:.0%} saturated pixels "
            f"({_some(clipped)}): expose darker, or add darker photos"
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


# ---- Alignment ------------------------------------------------------------------------------------------------------


def align(photo: FloatArray, depth: FloatArray, normal: FloatArray, pixels: float) -> Alignment:
    """Compare a small photo (h, w, 3) with depth (h, w) and normal (h, w, 3) of the mesh from its camera.

    Args:
        pixels: how many pixels of the photo one small pixel is wide.
    """
    a = gaussian_filter(photo_edges(photo), 1.0)
    b = gaussian_filter(geometry_edges(depth, normal), 1.0)
    # High-passed: broad brightness of either edge map correlates with anything.
    a, b = a - gaussian_filter(a, 8.0), b - gaussian_filter(b, 8.0)
    energy = np.sqrt((a**2).sum() * (b**2).sum())
    if energy < 1e-9:
        return Alignment(0.0, 0.0, "unclear")
    reach = min(ALIGN_REACH, min(a.shape) // 4)
    full = np.fft.irfft2(np.fft.rfft2(a) * np.conj(np.fft.rfft2(b)), a.shape) / energy
    near = np.roll(full, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    row, column = np.unravel_index(np.argmax(near), near.shape)
    shift = float(np.hypot(row - reach, column - reach))
    clear = near.max() - near.mean() > ALIGN_PEAK_STD * near.std()
    verdict: Verdict = "unclear" if not clear else "aligned" if shift <= ALIGN_TOLERANCE else "shifted"
    return Alignment(float(near[reach, reach]), shift * pixels, verdict)


def geometry_edges(depth: FloatArray, normal: FloatArray) -> NDArray[np.float64]:
    """(H, W) strength 0 to 1 of silhouettes and creases.

    Args:
        depth: (H, W) along the view axis, metres; inf where no surface is seen.
        normal: (H, W, 3) unit, zero where no surface is seen.
    """
    inverse = np.where(np.isfinite(depth), 1.0 / np.maximum(depth, 1e-6), 0.0)
    smooth = gaussian_filter(normal, (1.0, 1.0, 0))  # the facets of a scan are no edges
    strength = np.zeros(depth.shape)
    for axis in (0, 1):
        # Inverse depth is linear across the image of a plane, so that its second difference is zero there.
        bend = np.abs(np.diff(inverse, 2, axis=axis))
        middle = np.take(inverse, np.arange(1, inverse.shape[axis] - 1), axis=axis)
        jump = np.clip(bend / np.maximum(middle, 1e-6) / DEPTH_EDGE, 0, 1)
        turn = np.clip(np.linalg.norm(np.diff(smooth, axis=axis), axis=-1) / NORMAL_EDGE, 0, 1)
        inner = [slice(None), slice(None)]
        inner[axis] = slice(1, -1)
        strength[tuple(inner)] = np.maximum(strength[tuple(inner)], jump)
        inner[axis] = slice(0, -1)
        strength[tuple(inner)] = np.maximum(strength[tuple(inner)], turn)
    return strength


def photo_edges(values: FloatArray) -> NDArray[np.float64]:
    """(h, w) strength 0 to 1 of the gradient of display values (h, w, 3)."""
    grey = np.asarray(values, float) @ (0.2126, 0.7152, 0.0722)
    rows, columns = np.gradient(grey)
    strength = np.hypot(rows, columns)
    return np.clip(strength / max(float(np.quantile(strength, 0.97)), 1e-3), 0, 1)
