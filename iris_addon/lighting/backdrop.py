"""The backdrop: what photos show where the mesh has holes, painted onto a convex shell around the room.

Through a hole a camera sees the surfaces that a scan missed. Light from outside (:mod:`.hidden`) cannot stand for them:
it sums up everything beyond the mesh, lamps included, and would be a glaring patch in a hole under a table and in the
varnished front that mirrors that hole. Photos show what is there but not its distance, so pixels that miss the mesh are
painted onto a shell (:class:`Shell`, :func:`fit_backdrop`). Most of what a scan misses stands at the walls or close to
them: a missing piece of wall appears where it belongs, and an object further in is displaced a little. Rays that escape
the mesh meet the same picture (:class:`SeenBackdrop`), as glossy rays do in Cycles.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, HalfspaceIntersection

from ..model.capture import Mesh, View
from ..model.recovered import Backdrop
from ..model.sphere import dodecahedron, equirect_directions, equirect_texels, even_directions
from ..rays.tracer import Tracer
from ..response.photometry import Photometry
from ..surface.photo_samples import BackdropPixels

BACKDROP_MIN_SHARE = 2e-3
"""Share of all pixels that must miss the mesh for a backdrop to be made."""
BACKDROP_HEIGHT = 128
"""Rows of the picture: a texel spans 1.4 degrees, 6 cm at a distance of 2.5 m."""
BACKDROP_OUTLIER = 0.3
"""Deviation in log radiance at which a pixel starts to count as an outlier, such as an object in the foreground."""
BACKDROP_FLOOR = 0.01
"""Share of the mean radiance that is added before the logarithm is taken."""
BACKDROP_MIN_WEIGHT = 1e-3
"""Pixels per texel above which the texel is not mixed with its surroundings."""
BACKDROP_REACH = 2
"""Texels from one that photos show to which its radiance is taken to go on."""
BACKDROP_ROUNDS = 4
"""Iterations of the robust mean."""
SHELL_DIRECTIONS = 400
"""Directions whose outermost points define the faces of the shell."""
SHELL_CLEARANCE = 1.01
"""Factor on the size of the shell, so that it does not coincide with the walls and flicker."""
SHELL_STEP_BACK = 0.1
"""Distance from each photo's position that the shell encloses, as a share of the room's size."""


def fit_backdrop(pixels: BackdropPixels, photometry: Photometry, mesh: Mesh, views: Sequence[View]) -> SeenBackdrop:
    """A shell around mesh and cameras, painted with the radiance of the pixels that miss the mesh.

    Args:
        pixels: those that miss the mesh.
        photometry: turns their display values into radiance, scene-linear Rec.709.

    Returns:
        The backdrop; none if fewer than BACKDROP_MIN_SHARE of all pixels miss the mesh.
    """
    if pixels.share < BACKDROP_MIN_SHARE:
        return SeenBackdrop(None)
    positions = np.stack([view.camera.position for view in views])
    shell = shell_around(mesh, positions)
    if shell is None:
        return SeenBackdrop(None)
    linear = photometry.linearise_pixels(pixels.z, pixels.view, pixels.pixel)
    radiance = np.where(linear.unclipped, linear.radiance, linear.bound).astype(np.float64)
    texel = shell.texels(positions[pixels.view], pixels.direction, (BACKDROP_HEIGHT, 2 * BACKDROP_HEIGHT))
    met = texel >= 0
    if not met.any():
        return SeenBackdrop(None)
    picture, painted = _picture(texel[met], radiance[met])
    return SeenBackdrop(Backdrop(shell.vertices, shell.faces, picture), painted)


def _picture(
    texel: NDArray[np.integer], radiance: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(H, 2 H, 3) robust mean of ``radiance`` (n, 3) per texel, and which texels (H, 2 H) photos show or nearly so.

    Args:
        texel: (n,) index of each pixel's texel. Texels without a pixel are filled from their surroundings.
    """
    n = 2 * BACKDROP_HEIGHT * BACKDROP_HEIGHT
    floor = max(BACKDROP_FLOOR * float(radiance.mean()), np.finfo(np.float32).tiny)
    log = np.log(radiance + floor)
    weight, total, mean = np.ones(len(log)), np.zeros(n), np.zeros((n, 3))
    for _ in range(BACKDROP_ROUNDS):
        total = np.bincount(texel, weight, n).astype(np.float64)
        sums = np.stack([np.bincount(texel, weight * channel, n) for channel in log.T], -1)
        mean = sums / np.maximum(total, 1e-12)[:, None]
        weight = 1 / (1 + (np.abs(log - mean[texel]).mean(1) / BACKDROP_OUTLIER) ** 2)
    shape = (BACKDROP_HEIGHT, 2 * BACKDROP_HEIGHT)
    filled = _filled(mean.reshape(*shape, 3), total.reshape(shape))
    painted = blurred_panorama(total.reshape(*shape, 1), BACKDROP_REACH)[..., 0] > BACKDROP_MIN_WEIGHT
    return np.maximum(np.exp(filled) - floor, 0.0).astype(np.float32), painted


def _filled(values: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.float64]:
    """``values`` (H, W, 3) where ``weight`` (H, W) is positive, elsewhere Gaussian means of ever wider surroundings."""
    known = weight > 0
    filled, missing = np.zeros(values.shape), np.ones(weight.shape)
    for sigma in (0, 1, 2, 4, 8, 16, 32):
        near = blurred_panorama(weight[..., None], sigma)[..., 0]
        sums = blurred_panorama(values * weight[..., None], sigma)
        share = missing * near / (near + BACKDROP_MIN_WEIGHT)
        filled += (share / np.maximum(near, 1e-300))[..., None] * sums
        missing -= share
    return filled + missing[..., None] * np.average(values[known], axis=0, weights=weight[known])


def blurred_panorama(values: NDArray[np.floating], sigma: float) -> NDArray[np.float64]:
    """Gaussian mean (H, 2 H, C) of a panorama (H, 2 H, C), whose left and right edges adjoin; ``sigma`` in texels."""
    height = len(values)
    wide = np.pad(values, ((0, 0), (height, height), (0, 0)), mode="wrap")
    return gaussian_filter(wide, (sigma, sigma, 0), mode="nearest")[:, height:-height]


# ---- What escaping rays meet ----------------------------------------------------------------------------------------


class SeenBackdrop:
    """The backdrop, or none, as escaping rays see it from inside the room.

    Args:
        painted: (H, 2 H) texels whose radiance photos show; all by default.

    Attributes:
        recovered: the backdrop; None where the mesh has hardly any holes.
        radiance: (T, 3) float32 of its texels, row by row; scene-linear Rec.709.
        unseen: (T,) part that each texel lies in which no photo shows, -1 where one does. Each part lies around one of
            the directions :func:`iris_addon.model.sphere.dodecahedron` from the centre of the shell.
        shell: the surface that carries the texels.
    """

    def __init__(self, recovered: Backdrop | None, painted: NDArray[np.bool_] | None = None) -> None:
        self.recovered = recovered
        self.radiance = np.zeros((0, 3), np.float32) if recovered is None else recovered.picture.reshape(-1, 3)
        self.unseen = np.full(len(self.radiance), -1)
        self.shell = None if recovered is None else Shell(recovered.vertices, recovered.faces)
        if painted is not None:
            towards = equirect_directions(*painted.shape[::-1]).reshape(-1, 3) @ dodecahedron().T
            self.unseen = np.where(painted.reshape(-1), -1, towards.argmax(1))

    def with_unseen(self, radiance: NDArray[np.floating]) -> SeenBackdrop:
        """The same with the ``radiance`` (K, 3) of the parts that no photo shows."""
        if self.recovered is None:
            return self
        lit = np.where(self.unseen[:, None] < 0, self.radiance, radiance[self.unseen]).astype(np.float32)
        completed = copy(self)  # on the same shell
        completed.recovered = replace(self.recovered, picture=lit.reshape(self.recovered.picture.shape))
        completed.radiance = lit
        return completed

    def texels(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.int32]:
        """(n,) texel that each ray meets, -1 for none.

        Args:
            origins: (n, 3) metres, within the shell.
            directions: (n, 3) unit vectors.
        """
        if self.recovered is None or self.shell is None:
            return np.full(len(origins), -1, np.int32)
        return self.shell.texels(origins, directions, self.recovered.picture.shape)


# ---- The shell ------------------------------------------------------------------------------------------------------


class Shell:
    """A closed convex surface around a room.

    Attributes:
        vertices: (V, 3) float64 metres.
        faces: (F, 3) int64, counter-clockwise from within.
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        self.vertices, self.faces = vertices, faces
        self._tracer = Tracer(Mesh(vertices, faces))

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) metres, the viewpoint of the equirectangular picture on it."""
        return self.vertices.mean(0)

    def texels(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], shape: tuple[int, ...]
    ) -> NDArray[np.int32]:
        """(n,) texel that each ray meets, -1 for none.

        Args:
            origins: (n, 3) metres, within the shell.
            directions: (n, 3) unit vectors.
            shape: (H, 2 H, ...) of an equirectangular picture around the centre.
        """
        met = np.full(len(origins), -1, np.int32)
        distance = self._tracer.closest(origins, directions).distance
        on = np.isfinite(distance)
        place = origins[on] + distance[on, None] * directions[on] - self.centre
        met[on] = equirect_texels(place, shape[1], shape[0])
        return met

    def places(self, directions: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (n, 3) of the shell in unit ``directions`` (n, 3) from its centre, and inward normals (n, 3)."""
        hits = self._tracer.closest(np.broadcast_to(self.centre, directions.shape), directions)
        on = hits.face >= 0  # a ray along an edge may slip through
        distance = np.where(on, hits.distance, np.median(hits.distance[on]))
        normals = np.where(on[:, None], self._tracer.normals[hits.face], -directions)
        return self.centre + distance[:, None] * directions, normals


def shell_around(mesh: Mesh, positions: NDArray[np.floating]) -> Shell | None:
    """A shell of few faces around ``mesh`` and cameras at ``positions`` (n, 3) metres, with room to step back.

    Returns:
        The shell, or None if everything lies in a plane.
    """
    surface = mesh.vertices[np.unique(mesh.faces)]
    if _in_one_plane(np.concatenate([surface, positions])):
        return None
    step = SHELL_STEP_BACK * float(np.ptp(surface, axis=0).max()) * np.concatenate([np.eye(3), -np.eye(3)])
    hull = _hull(np.concatenate([surface, *(positions + one for one in step)]))
    return Shell(hull.points, _inward_faces(hull))


def _in_one_plane(points: NDArray[np.floating]) -> bool:
    """Whether ``points`` (n, 3) lie in a plane."""
    return bool(np.linalg.matrix_rank(points - points.mean(0), tol=1e-6 * float(np.ptp(points))) < 3)


def _hull(points: NDArray[np.floating]) -> ConvexHull:
    """A convex body of few faces that encloses all of ``points`` (n, 3).

    It is the hull of the points that lie furthest out in SHELL_DIRECTIONS directions, with each face moved outwards
    until every point is inside; otherwise it would hide a pane that stands back in its wall.
    """
    points = np.asarray(points, np.float64)
    outermost = points[ConvexHull(points).vertices]
    extreme = np.unique((outermost @ even_directions(SHELL_DIRECTIONS).T).argmax(0))
    inner = ConvexHull(outermost[extreme])
    normals = np.unique(inner.equations[:, :3].round(6), axis=0)
    offsets = (outermost @ normals.T).max(0)
    planes = np.concatenate([normals, -offsets[:, None]], 1)
    corners = HalfspaceIntersection(planes, inner.points.mean(0)).intersections
    return ConvexHull(corners.mean(0) + SHELL_CLEARANCE * (corners - corners.mean(0)))


def _inward_faces(hull: ConvexHull) -> NDArray[np.int64]:
    """(F, 3) triangles of ``hull``, counter-clockwise from within."""
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    outward = np.einsum("fc,fc->f", np.cross(b - a, c - a), hull.equations[:, :3]) > 0
    return np.where(outward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)
