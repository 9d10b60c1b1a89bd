"""What cameras see where the mesh has holes: the surfaces that a scan missed, not the light that comes through.

Light from outside the mesh stands for everything beyond it together, lamps among it. To a camera that looks through a
hole under a table it would be a glaring patch, and so it would be mirrored by a varnished front. The photos show what
is there, but not how far away: pixels that miss the mesh are painted onto a shell around it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, HalfspaceIntersection

from ..model.capture import Mesh, View
from ..model.recovered import Backdrop
from ..model.sphere import equirect_texels
from ..rays.tracer import Tracer
from ..response.photometry import Photometry
from ..surface.photo_samples import BackdropPixels

MIN_SHARE = 2e-3
"""Share of all pixels from which what lies beyond the mesh is worth a backdrop."""
HEIGHT = 128
"""Rows of the picture: 1.4 degrees a texel, 6 cm at two and a half metres."""
OUTLIER = 0.3
"""Deviation in log radiance of an outlier: something in front of what most photos show."""
FLOOR = 0.01
"""Of the mean radiance, added before the logarithm is taken."""
ENOUGH = 1e-3
"""Pixels per texel, from which on their surroundings are not asked."""
ROUNDS = 4


def fit_backdrop(beyond: BackdropPixels, photometry: Photometry, mesh: Mesh, views: Sequence[View]) -> Backdrop | None:
    """A shell around mesh and cameras with the radiance of the pixels that miss the mesh; None if hardly any do."""
    if beyond.share < MIN_SHARE:
        return None
    positions = np.stack([view.camera.position for view in views])
    shell = shell_around(mesh, positions)
    if shell is None:
        return None
    linear = photometry.linearise_pixels(beyond.z, beyond.view, beyond.pixel)
    radiance = np.where(linear.unclipped, linear.radiance, linear.bound).astype(np.float64)
    texel = shell.texels(positions[beyond.view], beyond.direction, (HEIGHT, 2 * HEIGHT))
    met = texel >= 0
    if not met.any():
        return None
    return Backdrop(shell.vertices, shell.faces, _picture(texel[met], radiance[met]))


def _picture(texel: NDArray[np.integer], radiance: NDArray[np.floating]) -> NDArray[np.float32]:
    """(H, 2 H, 3) robust mean of ``radiance`` (n, 3) per texel; what no pixel shows goes with its surroundings."""
    n = 2 * HEIGHT * HEIGHT
    floor = max(FLOOR * float(radiance.mean()), np.finfo(np.float32).tiny)
    log = np.log(radiance + floor)
    weight, total, mean = np.ones(len(log)), np.zeros(n), np.zeros((n, 3))
    for _ in range(ROUNDS):
        total = np.bincount(texel, weight, n).astype(np.float64)
        sums = np.stack([np.bincount(texel, weight * channel, n) for channel in log.T], -1)
        mean = sums / np.maximum(total, 1e-12)[:, None]
        weight = 1 / (1 + (np.abs(log - mean[texel]).mean(1) / OUTLIER) ** 2)
    shape = (HEIGHT, 2 * HEIGHT)
    filled = _filled(mean.reshape(*shape, 3), total.reshape(shape))
    return np.maximum(np.exp(filled) - floor, 0.0).astype(np.float32)


def _filled(values: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.float64]:
    """``values`` (H, W, 3) where ``weight`` (H, W) is, Gaussian means of ever wider surroundings where it is not."""
    known = weight > 0
    filled, missing = np.zeros(values.shape), np.ones(weight.shape)
    for sigma in (0, 1, 2, 4, 8, 16, 32):
        near = blurred_panorama(weight[..., None], sigma)[..., 0]
        sums = blurred_panorama(values * weight[..., None], sigma)
        share = missing * near / (near + ENOUGH)
        filled += (share / np.maximum(near, 1e-300))[..., None] * sums
        missing -= share
    return filled + missing[..., None] * np.average(values[known], axis=0, weights=weight[known])


def blurred_panorama(values: NDArray[np.floating], sigma: float) -> NDArray[np.float64]:
    """Gaussian mean of a panorama (H, 2 H, C), which goes on beyond its left and right edge."""
    height = len(values)
    wide = np.pad(values, ((0, 0), (height, height), (0, 0)), mode="wrap")
    return gaussian_filter(wide, (sigma, sigma, 0), mode="nearest")[:, height:-height]


# ---- What rays meet that escape through holes of the mesh: the surfaces that photos show there ----------------------
#
# A varnished front beside a hole does not mirror the lamps that light from outside stands for, but the chair that the
# scan missed. Cycles shows glossy rays the same.


class Beyond:
    """A backdrop, or none, as rays from within meet it.

    Attributes:
        backdrop: None where the mesh has hardly any holes.
        radiance: (T, 3) float32 of its texels, row by row.
    """

    def __init__(self, backdrop: Backdrop | None) -> None:
        self.backdrop = backdrop
        self.radiance = np.zeros((0, 3), np.float32) if backdrop is None else backdrop.picture.reshape(-1, 3)
        self.shell = None if backdrop is None else Shell(backdrop.vertices, backdrop.faces)

    def texels(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.int32]:
        """(n,) texel that each ray meets, -1 for none; origins within the shell and unit directions (n, 3)."""
        if self.backdrop is None or self.shell is None:
            return np.full(len(origins), -1, np.int32)
        return self.shell.texels(origins, directions, self.backdrop.picture.shape)


# ---- A convex shell around a room whose mesh has holes, and where on it rays end that leave the mesh ----------------
#
# Most of what a scan misses stands at its walls or close to them: from wherever one looks, what is missing on a wall is
# on the shell where it belongs, and what was further in is moved a little.


DIRECTIONS = 400
"""In which the points that the shell is drawn through lie furthest out."""
CLEARANCE = 1.01
"""The shell stands off the walls by a hundredth of its size, lest they flicker."""
STEP_BACK = 0.1
"""Of the room's size: so far from where a photo was taken one still stands within."""


class Shell:
    """A closed convex surface.

    Attributes:
        vertices: (V, 3) float64 metres.
        faces: (F, 3) int64, counter-clockwise from within.
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        self.vertices, self.faces = vertices, faces
        self._tracer = Tracer(Mesh(vertices, faces))

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) from where pictures on it are painted."""
        return self.vertices.mean(0)

    def texels(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], shape: tuple[int, ...]
    ) -> NDArray[np.int32]:
        """(n,) texel of an equirectangular picture of ``shape`` (H, 2 H, ...) around the centre that each ray meets,
        -1 for none; origins within the shell and unit directions (n, 3)."""
        met = np.full(len(origins), -1, np.int32)
        distance = self._tracer.closest(origins, directions).distance
        on = np.isfinite(distance)
        place = origins[on] + distance[on, None] * directions[on] - self.centre
        met[on] = equirect_texels(place, shape[1], shape[0])
        return met

    def places(self, directions: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, 3) points of the shell in unit ``directions`` (n, 3) from its centre, and unit normals that look in."""
        hits = self._tracer.closest(np.broadcast_to(self.centre, directions.shape), directions)
        on = hits.face >= 0  # a ray along an edge may slip through
        distance = np.where(on, hits.distance, np.median(hits.distance[on]))
        normals = np.where(on[:, None], self._tracer.normals[hits.face], -directions)
        return self.centre + distance[:, None] * directions, normals


def shell_around(mesh: Mesh, positions: NDArray[np.floating]) -> Shell | None:
    """A shell of few faces around ``mesh`` and cameras at ``positions`` (n, 3), with room to step back; None if all
    lies in a plane."""
    surface = mesh.vertices[np.unique(mesh.faces)]
    if _flat(np.concatenate([surface, positions])):
        return None
    step = STEP_BACK * float(np.ptp(surface, axis=0).max()) * np.concatenate([np.eye(3), -np.eye(3)])
    hull = _hull(np.concatenate([surface, *(positions + one for one in step)]))
    return Shell(hull.points, _inward_faces(hull))


def _flat(points: NDArray[np.floating]) -> bool:
    """Whether ``points`` (n, 3) lie in a plane."""
    return bool(np.linalg.matrix_rank(points - points.mean(0), tol=1e-6 * float(np.ptp(points))) < 3)


def _hull(points: NDArray[np.floating]) -> ConvexHull:
    """A convex body of few faces around all of ``points`` (n, 3), lest it hide a pane that stands back in its wall.

    The hull of what lies furthest out in some directions, with each of its faces moved out until nothing is beyond it.
    """
    k = np.arange(DIRECTIONS) + 0.5
    z, azimuth = 1 - 2 * k / DIRECTIONS, np.pi * (1 + 5**0.5) * k  # a Fibonacci lattice on the sphere
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], -1)
    points = np.asarray(points, np.float64)
    outermost = points[ConvexHull(points).vertices]
    extreme = np.unique((outermost @ directions.T).argmax(0))
    inner = ConvexHull(outermost[extreme])
    normals = np.unique(inner.equations[:, :3].round(6), axis=0)
    offsets = (outermost @ normals.T).max(0)
    planes = np.concatenate([normals, -offsets[:, None]], 1)
    corners = HalfspaceIntersection(planes, inner.points.mean(0)).intersections
    return ConvexHull(corners.mean(0) + CLEARANCE * (corners - corners.mean(0)))


def _inward_faces(hull: ConvexHull) -> NDArray[np.int64]:
    """(F, 3) triangles of ``hull``, counter-clockwise from within."""
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    outward = np.einsum("fc,fc->f", np.cross(b - a, c - a), hull.equations[:, :3]) > 0
    return np.where(outward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)
