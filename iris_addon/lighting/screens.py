"""Screens: lamps whose picture changes while the light of the room does not.

The search (:mod:`iris_addon.lighting.search`) takes for a lamp what is too bright to reflect in nearly all views, since
a highlight is seen from few. A screen may be dark in half of the photos, and its light hardly matters to the room. But
paint under steady light has one colour in every photo, and what a glossy surface mirrors was taken off before: what
changes its colour from photo to photo, and is at times brighter than any surface could be, makes its own light.
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
from .candidates import least_radiance
from .lamp_radiance import PatchFit, form_factors_of, patches_on, solve_lights
from .problem import LightProblem, Lights

CHANGE = 0.2
"""Median departure of a patch's colour from its median over views (norm of two log ratios of channels) from which on it
changes. Of redkitchen's screens half the patches exceed it, of magazines and grain that views see shifted few."""
BEYOND_OTHERS = 3.0
"""And times by which it changes more than half of the room does: where white balance drifts, everything changes."""
BRIGHT = 1.2
"""Reflectance needed in a quarter of the views."""
BRIGHT_QUANTILE = 0.75
MIN_VIEWS = 4
MIN_PATCHES = 20
"""Patches that change and are bright; elsewhere, in five captures, three at most lay together."""
REACH = 0.15
"""Metres between bright places of one picture."""
FLAT = 0.03
"""Metres by which the surface of a screen is off its plane in a scan."""
FACING = 0.8
"""Cosine between the normal of a screen and those of its faces."""
MIN_SHARE = 0.15
"""Of the patches within the outline of a screen, those that change and are bright."""


@dataclass(frozen=True)
class Shown:
    """What photos show of the seen patches, view by view.

    Attributes:
        specular: (M, 3) what glossy surfaces mirror into each observation.
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
    """``lights`` and the screens whose light does not speak against them.

    Args:
        weight: (P,) say of each seen patch.
        diffuse: (P, 3) radiance without its specular part.

    What decides is the held-out loss of the light balance over the patches on none of them. A screen hardly moves it;
    what took the light of a lamp would.
    """
    screens = find_screens(problem, lights, shown) if problem.given is None else []
    if not screens:
        return lights
    mask = lights.mask.copy()
    mask[np.concatenate(screens)] = True
    say = np.where(patches_on(problem, mask)[: problem.transport.n_seen], 0.0, weight)

    def solved(emitters: list[NDArray[np.int64]], before: Lights) -> Lights:
        factors = form_factors_of(problem, emitters, progress, known=before)
        return solve_lights(problem, observed, emitters, before, progress, factors, PatchFit(say, diffuse), True)

    best = solved(lights.emitters, lights)
    for screen in screens:
        tried = solved([*best.emitters, screen], best)
        subject = f"screen of {len(screen)} faces"
        if problem.decisions.accept("screen", best.held_out, tried.held_out, subject=subject):
            best = tried
    return best if len(best.emitters) > len(lights.emitters) else lights


def find_screens(problem: LightProblem, lights: Lights, shown: Shown) -> list[NDArray[np.int64]]:
    """Faces of each flat surface whose picture changes, and that no lamp has."""
    surface = problem.surface
    changing = changing_patches(shown, lights.irradiance[: problem.transport.n_seen])
    at = np.flatnonzero(changing & ~patches_on(problem, lights.mask)[: len(changing)])
    if len(at) < MIN_PATCHES:
        return []
    near = cKDTree(surface.position[at]).query_pairs(REACH, output_type="ndarray")
    label = component_labels(len(at), near[:, 0], near[:, 1])
    screens, taken = [], lights.mask.copy()
    for k in np.flatnonzero(np.bincount(label) >= MIN_PATCHES):
        outline = Outline.around(surface.position[at[label == k]].astype(np.float64))
        if outline is None:
            continue
        inside = outline.holds(surface.position, surface.normal)
        faces = _faces_on(problem, inside, outline) & ~taken
        if np.mean(changing[inside]) > MIN_SHARE and faces.any():
            screens.append(np.flatnonzero(faces))
            taken |= faces
    return screens


def _faces_on(problem: LightProblem, inside: NDArray[np.bool_], outline: Outline) -> NDArray[np.bool_]:
    """(F,) faces of which most pixels lie on patches ``inside``; those that no pixel hit go by their middle."""
    face, n_faces = problem.samples.face, len(problem.regions)
    count = np.bincount(face, minlength=n_faces)
    within = np.bincount(face[inside[problem.surface.sample_patch]], minlength=n_faces)
    tracer = problem.tracer
    unseen = (count == 0) & (tracer.areas > 0)
    unseen[unseen] = outline.holds(tracer.corners[unseen].mean(1), tracer.normals[unseen])
    return (within > 0.5 * count) | unseen


def changing_patches(shown: Shown, irradiance: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(P,) patches whose colour changes from view to view, and which no reflectance explains in a quarter of the views.

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
    bright = group_quantiles(needed[:, None], o.patch, n, BRIGHT_QUANTILE)[:, 0] > BRIGHT
    often = np.bincount(patch, minlength=n) >= MIN_VIEWS
    usual = float(np.median(change[often])) if often.any() else 0.0
    return bright & often & (change > max(CHANGE, BEYOND_OTHERS * usual))


@dataclass(frozen=True)
class Outline:
    """The convex outline of a flat set of points.

    Attributes:
        centre, axes: of the plane; rows of ``axes`` are two directions in it and its normal.
        hull: triangulation of the outline in the plane.
    """

    centre: NDArray[np.float64]
    axes: NDArray[np.float64]
    hull: Delaunay

    @staticmethod
    def around(points: NDArray[np.float64]) -> Outline | None:
        """The outline of ``points`` (n, 3), None if they lie on no plane or on a line."""
        centre = np.median(points, axis=0)
        for _ in range(2):  # the second time without what stands before the plane
            axes = np.linalg.svd(points - centre, full_matrices=False)[2]
            flat = np.abs((points - centre) @ axes[2]) < FLAT
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
        """(n,) points within the outline whose normals face as it does."""
        local = (points - self.centre) @ self.axes.T
        facing = np.abs(normals @ self.axes[2]) > FACING
        result = (np.abs(local[:, 2]) < FLAT) & facing
        result[result] = self.hull.find_simplex(local[result, :2]) >= 0
        return result
