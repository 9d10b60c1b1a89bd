"""Do photos and mesh share one frame? Measured over the whole capture, and mended where the mend is clear.

Tools exchange poses and meshes under different conventions: which axis is up, the unit, and what the columns of a pose
mean. A capture whose poses and mesh differ in one of them looks like a capture, and solves to nonsense.

The fit of a capture is the height of one peak. Each photo's correlation of edges under all shifts
(:mod:`iris_addon.capture.alignment`) is divided by its own standard deviation, and the photos are averaged: what does
not belong together cancels out, while a peak near no shift that the photos share stays. Over 16 photos it is 10 to 12
for renders, 4 to 7 for scans with estimated poses, and 0.5 to 3 for wrong frames (experiment 0140).

Mends are turns of the axes, units and pose conventions. Where none is clear, the similarities that bring the sparse
points of the capture onto the mesh are measured by the same fit (:mod:`iris_addon.capture.points_to_mesh`); without
such points, those of its photos (:mod:`iris_addon.capture.seen_points`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import over_each
from ..model.capture import Camera, FloatArray, Mesh, View
from ..rays.tracer import Tracer
from .alignment import ALIGN_WIDTH, band, correlation, geometry_edges, near_no_shift, seen_geometry, shown_edges
from .photo_files import SIDEWAYS, UPRIGHT, read_orientation
from .photos import load_photo, photos_at_once
from .points_to_mesh import find_similarities
from .seen_points import seen_points
from .similarity import Similarity

FRAME_PHOTOS = 16
"""Photos, spread over the capture, that its fit is measured on."""
SEARCH_PHOTOS, SEARCH_WIDTH = 8, ALIGN_WIDTH // 2
"""Photos, and pixels in a row of them, on which combinations of mends are tried first."""
FINALISTS = 4
"""Mends that are measured as finely as the frame they would replace."""
SHARPENING = (0.008, 0.004, 0.002)
"""Steps, in radians, logarithm of the scale and extents of the mesh, by which a similarity of noisy points is moved to
where the edges fit best."""
CLEAR_PEAK = 3.5
"""Fit from which a frame is right: nothing else is tried, and a mend is clear."""
MEND_FACTOR = 1.8
"""Multiple of the fit without a mend that it must reach to be clear."""
MISMATCH_PEAK = 2.0
"""Fit below which photos and mesh do not belong together."""
MIN_PHOTOS, MIN_WIDTH = 4, 64
"""Photos that show edges of the mesh's size, and pixels in a row, below which nothing is concluded."""
MIN_SEEN = 0.05
"""Share of the pixels that must show the mesh for photos and mesh to belong together."""
MAX_PATH, MIN_PATH = 4.0, 1e-3
"""Length of the cameras' path in extents of the mesh for a unit to be possible."""
ROOM_SIZE = (0.4, 60.0)
"""Metres; median distance of a room's vertices from their middle."""

Rotation = NDArray[np.float64]


@dataclass(frozen=True)
class Convention:
    """What a pose matrix of a file may mean beside ours.

    Attributes:
        name: for messages.
        camera_to_world: our (4, 4) matrix, given the file's.
    """

    name: str
    camera_to_world: Callable[[FloatArray], FloatArray]


_DOWN_FORWARD, _LEFT_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, -1.0, 1.0])


def _transposed(pose: FloatArray) -> FloatArray:
    turned = pose.copy()
    turned[:3, :3] = pose[:3, :3].T
    return turned


OURS = Convention("camera to world, x right, y up, z backward", lambda pose: pose)
CONVENTIONS = (
    Convention("camera to world with OpenCV's axes (y down, z forward)", lambda pose: pose @ _DOWN_FORWARD),
    Convention("world to camera with OpenCV's axes", lambda pose: np.linalg.inv(pose) @ _DOWN_FORWARD),
    Convention("world to camera", np.linalg.inv),
    Convention("camera to world with transposed rotations", _transposed),
    Convention("camera to world with transposed rotations of OpenCV's axes", lambda p: _transposed(p) @ _DOWN_FORWARD),
    Convention("camera to world with FIPT's axes (x left, z forward)", lambda pose: pose @ _LEFT_FORWARD),
)
UNITS = {"millimeters": 0.001, "centimeters": 0.01, "inches": 0.0254, "feet": 0.3048}
"""Metres."""


@dataclass(frozen=True)
class Mend:
    """How poses and mesh of a file are brought into one frame.

    Attributes:
        rotation: (3, 3) from the axes of the mesh to those of the poses.
        scale: unit of the mesh in units of the poses.
        convention: what the poses mean.
    """

    rotation: Rotation
    scale: float = 1.0
    convention: Convention = OURS

    def camera(self, camera: Camera) -> Camera:
        """The camera in the frame and unit of the mesh."""
        pose = np.eye(4)
        given = self.convention.camera_to_world(camera.c2w)
        pose[:3, :3] = self.rotation.T @ given[:3, :3]
        pose[:3, 3] = self.rotation.T @ given[:3, 3] / self.scale
        return replace(camera, c2w=pose)

    @property
    def steps(self) -> int:
        """How many conventions differ."""
        return (not np.array_equal(self.rotation, np.eye(3))) + (self.scale != 1) + (self.convention is not OURS)

    def describe(self) -> str:
        """What is done, for a message."""
        done = []
        if self.convention is not OURS:
            done.append(f"the poses are taken as {self.convention.name}")
        if not np.array_equal(self.rotation, np.eye(3)):
            done.append(f"the mesh is turned (x, y, z) → ({axes(self.rotation)})")
        if self.scale != 1:
            done.append(f"the mesh is taken in {_unit_names(self.scale)}")
        return " and ".join(done)


NOTHING = Mend(np.eye(3))
Found = tuple[Mend | Similarity, "FrameFit"]
"""What brings photos and mesh together best, and their fit then."""


@dataclass(frozen=True)
class FrameFit:
    """How well photos and mesh fit.

    Attributes:
        peak: height of the common peak in standard deviations.
        photos: how many photos and the mesh in them have edges.
        seen: share of the photos' pixels that show the mesh.
    """

    peak: float
    photos: int
    seen: float = 1.0

    @property
    def is_mismatch(self) -> bool:
        """Whether photos and mesh clearly do not belong together."""
        return self.peak < MISMATCH_PEAK and (self.photos >= MIN_PHOTOS or self.seen < MIN_SEEN)


def axes(rotation: Rotation) -> str:
    """``rotation``, one of the 24 of the axes, as text: "x, -z, y"."""
    letters = []
    for row in rotation:
        axis = int(np.abs(row).argmax())
        letters.append(("-" if row[axis] < 0 else "") + "xyz"[axis])
    return ", ".join(letters)


def _unit_names(scale: float) -> str:
    for name, metres in UNITS.items():
        if np.isclose(scale, metres):
            return f"{name} against meters of the poses"
        if np.isclose(scale, 1 / metres):
            return f"meters against {name} of the poses"
    return f"units of {scale:g}"


# ---- Measuring ------------------------------------------------------------------------------------------------------


class FrameMeter:
    """Measures the fit of a capture's photos to its mesh under any mend."""

    def __init__(self, views: Sequence[View], mesh: Mesh, check: Callable[[], None]) -> None:
        chosen = [view for view in views if view.photo is not None and view.camera.width >= MIN_WIDTH]
        self.views = [chosen[k] for k in _spread(len(chosen), FRAME_PHOTOS)]
        self.tracer = Tracer(mesh)
        self.check = check
        self._edges: dict[int, list[NDArray[np.float64]]] = {ALIGN_WIDTH: [], SEARCH_WIDTH: []}

        def read(view: View) -> list[NDArray[np.float64]]:
            photo = load_photo(view)
            return [band(shown_edges(photo, view.camera.shrunk(width))) for width in self._edges]

        for pair in over_each(self.views, read, lambda _: check(), photos_at_once(self.views)):
            for width, edges in zip(self._edges, pair, strict=True):
                self._edges[width].append(edges)

    def fit(self, mend: Mend | Similarity = NOTHING) -> FrameFit:
        """The fit over all chosen photos."""
        return self._fit(mend, range(len(self.views)), ALIGN_WIDTH)

    def quick_fits(self, mends: Sequence[Mend] | Sequence[Similarity]) -> list[float]:
        """A peak per mend, over fewer and smaller pictures."""
        few = _spread(len(self.views), SEARCH_PHOTOS)
        return over_each(mends, lambda mend: self._fit(mend, few, SEARCH_WIDTH).peak, lambda _: self.check())

    def best(self, mends: Sequence[Mend] | Sequence[Similarity]) -> Found | None:
        """The mend under which photos and mesh fit best, None where there is none."""
        peaks = self.quick_fits(mends)
        fits = [(mends[k], self.fit(mends[k])) for k in np.argsort(peaks)[::-1][:FINALISTS]]
        return max(fits, key=lambda one: one[1].peak, default=None)

    def sharpened(self, found: Similarity) -> Found:
        """The similarity near ``found`` under which edges fit best without any shift, and the fit of its photos."""
        best, every = found, range(len(self.views))
        peak = self._fit(best, every, ALIGN_WIDTH, 1).peak
        for size in SHARPENING:
            self.check()
            for axis, sign in product(range(7), (size, -size)):
                nudged = best.nudged(sign * np.eye(7)[axis])
                if (other := self._fit(nudged, every, ALIGN_WIDTH, 1).peak) > peak:
                    best, peak = nudged, other
        return best, self.fit(best)

    def _fit(self, mend: Mend | Similarity, which: Sequence[int], width: int, most: int = 99) -> FrameFit:
        windows, seen = [], 0.0
        for index in which:
            depth, normal = seen_geometry(mend.camera(self.views[index].camera).shrunk(width), self.tracer)
            seen += float(np.isfinite(depth).mean()) / len(which)
            full = correlation(self._edges[width][index], band(geometry_edges(depth, normal)))
            if full is not None:
                windows.append(near_no_shift(full)[0] / full.std())
        if not windows:
            return FrameFit(0.0, 0, seen)
        reach = min(most, *(min(window.shape) // 2 for window in windows))
        # Photos that do not show the mesh count as zero: a mend must explain most of them.
        return FrameFit(float(sum(_middle(window, reach) for window in windows).max()) / len(which), len(windows), seen)


def _spread(n: int, count: int) -> list[int]:
    """``count`` indices spread evenly over ``range(n)``, or all."""
    return np.unique(np.linspace(0, n - 1, min(n, count)).round().astype(int)).tolist() if n else []


def _middle(window: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    row, column = window.shape[0] // 2, window.shape[1] // 2
    return window[row - reach : row + reach + 1, column - reach : column + reach + 1]


# ---- Searching ------------------------------------------------------------------------------------------------------


def search(
    meter: FrameMeter,
    unmended: FrameFit,
    views: Sequence[View],
    mesh: Mesh,
    points: Callable[[], FloatArray | None] = lambda: None,
) -> Found | None:
    """The best of the usual mends and its fit, or the best similarity of sparse points to the mesh.

    Simple mends come first. Combinations and points that have to be found in the photos take a minute each; they are
    tried only where photos and mesh do not fit at all, and combinations of three where there are no points of the
    capture either.

    Args:
        points: the sparse points (n, 3) of the capture, None where it has none.

    Returns:
        None where there is nothing to try.
    """
    best: Found | None = None
    possible = [mend for mend in _mends() if _is_possible(mend, views, mesh)]
    given = points()

    def simple(steps: int) -> Found | None:
        return meter.best([mend for mend in possible if mend.steps == steps])

    def similar() -> Found | None:
        cloud = seen_points(views, meter.check) if given is None else given
        found = meter.best(find_similarities(cloud, views, mesh, meter.check, of_photos=given is None))
        exact = found is not None and given is not None and is_clear(found[1], unmended)
        if found is None or exact or found[1].peak < MISMATCH_PEAK:
            return found
        assert isinstance(found[0], Similarity)
        return meter.sharpened(found[0])

    usual = [partial(simple, 1), partial(simple, 2), similar, partial(simple, 3)]
    for stage in usual if given is None else (usual[0], similar):
        found = stage()
        if found is not None and (best is None or found[1].peak > best[1].peak):
            best = found
        if best is not None and is_clear(best[1], unmended):
            return best
        if given is None and not unmended.is_mismatch:
            return best
    return best


def is_clear(mended: FrameFit, unmended: FrameFit) -> bool:
    """Whether a mend is clearly right."""
    return mended.peak > max(CLEAR_PEAK, MEND_FACTOR * unmended.peak)


def _mends() -> Iterator[Mend]:
    scales = (1.0, *UNITS.values(), *(1 / metres for metres in UNITS.values()))
    for rotation, scale, convention in product(_rotations(), scales, (OURS, *CONVENTIONS)):
        yield Mend(rotation, scale, convention)


def _rotations() -> Iterator[Rotation]:
    """The 24 rotations that take axes to axes, beginning with none."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = np.zeros((3, 3))
        rotation[range(3), order] = signs
        if np.linalg.det(rotation) > 0:
            yield rotation


def _is_possible(mend: Mend, views: Sequence[View], mesh: Mesh) -> bool:
    """Whether the path of the cameras is neither long nor a point against the mesh; other units are not tried."""
    if mend.scale == 1:
        return True
    positions = np.array([mend.camera(view.camera).position for view in views])
    path = float(np.linalg.norm(np.ptp(positions, axis=0)))
    return MIN_PATH < path / max(extent(mesh), 1e-12) < MAX_PATH


def extent(mesh: Mesh) -> float:
    """Median distance of the vertices from their median: the size of a room without a far backdrop."""
    return float(np.median(np.linalg.norm(mesh.vertices - np.median(mesh.vertices, axis=0), axis=1)))


# ---- Applying -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Together:
    """Views and mesh in one frame, as far as that could be found.

    Attributes:
        mend: what was done to bring them there.
        pose_scale: that positions of the poses were multiplied by.
        similarity: by which the poses were moved to the mesh, or None.
        warning: what a user should know, or "".
        mismatch: what is wrong and how to mend it, where photos and mesh do not belong together; else None.
    """

    views: tuple[View, ...]
    val_views: tuple[View, ...]
    mesh: Mesh
    mend: Mend = NOTHING
    pose_scale: float = 1.0
    similarity: Similarity | None = None
    warning: str = ""
    mismatch: tuple[str, str] | None = None


def bring_together(
    views: Sequence[View],
    val_views: Sequence[View],
    mesh: Mesh,
    check: Callable[[], None] = lambda: None,
    *,
    may_mend: bool = True,
    points: Callable[[], FloatArray | None] = lambda: None,
) -> Together:
    """Measure the fit of photos and mesh, and mend their frames where a mend is clearly right.

    Args:
        check: called often; may raise, as for a cancel.
        may_mend: without, the fit is measured and nothing else tried.
        points: reads the sparse points (n, 3) of the photos, in the frame of the poses; None where there are none.

    Raises:
        BadInput: a photo cannot be read.
    """
    given = Together(tuple(views), tuple(val_views), mesh)
    meter = FrameMeter(views, mesh, check)
    if len(meter.views) < MIN_PHOTOS:
        return given
    fit = meter.fit()
    if fit.peak >= CLEAR_PEAK:
        return given
    if may_mend and (shown := _as_shown(given, mesh, fit, check)) is not None:
        return shown
    found = search(meter, fit, views, mesh, points) if may_mend else None
    if found is not None and found[1].photos >= MIN_PHOTOS and is_clear(found[1], fit):
        mend, mended = found
        warning = (
            f"poses and mesh are in different frames, mended: {mend.describe()} "
            f"(the photos then fit the mesh by {mended.peak:.1f} instead of {fit.peak:.1f})"
        )
        return _move(mend, given, warning) if isinstance(mend, Similarity) else _apply(mend, given, warning)
    if not fit.is_mismatch:
        return given
    advice = "bring poses and mesh of one reconstruction into one frame (axes, unit, origin), and look at inspect"
    if found is not None and found[1].peak > MISMATCH_PEAK:
        advice += f"; of what was tried this comes nearest: {found[0].describe()}"
    what = f"the photos do not fit the mesh: their edges agree by {fit.peak:.1f}, where {MISMATCH_PEAK:g} is the least"
    if may_mend:
        what += ", under no usual choice of axes, unit and pose convention"
        what += ", nor with points that they show in common turned, scaled and moved onto it"
    return replace(given, mismatch=(what, advice))


def _as_shown(given: Together, mesh: Mesh, fit: FrameFit, check: Callable[[], None]) -> Together | None:
    """The views with their photos turned as EXIF says, if that is clearly right: not all programs turn them."""
    views, val_views = ([_turned(view) for view in group] for group in (given.views, given.val_views))
    if all(view is before for view, before in zip(views, given.views, strict=True)):
        return None
    mended = FrameMeter(views, mesh, check).fit()
    if not is_clear(mended, fit):
        return None
    warning = (
        f"the photos are turned as their EXIF orientation says: they then fit the mesh by {mended.peak:.1f} instead of "
        f"{fit.peak:.1f}"
    )
    return replace(given, views=tuple(views), val_views=tuple(val_views), warning=warning)


def _turned(view: View) -> View:
    if view.photo is None or view.orientation != UPRIGHT:
        return view
    orientation = read_orientation(view.photo)
    return view if orientation in SIDEWAYS else replace(view, orientation=orientation)


def _apply(mend: Mend, given: Together, warning: str) -> Together:
    """Everything in the axes of the poses, and in the unit in which the mesh has the size of a room."""
    size = extent(given.mesh)
    by_poses, by_mesh = (ROOM_SIZE[0] < value < ROOM_SIZE[1] for value in (size * mend.scale, size))
    of_mesh, of_poses = (1.0, 1 / mend.scale) if by_mesh and not by_poses else (mend.scale, 1.0)

    def moved(view: View) -> View:
        pose = mend.convention.camera_to_world(view.camera.c2w).copy()
        pose[:3, 3] *= of_poses
        return replace(view, camera=replace(view.camera, c2w=pose))

    return Together(
        views=tuple(moved(view) for view in given.views),
        val_views=tuple(moved(view) for view in given.val_views),
        mesh=replace(given.mesh, vertices=of_mesh * given.mesh.vertices @ mend.rotation.T),
        mend=mend,
        pose_scale=of_poses,
        warning=warning,
    )


def _move(similarity: Similarity, given: Together, warning: str) -> Together:
    """The poses in the frame and unit of the mesh: it often comes from a scanner, and has a unit."""

    def moved(view: View) -> View:
        return replace(view, camera=similarity.camera(view.camera))

    return replace(
        given,
        views=tuple(moved(view) for view in given.views),
        val_views=tuple(moved(view) for view in given.val_views),
        similarity=similarity,
        warning=warning,
    )
