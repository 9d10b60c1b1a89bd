"""Screens: lamps whose picture changes while the light of the room does not.

The search (:mod:`.search`) takes for a lamp what is too bright to reflect in nearly all views, since a highlight is
seen in few. A screen may be dark in half of the photos, and its light hardly matters to the room. But paint under
steady light has one colour in every photo, and specular light was subtracted before. A surface emits if its colour
changes from photo to photo and it is at times brighter than a reflecting surface could be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from ..base.group_by import group_medians, group_quantiles
from ..base.progress import Progress
from ..response.observations import Observations
from ..response.radiance import GroupRadiance, Linearised, without_specular
from ..surface.topology import component_labels
from .brightness import least_radiance
from .lamp_radiance import PatchFit, form_factors_of, patches_on, solve_lights
from .problem import LightProblem, Lights

SCREEN_MIN_CHANGE = 0.2
"""Median deviation of a patch's colour (two log ratios of channels, Euclidean norm) from its median over views above
which the colour changes. Half of the patches of redkitchen's screens exceed it, but few of magazines and of wood grain
that is shifted between views."""
SCREEN_CHANGE_RATIO = 3.0
"""The same as a factor on the median over the room, because everything changes where white balance drifts."""
SCREEN_MIN_REFLECTANCE = 1.2
"""Reflectance needed, at SCREEN_QUANTILE of the views, above which a patch is bright."""
SCREEN_QUANTILE = 0.75
SCREEN_MIN_VIEWS = 4
"""Views below which a patch is not tested."""
SCREEN_MIN_PATCHES = 20
"""Patches of a screen that change and are bright, at least. Off screens at most three lay together (five captures)."""
SCREEN_MAX_GAP = 0.15
"""Metres between neighbouring bright patches of one screen, at most."""
SCREEN_MAX_OFFSET = 0.03
"""Metres by which the surface of a screen departs from its plane in a scan, at most."""
SCREEN_MIN_COSINE = 0.8
"""Cosine between the normal of a screen and those of its faces, at least."""
SCREEN_MIN_SHARE = 0.15
"""Share of the patches within the outline of a screen that change and are bright, at least."""


@dataclass(frozen=True)
class Shown:
    """What photos show of the seen patches, view by view.

    Attributes:
        observations: M means over the pixels of one photo on one patch.
        linear: their radiance with its bounds.
        specular: (M, 3) specular radiance of each observation.
    """

    observations: Observations
    linear: Linearised
    specular: NDArray[np.floating]


def with_screens(
    problem: LightProblem,
    observed: GroupRadiance,
    lights: Lights,
    shown: Shown,
    weight: NDArray[np.float64],
    diffuse: NDArray[np.float64],
    progress: Progress,
) -> Lights:
    """``lights`` and the screens that the light balance accepts.

    The criterion is the held-out loss of the light balance over the patches that lie on no screen. A screen hardly
    changes it; a false screen that takes over the light of a lamp raises it.

    Args:
        weight: (P,) statistical weight of each seen patch.
        diffuse: (P, 3) radiance without its specular part.
    """
    screens = find_screens(problem, lights, shown) if problem.given_emitters is None else []
    if not screens:
        return lights
    mask = lights.mask.copy()
    mask[np.concatenate(screens)] = True
    off_screen_weight = np.where(patches_on(problem, mask)[: problem.transport.n_seen], 0.0, weight)

    def solved(emitters: list[NDArray[np.int64]], before: Lights) -> Lights:
        factors = form_factors_of(problem, emitters, progress, known=before)
        fit = PatchFit(off_screen_weight, diffuse)
        return solve_lights(problem, observed, emitters, before, progress, factors, fit, warm_start=True)

    best = solved(lights.emitters, lights)
    for screen in screens:
        tried = solved([*best.emitters, screen], best)
        subject = f"screen of {len(screen)} faces"
        if problem.decisions.accept("screen", best.held_out, tried.held_out, best.paired_error(tried), subject=subject):
            best = tried
    return best if len(best.emitters) > len(lights.emitters) else lights


def find_screens(problem: LightProblem, lights: Lights, shown: Shown) -> list[NDArray[np.int64]]:
    """Faces of each flat surface whose picture changes and that is no lamp yet."""
    surface = problem.surface
    changing = changing_patches(shown, lights.irradiance[: problem.transport.n_seen])
    at = np.flatnonzero(changing & ~patches_on(problem, lights.mask)[: len(changing)])
    if len(at) < SCREEN_MIN_PATCHES:
        return []
    near = cKDTree(surface.position[at]).query_pairs(SCREEN_MAX_GAP, output_type="ndarray")
    label = component_labels(len(at), near[:, 0], near[:, 1])
    screens, taken = [], lights.mask.copy()
    for k in np.flatnonzero(np.bincount(label) >= SCREEN_MIN_PATCHES):
        outline = Outline.around(surface.position[at[label == k]].astype(np.float64))
        if outline is None:
            continue
        inside = outline.holds(surface.position, surface.normal)
        faces = _faces_on(problem, inside, outline) & ~taken
        if np.mean(changing[inside]) > SCREEN_MIN_SHARE and faces.any():
            screens.append(np.flatnonzero(faces))
            taken |= faces
    return screens


def _faces_on(problem: LightProblem, inside: NDArray[np.bool_], outline: Outline) -> NDArray[np.bool_]:
    """(F,) faces most of whose pixels lie on patches ``inside`` (P,), or unseen ones whose centroid is inside."""
    face, n_faces = problem.samples.face, len(problem.regions)
    count = np.bincount(face, minlength=n_faces)
    within = np.bincount(face[inside[problem.surface.sample_patch]], minlength=n_faces)
    tracer = problem.tracer
    unseen = (count == 0) & (tracer.areas > 0)
    unseen[unseen] = outline.holds(tracer.corners[unseen].mean(1), tracer.normals[unseen])
    return (within > 0.5 * count) | unseen


def changing_patches(shown: Shown, irradiance: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(P,) patches whose colour changes from view to view and which are too bright to reflect in a quarter of the
    views.

    Args:
        irradiance: (P, 3) irradiance / pi.
    """
    o, linear, n = shown.observations, shown.linear, len(irradiance)
    known = linear.well_exposed
    own = without_specular(linear.radiance, shown.specular)[known]
    log, patch = np.log(np.maximum(own, 1e-9)), o.patch[known]
    colour = log[:, [0, 2]] - log[:, [1]]
    off = np.abs(colour - group_medians(colour, patch, n)[patch])
    change = np.linalg.norm(group_medians(off, patch, n), axis=1)
    needed = (least_radiance(linear, shown.specular) / np.maximum(irradiance[o.patch], 1e-6)).max(1)
    bright = group_quantiles(needed[:, None], o.patch, n, SCREEN_QUANTILE)[:, 0] > SCREEN_MIN_REFLECTANCE
    often = np.bincount(patch, minlength=n) >= SCREEN_MIN_VIEWS
    usual = float(np.median(change[often])) if often.any() else 0.0
    return bright & often & (change > max(SCREEN_MIN_CHANGE, SCREEN_CHANGE_RATIO * usual))


@dataclass(frozen=True)
class Outline:
    """The convex outline of a flat set of points.

    Attributes:
        centre: (3,) metres, a point of the plane.
        axes: (3, 3) unit vectors in rows: two in the plane, and its normal.
        hull: triangulation of the outline, in the plane's two coordinates.
    """

    centre: NDArray[np.float64]
    axes: NDArray[np.float64]
    hull: Delaunay

    @staticmethod
    def around(points: NDArray[np.float64]) -> Outline | None:
        """The outline of ``points`` (n, 3) in metres, None if they lie on no plane or on one line."""
        centre = np.median(points, axis=0)
        for _ in range(2):  # the second time without points off the plane
            axes = np.linalg.svd(points - centre, full_matrices=False)[2]
            flat = np.abs((points - centre) @ axes[2]) < SCREEN_MAX_OFFSET
            if np.mean(flat) < 0.75:
                return None
            points = points[flat]
            centre = points.mean(0)
        try:
            corners = (points - centre) @ axes[:2].T
            return Outline(centre, axes, Delaunay(corners[ConvexHull(corners).vertices]))
        except QhullError:
            return None

    def holds(self, points: NDArray[np.floating], normals: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(n,) ``points`` (n, 3) within the outline whose ``normals`` (n, 3) are parallel to its own."""
        local = (points - self.centre) @ self.axes.T
        facing = np.abs(normals @ self.axes[2]) > SCREEN_MIN_COSINE
        result = (np.abs(local[:, 2]) < SCREEN_MAX_OFFSET) & facing
        result[result] = self.hull.find_simplex(local[result, :2]) >= 0
        return result
