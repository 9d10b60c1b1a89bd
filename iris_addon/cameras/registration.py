"""A correction of each camera's pose, under which the photos agree better on the surface.

Poses of a scan drift by pixels, and the content of a photo is then projected beside its place. After Zhou & Koltun 2014
(Color Map Optimization for 3D Reconstruction with Consumer Depth Cameras): each point of the surface takes the mean of
the photos, each photo is moved towards these means (Gauss-Newton over six numbers), in turns and from coarse to fine.
The photos are compared by local contrast, which does not depend on exposure or smooth shading, within each light state:
shadows depend on which lamps are on. On correct poses there is little to gain on held-out points, and the acceptance
gain keeps them as they are. Where it is more, because photos show reflections or a clipped sky, whose contrast moves
with the camera, the points that agree better are few: an error of the poses shows at most points.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from ..base.parallel import over_blocks, over_each
from ..base.progress import Progress
from ..capture.photos import load_photo, photos_at_once, shrink
from ..decide import Decisions
from ..model.capture import Camera, Capture, View
from ..model.corrections import PoseCorrections, rigid, twist
from ..model.light_states import LightStates
from ..rays.tracer import Tracer, points_on_faces

N_POINTS = 24_000
"""Points of the surface that are projected into all photos; every second one is held out."""
MAX_SIGHTINGS = 300_000
"""Of either half; beyond, points are left out, so that hundreds of photos take seconds and not minutes."""
WIDTHS = (100, 250, 500)
"""Pixels in a row of the photos on each level."""
ROUNDS = (8, 5, 5)
"""Turns of means and poses on each level."""
TRIAL_ROUNDS = 3
"""Turns on the first level after which the search goes on or ends."""
TRIAL_RATIO = 0.96
"""Disagreement, relative to the given poses', below which the search goes on after TRIAL_ROUNDS."""
BLUR, SURROUND_BLUR = 1.0, 5.0
"""Pixels of a level: local contrast is the difference of two blurs."""
BRIGHTNESS_FLOOR = 0.05
"""Display value added before the logarithm, because shadows are noise."""
CLIPPED_VALUE = 0.98
"""Display value from which a pixel counts as clipped."""
MIN_USABLE = 0.9
"""Share of the pixels around one that must be valid and unclipped."""
OUTLIER_LOG = 0.1
"""Difference of local contrast, natural log of brightness, from which a sighting counts as an outlier."""
POSE_STD = np.array([0.01, 0.01, 0.01, 0.02, 0.02, 0.02])
"""Radians and metres, standard deviation of the error of given poses."""
POSE_PRIOR = 5.0
"""Weight of a pose that is off by POSE_STD, in sightings that are off by OUTLIER_LOG."""
TELLING_LOSS = 0.02
"""Mean loss of a point, under either poses, from which it tells which are better: plain walls agree under all."""
MIN_COSINE = 0.25
"""Smallest cosine to the normal at which a surface is compared."""
DEPTH_TOLERANCE = 0.01
"""Metres, and per metre of distance, between a point and the hit of its ray up to which the point is visible."""
DEPTH_WIDTH = 80
"""Pixels in a row of the depth maps in which edges are looked for."""
DEPTH_EDGE = 0.08
"""Relative step of depth that is an edge; beside one, a pose that is off shows the wrong side of it."""
MARGIN = 0.01
"""Border of a photo that is left out, in image widths: under another pose it may lie outside."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Registration:
    """The accepted corrections, None where the given poses stay, and their gain on held-out points."""

    corrections: PoseCorrections | None
    gain: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know."""
        if self.corrections is None:
            return ()
        angle, distance = np.median(self.corrections.sizes(), axis=0)
        return (
            f"the photos agree on the mesh only with their poses moved by {np.degrees(angle):.1f}° and "
            f"{1000 * distance:.0f} mm (medians), and so they were",
        )

    def report(self) -> dict[str, Any]:
        """For report.json."""
        poses = None if self.corrections is None else self.corrections.content()
        return {"poses": poses, "poses_gain": round(self.gain, 4)}


def register(
    capture: Capture,
    tracer: Tracer,
    rng: np.random.Generator,
    progress: Progress,
    decisions: Decisions | None = None,
) -> tuple[Capture, Registration]:
    """The capture with its training cameras corrected one by one, if held-out points bear the corrections out.

    Args:
        decisions: where the corrections are decided.

    Raises:
        BadInput: a photo cannot be read.
    """
    decisions = decisions or Decisions()
    forced = decisions.forces("poses")
    small = [view.reduced_to(WIDTHS[-1]) for view in capture.views]
    given, states = [view.camera for view in small], LightStates.of(small)
    photos = _brightness(small, progress)
    fitted, held_out = SurfacePoints.of(given, tracer, N_POINTS, rng).halves()
    seen, test = (_Sightings.of(points, given, states, tracer, rng) for points in (fitted, held_out))
    found, before, of_given = given, 0.0, np.zeros(0)
    for level, (width, rounds) in enumerate(zip(WIDTHS, ROUNDS, strict=True)):
        pictures = _pictures(photos, width)
        if level:
            seen = _Sightings.of(fitted, found, states, tracer, rng)
        if level in (0, len(WIDTHS) - 1):  # the levels that end in a comparison
            of_given = test.losses(pictures, given)
            before = _mean(of_given)
        for turn in range(rounds):
            progress.update((level + turn / rounds) / len(WIDTHS))
            found = seen.turn(pictures, given, found)
            tried = level == 0 and turn + 1 == TRIAL_ROUNDS and not forced
            if tried and not test.disagreement(pictures, found) < TRIAL_RATIO * before:
                return capture, Registration(None, 0.0)
    of_found = test.losses(pictures, found)
    after = _mean(of_found)
    gain = 1 - after / before if before > 0 else 0.0
    accepted = decisions.accept("poses", before, after)
    if not (accepted and (forced or decisions.accept("poses_of_most", 0.5, test.share_worse(of_given, of_found)))):
        return capture, Registration(None, gain)
    turned = (replace(view.camera, c2w=camera.c2w) for view, camera in zip(capture.views, found, strict=True))
    views = tuple(replace(view, camera=camera) for view, camera in zip(capture.views, turned, strict=True))
    return replace(capture, views=views), Registration(PoseCorrections.between(given, found), gain)


def photo_disagreement(
    capture: Capture, tracers: Sequence[Tracer], rng: np.random.Generator, progress: Progress
) -> list[float]:
    """Mean Cauchy loss of the local contrast that photos show at points of a surface around their mean, per surface.

    Photos of different light states, whose shadows differ, are not compared.

    Args:
        tracers: of the surfaces; ``rng`` puts points behind the same pixels of each.

    Raises:
        BadInput: a photo cannot be read.
    """
    views = [view.reduced_to(WIDTHS[-1]) for view in capture.views]
    cameras = [view.camera for view in views]
    states = LightStates.of(views)
    pictures = _pictures(_brightness(views, progress), WIDTHS[-1])
    losses = []
    for tracer in tracers:
        same = deepcopy(rng)
        points = SurfacePoints.of(cameras, tracer, N_POINTS, same)
        seen = _Sightings.of(points, cameras, states, tracer, same)
        losses.append(seen.disagreement(pictures, cameras))
    return losses


def disagreement_of_cameras(
    given: Capture, found: Capture, tracer: Tracer, rng: np.random.Generator, progress: Progress
) -> tuple[float, float]:
    """Mean Cauchy loss of the local contrast that photos show at points of a surface around their mean, with the
    cameras of ``given`` and of ``found``, at the points that the latter see; NaN where no three of them see one.

    Raises:
        BadInput: a photo cannot be read.
    """
    views = [view.reduced_to(WIDTHS[-1]) for view in found.views]
    before = [view.reduced_to(WIDTHS[-1]).camera for view in given.views]
    after = [view.camera for view in views]
    points = SurfacePoints.of(after, tracer, N_POINTS, rng)
    seen = _Sightings.of(points, after, LightStates.of(views), tracer, rng)
    pictures = _pictures(_brightness(views, progress), WIDTHS[-1])
    losses = np.stack([seen.losses(pictures, cameras) for cameras in (before, after)])
    known = np.isfinite(losses).all(0)
    smaller, larger = losses[:, known].mean(1) if known.any() else (np.nan, np.nan)
    return float(smaller), float(larger)


def _brightness(views: Sequence[View], progress: Progress) -> list[NDArray[np.floating]]:
    """Per photo (h, w, 2) log brightness and the usable share of each pixel, at the finest width."""

    def read(view: View) -> NDArray[np.floating]:
        photo = load_photo(view)
        brightness = np.maximum(photo.values.mean(-1), 0)
        if photo.hdr:
            brightness = brightness / max(3 * float(np.median(brightness)), 1e-9)
        usable = photo.valid & (photo.hdr | (photo.values.max(-1) < CLIPPED_VALUE))
        return _shrunk(np.stack([np.log(brightness + BRIGHTNESS_FLOOR), usable], -1), WIDTHS[-1])

    return over_each(views, read, lambda _share: progress.update(0.0), photos_at_once(views))


def _shrunk(image: NDArray[np.floating], width: int) -> NDArray[np.floating]:
    """``image`` (h, w, C) with at most ``width`` pixels in a row."""
    if image.shape[1] <= width:
        return image
    return shrink(image, max(2, round(image.shape[0] * width / image.shape[1])), width)


def _pictures(photos: Sequence[NDArray[np.floating]], width: int) -> list[NDArray[np.float32]]:
    """Per photo (h, w, 3) local contrast and its derivatives by image coordinates in widths; NaN where not usable."""

    def draw(photo: NDArray[np.floating]) -> NDArray[np.float32]:
        log, usable = np.moveaxis(_shrunk(photo, width), -1, 0)
        contrast = gaussian_filter(log, BLUR) - gaussian_filter(log, SURROUND_BLUR)
        down, right = np.gradient(contrast)
        picture = np.stack([contrast, right * log.shape[1], down * log.shape[1]], -1)
        picture[gaussian_filter(usable, BLUR) < MIN_USABLE] = np.nan
        return picture.astype(np.float32)

    return over_each(photos, draw)


@dataclass(frozen=True)
class _Sightings:
    """Points of the surface in photos: m sightings, sorted by photo. Under another light a point is another point.

    Attributes:
        position: (n, 3) of the points.
        point: (m,) of each sighting.
        rows: its slice of the sightings, per photo.
    """

    position: Floats
    point: NDArray[np.int64]
    rows: Sequence[slice]

    @staticmethod
    def of(
        points: SurfacePoints,
        cameras: Sequence[Camera],
        states: LightStates,
        tracer: Tracer,
        rng: np.random.Generator,
    ) -> _Sightings:
        """Sightings by ``cameras`` of those ``points`` that at least three of one light state see, MAX_SIGHTINGS at
        most."""
        n = len(states)
        seen = [
            seen_points(points, camera, tracer) * n + state for camera, state in zip(cameras, states.index, strict=True)
        ]
        often = np.bincount(np.concatenate(seen), minlength=n * len(points.position)) >= 3
        total = sum(int(often[index].sum()) for index in seen)
        often &= rng.random(len(often)) * total < MAX_SIGHTINGS
        seen = [index[often[index]] for index in seen]
        ends = np.cumsum([0, *map(len, seen)])
        rows = [slice(start, stop) for start, stop in pairwise(ends)]
        used, point = np.unique(np.concatenate(seen), return_inverse=True)
        return _Sightings(points.position[used // n], point, rows)

    def disagreement(self, pictures: Sequence[NDArray[np.float32]], cameras: Sequence[Camera]) -> float:
        """Mean Cauchy loss of the contrast that photos show at a point around their mean; 0 without sightings."""
        return _mean(self.losses(pictures, cameras))

    def losses(self, pictures: Sequence[NDArray[np.float32]], cameras: Sequence[Camera]) -> Floats:
        """(m,) Cauchy loss of the contrast of each sighting, NaN where it is not usable."""
        _, off = self._against_means(self._look(pictures, cameras)[0])
        return np.log1p(off**2)

    def share_worse(self, smaller: Floats, larger: Floats) -> float:
        """Share of the points that tell poses apart whose sightings have the greater mean of the losses ``larger``
        (m,) than of ``smaller``; 1 without such points."""
        both = np.isfinite(smaller) & np.isfinite(larger)
        point, n = self.point[both], len(self.position)
        seen = np.maximum(np.bincount(point, minlength=n), 1)
        before, after = (np.bincount(point, losses[both], n) / seen for losses in (smaller, larger))
        telling = np.maximum(before, after) > TELLING_LOSS
        return float((after >= before)[telling].mean()) if telling.any() else 1.0

    def turn(
        self, pictures: Sequence[NDArray[np.float32]], given: Sequence[Camera], cameras: Sequence[Camera]
    ) -> list[Camera]:
        """``cameras`` after one Gauss-Newton step towards the means, with a prior on the poses ``given``.

        All photos and means move at once: moved one by one, photos that agree with each other would hold each other in
        place.
        """
        value, slope = self._look(pictures, cameras)
        weight, off = np.nan_to_num(self._against_means(value))
        jacobian = np.where(weight[:, None] > 0, slope * (POSE_STD / OUTLIER_LOG), 0.0)
        weighted = weight[:, None] * jacobian
        n, size = len(self.position), 6 * len(cameras)
        of_points = np.zeros((n, len(cameras), 6), np.float32)
        hessian, gradient = POSE_PRIOR * np.eye(size), np.zeros(size)
        for k, (camera, expected, rows) in enumerate(zip(cameras, given, self.rows, strict=True)):
            own = slice(6 * k, 6 * k + 6)
            of_points[self.point[rows], k] = weighted[rows]
            hessian[own, own] += weighted[rows].T @ jacobian[rows]
            so_far = twist(np.linalg.inv(expected.c2w) @ camera.c2w) / POSE_STD
            gradient[own] = off[rows] @ weighted[rows] + POSE_PRIOR * so_far
        total = np.maximum(np.bincount(self.point, weight, n), 1e-9).astype(np.float32)
        by_mean = of_points.reshape(n, size) / np.sqrt(total)[:, None]
        steps = np.linalg.solve(hessian - by_mean.T @ by_mean, -gradient).reshape(-1, 6) * POSE_STD
        return [replace(camera, c2w=camera.c2w @ rigid(step)) for camera, step in zip(cameras, steps, strict=True)]

    def _look(
        self, pictures: Sequence[NDArray[np.float32]], cameras: Sequence[Camera]
    ) -> tuple[Floats, NDArray[np.float64]]:
        """Contrast (m,) at the points, and its derivatives (m, 6) by the twist of the camera in its own frame."""
        value, slope = np.empty(len(self.point)), np.empty((len(self.point), 6))

        def look(index: int) -> None:
            camera, rows = cameras[index], self.rows[index]
            local = camera.local(self.position[self.point[rows]])
            seen = _interpolated(pictures[index], camera.project(local) / camera.width)
            # u = f x / depth, v = -f y / depth; if the camera moves by t and turns by r, the point q of its frame goes
            # to q - t - r x q.
            depth = -local[:, 2]
            du, dv = seen[:, 1] * camera.fx / camera.width, seen[:, 2] * camera.fy / camera.width
            by_depth = (du * local[:, 0] - dv * local[:, 1]) / depth
            by_point = np.stack([du, -dv, by_depth], -1) / depth[:, None]
            value[rows], slope[rows, :3], slope[rows, 3:] = seen[:, 0], -np.cross(local, by_point), -by_point

        over_blocks(len(cameras), 1, lambda one: look(one.start))
        return value, slope

    def _against_means(self, value: Floats) -> tuple[Floats, Floats]:
        """Weight (m,) of each sighting and its difference from the robust mean of its point, in OUTLIER_LOG."""
        known = np.isfinite(value)
        n, point, shown = len(self.position), self.point[known], value[known]
        weight, off = np.ones(len(shown)), np.zeros(len(shown))
        for _ in range(3):
            mean = np.bincount(point, weight * shown, n) / np.maximum(np.bincount(point, weight, n), 1e-9)
            off = (shown - mean[point]) / OUTLIER_LOG
            weight = 1 / (1 + off**2)
        both = np.full((2, len(value)), np.nan)
        both[:, known] = weight, off
        return both[0], both[1]


def _mean(losses: Floats) -> float:
    """Mean of the losses (m,) that are known; 0 without any."""
    known = losses[np.isfinite(losses)]
    return float(known.mean()) if len(known) else 0.0


def _interpolated(picture: NDArray[np.float32], at: Floats) -> NDArray[np.float32]:
    """(n, C) bilinear values of ``picture`` (h, w, C) at image coordinates in widths; NaN outside."""
    height, width, _ = picture.shape
    x, y = at[:, 0] * width - 0.5, at[:, 1] * width - 0.5
    inside = (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    i, j = x.astype(np.int64), y.astype(np.int64)
    s, t = (x - i)[:, None], (y - j)[:, None]
    top = picture[j, i] * (1 - s) + picture[j, i + 1] * s
    bottom = picture[j + 1, i] * (1 - s) + picture[j + 1, i + 1] * s
    values = (top * (1 - t) + bottom * t).astype(np.float32)
    values[~inside] = np.nan
    return values


# ---- Points of the surface ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SurfacePoints:
    """Points of the surface that photos show.

    Attributes:
        position: (n, 3) metres.
        normal: (n, 3) unit.
    """

    position: Floats
    normal: NDArray[np.floating]

    @staticmethod
    def of(cameras: Sequence[Camera], tracer: Tracer, n: int, rng: np.random.Generator) -> SurfacePoints:
        """About ``n`` points, behind as many random pixels of every photo."""
        positions, normals = [], []
        for camera in cameras:
            rays = camera.rays(rng.integers(camera.width * camera.height, size=-(-n // len(cameras))))
            hits = tracer.closest(*rays)
            face = hits.face[hits.face >= 0]
            positions.append(points_on_faces(tracer.corners, face, hits.barycentric[hits.face >= 0]))
            normals.append(tracer.normals[face])
        return SurfacePoints(np.concatenate(positions), np.concatenate(normals))

    def halves(self) -> tuple[SurfacePoints, SurfacePoints]:
        """Every second point, and the others."""
        first, second = (SurfacePoints(self.position[k::2], self.normal[k::2]) for k in (0, 1))
        return first, second


def seen_points(points: SurfacePoints, camera: Camera, tracer: Tracer) -> NDArray[np.int64]:
    """Indices of the points that a photo shows well: not at grazing angles, its border or edges of depth."""
    local = camera.local(points.position)
    ahead = np.flatnonzero(local[:, 2] < -1e-3)
    at = camera.project(local[ahead])
    margin = MARGIN * camera.width
    size = np.array([camera.width, camera.height])
    inside = ((at > margin) & (at < size - margin)).all(1)
    index, at = ahead[inside], at[inside]
    sight = points.position[index] - camera.position
    distance = np.linalg.norm(sight, axis=1)
    direction = sight / distance[:, None]
    facing = np.abs((direction * points.normal[index]).sum(1)) > MIN_COSINE
    index, at, distance, direction = index[facing], at[facing], distance[facing], direction[facing]
    hit = tracer.closest(np.broadcast_to(camera.position, direction.shape), direction).distance
    small = camera.shrunk(DEPTH_WIDTH)
    column, row = (np.minimum(at * (small.width / camera.width), (small.width - 1, small.height - 1))).astype(int).T
    clear = (np.abs(hit - distance) < DEPTH_TOLERANCE * (1 + distance)) & ~_beside_edges(small, tracer)[row, column]
    return index[clear]


def _beside_edges(camera: Camera, tracer: Tracer) -> NDArray[np.bool_]:
    """(H, W) whether depth has an edge beside a pixel; borders of the mesh are edges too."""
    distance = tracer.closest(*camera.rays()).distance.reshape(camera.height, camera.width)
    return ~(maximum_filter(distance, 3) < (1 + DEPTH_EDGE) * minimum_filter(distance, 3))
