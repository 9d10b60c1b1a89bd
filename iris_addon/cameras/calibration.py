"""One correction of all cameras, under which the photos agree better on the surface.

Each photo is projected onto the mesh; where cameras are wrong, photos of the same place disagree. The disagreement is
measured on small cells of the surface, after a gain per photo, and minimised over five numbers that all photos share.
On correct cameras the minimum lies near no correction, and the acceptance gain keeps them as they are. In a room of
plain and polished surfaces it may lie anywhere; there the local contrast of the photos, by which single poses are
registered, says that the given cameras are better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from ..base.group_by import group_equal, group_means
from ..base.minimise import simplex
from ..base.parallel import over_each
from ..base.progress import Progress
from ..capture.photos import load_photo, photos_at_once
from ..decide import Decisions
from ..model.capture import Camera, Capture, View
from ..model.corrections import CameraCorrection
from ..model.light_states import LightStates
from ..rays.tracer import Tracer
from .registration import disagreement_of_cameras

TRIAL_RAYS = 120_000
"""Rays over all photos that one trial traces."""
FOCAL_TRIALS = (0.8, 0.87, 0.94, 0.97, 1.0, 1.03, 1.06, 1.15, 1.25)
"""Factors of the given focal length that are tried first."""
TRIAL_RATIO = 0.97
"""Disagreement, relative to the given cameras', below which the search goes on from the best trial."""
CELL_SIZE = 0.04
"""Metres; about the footprint of the filtered pixels."""
MIN_SHARED = 1000
"""Sightings of cells that two photos show; fewer do not determine five numbers."""
OUTLIER_LOG = 0.2
"""Log brightness by which a photo differs from the others where it starts to count as an outlier."""
MIN_VALID = 0.5
"""Share of a filtered pixel that must be picture."""
BRIGHTNESS_FLOOR = 0.05
"""Display value added before the logarithm, because shadows are noise."""
SIMPLEX_STEP = np.array([0.03, 0.01, 0.01, 0.02, 0.02])
"""Log focal length, principal point in image widths, offset in metres: first steps of Nelder and Mead's simplex."""
MAX_EVALUATIONS, CORRECTION_TOLERANCE = 120, 1e-3
"""Of the disagreement, at most; and extent of the simplex, in its units, at which the search ends."""
PHOTO_WIDTH = 500
"""Pixels in a row that photos are compared at, at least."""


@dataclass(frozen=True)
class Calibration:
    """The accepted correction and what it rests on.

    Attributes:
        correction: None where the given cameras stay.
        gain: relative fall of the disagreement on held-out pixels.
        unconfirmed: factor on the focal length by which photos agree better in brightness, where they show no point
            whose contrast could confirm it; None elsewhere.
    """

    correction: CameraCorrection | None
    gain: float
    unconfirmed: float | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know."""
        c = self.correction
        if self.unconfirmed is not None:
            return (
                f"photos agree better with a focal length of {self.unconfirmed:.3f} of the given one, but no three of "
                "them show an edge in common that could confirm it, and it stays; check the focal length",
            )
        if c is None:
            return ()
        return (
            f"the photos fit the mesh only with a focal length of {c.focal:.3f} of the given one and the camera "
            f"{1000 * float(np.hypot(*c.offset)):.0f} mm beside its poses; both were corrected",
        )

    def report(self) -> dict[str, Any]:
        """For report.json."""
        correction = None if self.correction is None else self.correction.content()
        return {"correction": correction, "gain": round(self.gain, 4)}


def calibrate(
    capture: Capture,
    tracer: Tracer,
    rng: np.random.Generator,
    progress: Progress,
    decisions: Decisions | None = None,
) -> tuple[Capture, Calibration]:
    """The capture with its training cameras corrected, if held-out pixels and the contrast of points bear that out.

    Only captures of one undistorted camera are corrected: other cameras were calibrated with their poses.

    Args:
        rng: picks the points whose contrast is compared.
        decisions: where the correction is decided.

    Raises:
        BadInput: a photo cannot be read.
    """
    field = np.array([view.camera.fx / view.camera.width for view in capture.views])
    if len(field) < 4 or np.ptp(field) > 1e-3 * field[0] or any(view.distortion for view in capture.views):
        return capture, Calibration(None, 0.0)
    views = [view.reduced_to(PHOTO_WIDTH) for view in capture.views]
    fitted = _Lattice.of(views, 0.25, progress)

    def correction(x: NDArray[np.floating]) -> CameraCorrection:
        return CameraCorrection(
            float(field[0]), float(np.exp(x[0])), (float(x[1]), float(x[2])), (float(x[3]), float(x[4]))
        )

    def disagreement(x: NDArray[np.floating]) -> float:
        return fitted.disagreement(views, correction(x), tracer)

    def watched(x: NDArray[np.floating]) -> float:
        progress.update(0.5)
        return disagreement(x)

    start = np.zeros(5)
    found = over_each(FOCAL_TRIALS, lambda focal: disagreement(np.array([np.log(focal), 0, 0, 0, 0])), progress.update)
    trials = dict(zip(FOCAL_TRIALS, found, strict=True))
    best = min(trials, key=lambda focal: trials[focal])
    if not np.isfinite(trials[1.0]) or trials[best] > TRIAL_RATIO * trials[1.0]:
        return capture, Calibration(None, 0.0)
    start[0] = np.log(best)
    corners = start + np.concatenate([np.zeros((1, 5)), np.diag(SIMPLEX_STEP)])
    found = correction(simplex(watched, corners, CORRECTION_TOLERANCE, evaluations=MAX_EVALUATIONS)[0])
    tested = _Lattice.of(views, 0.75, progress)
    before, after = (tested.disagreement(views, c, tracer) for c in (CameraCorrection(float(field[0])), found))
    if not np.isfinite([before, after]).all():
        return capture, Calibration(None, 0.0)
    gain = 1 - after / max(before, 1e-9)
    decisions = decisions or Decisions()
    corrected = replace(capture, views=tuple(found.view(view) for view in capture.views))
    if not decisions.accept("cameras", before, after):
        return capture, Calibration(None, gain)
    if not decisions.forces("cameras"):
        contrast = disagreement_of_cameras(capture, corrected, tracer, rng, progress)
        if not decisions.accept("cameras_by_contrast", *contrast):
            return capture, Calibration(None, gain, None if np.isfinite(contrast).all() else found.focal)
    return corrected, Calibration(found, gain)


@dataclass(frozen=True)
class _Lattice:
    """Low-pass filtered pixels of every photo on a sparse lattice.

    Attributes:
        i, j: (n,) pixel coordinates, the same in every photo, fractions of the width and of the height.
        brightness: (V, n) log of the mean display value over the lattice's step, NaN where the photo shows nothing.
    """

    i: NDArray[np.float64]
    j: NDArray[np.float64]
    brightness: NDArray[np.float64]

    @staticmethod
    def of(views: Sequence[View], offset: float, progress: Progress) -> _Lattice:
        side = max(4, int(np.sqrt(TRIAL_RAYS / len(views))))
        j, i = ((axis.ravel() + offset) / side for axis in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
        brightness = np.empty((len(views), len(i)))

        def read(index: int) -> None:
            photo = load_photo(views[index])
            height, width = photo.valid.shape
            step = max(1, height // side)
            share = uniform_filter(photo.valid.astype(np.float32), step)
            smooth = uniform_filter(photo.values.mean(-1) * photo.valid, step) / np.maximum(share, MIN_VALID)
            smooth[share < MIN_VALID] = np.nan
            brightness[index] = np.log(smooth[(j * height).astype(int), (i * width).astype(int)] + BRIGHTNESS_FLOOR)

        at_once = photos_at_once(views)
        over_each(range(len(views)), read, lambda share: progress.update(0.5 * share), at_once)
        return _Lattice(i, j, brightness)

    def disagreement(self, views: Sequence[View], correction: CameraCorrection, tracer: Tracer) -> float:
        """Robust mean difference between photos of the same cell, with all cameras under ``correction``."""
        cameras, states = [correction.camera(view.camera) for view in views], LightStates.of(views)
        direction = np.concatenate([self._directions(camera) for camera in cameras])
        origin = np.repeat(np.array([camera.position for camera in cameras], np.float32), len(self.i), axis=0)
        hits = tracer.closest(origin, direction)
        on = np.flatnonzero((hits.face >= 0) & np.isfinite(self.brightness.ravel()))
        point = origin[on] + direction[on] * hits.distance[on, None]
        cell, photo = _cells(point, tracer.normals[hits.face[on]], direction[on]), on // len(self.i)
        cell = cell * len(states) + states.index[photo]  # photos of different light states are not compared
        return _spread(cell, photo, self.brightness.ravel()[on], len(views))

    def _directions(self, camera: Camera) -> NDArray[np.float32]:
        """(n, 3) unit directions through the pixels of one photo."""
        x = ((self.i * camera.width).astype(int) + 0.5 - camera.cx) / camera.fx
        y = ((self.j * camera.height).astype(int) + 0.5 - camera.cy) / camera.fy
        direction = np.stack([x, -y, -np.ones_like(x)], -1) @ camera.c2w[:3, :3].T
        return (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)


def _cells(
    point: NDArray[np.floating], normal: NDArray[np.floating], direction: NDArray[np.floating]
) -> NDArray[np.int64]:
    """(n,) cell of the surface of each hit: a cube of space and the axis nearest to the normal."""
    facing = np.where((normal * direction).sum(1, keepdims=True) > 0, -normal, normal)
    axis = np.abs(facing).argmax(1)
    side = 2 * axis + (np.take_along_axis(facing, axis[:, None], 1)[:, 0] > 0)
    cube = np.floor(point / CELL_SIZE).astype(np.int64) % (1 << 15)
    return ((cube[:, 0] << 33) ^ (cube[:, 1] << 18) ^ (cube[:, 2] << 3)) + side


def _spread(cell: NDArray[np.int64], photo: NDArray[np.int64], value: NDArray[np.floating], n_photos: int) -> float:
    """Cauchy loss of log brightness around one mean per cell, with one gain per photo.

    It is relative to the loss around one mean of all cells; otherwise cameras that see less of the room would seem to
    agree better. Infinite where photos share fewer than MIN_SHARED sightings.

    Args:
        cell, photo, value: (n,) cell, photo and log brightness of each sighting.
    """
    seen = group_equal(cell * n_photos + photo)
    value = group_means(value[:, None], seen.group, len(seen.keys))[:, 0]
    photo, cells = seen.keys % n_photos, group_equal(seen.keys // n_photos)
    shared = cells.count[cells.group] >= 2
    if np.count_nonzero(shared) < MIN_SHARED:
        return np.inf
    value, photo = value[shared], photo[shared]
    cell = np.cumsum(cells.count >= 2)[cells.group[shared]] - 1
    gain, weight, off = np.zeros(n_photos), np.ones(len(value)), np.zeros(len(value))
    level = value
    for _ in range(6):
        level = value - gain[photo]
        mean = np.bincount(cell, weight * level) / np.bincount(cell, weight)
        off = (level - mean[cell]) / OUTLIER_LOG
        weight = 1 / (1 + off**2)
        shift = np.bincount(photo, weight * off, n_photos) / np.maximum(np.bincount(photo, weight, n_photos), 1e-9)
        gain += OUTLIER_LOG * shift
    apart = (level - np.median(level)) / OUTLIER_LOG
    return float(np.log1p(off**2).mean() / max(np.log1p(apart**2).mean(), 1e-9))
