"""How the brightness of surfaces depends on the view: the choice of the diffuse lobe, and observations of curved
surfaces.

:func:`choose_diffuse` takes Burley's lobe where the views of each patch then agree better. :func:`mirrored_radiance`
gives the radiance that the reflected rays of an observation explain; where the surface is curved, that is the radiance
of one pixel, because the mean over several contains no sharp highlight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_sums
from ..brdf.diffuse import grazing_gain
from ..decide import Decisions
from ..model.recovered import DiffuseLobe
from ..response.observations import Observations
from ..response.photometry import Photometry
from ..response.radiance import GroupRadiance, Linearised
from ..surface.photo_samples import PhotoSamples

DIFFUSE_ROBUST_LOG = 0.1
"""Deviation in log brightness at which an observation starts to count as an outlier."""
DIFFUSE_MIN_PIXELS = 2
"""Pixels below which an observation is left out."""
DIFFUSE_MIN_RADIANCE = 1e-3
"""Radiance below which an observation is left out."""
CURVED_COSINE = np.cos(np.radians(5.0))
"""Cosine between the normal of an observation's pixel and the mean normal of all its pixels below which they show
different things."""


@dataclass(frozen=True)
class DiffuseChoice:
    """The lobe of every diffuse surface.

    Attributes:
        lobe: its name.
        gain: relative fall of the disagreement of views under Burley's lobe.
    """

    lobe: DiffuseLobe
    gain: float

    def under(self, layer: bool) -> DiffuseChoice:
        """The same room with or without a dielectric layer that takes the light it reflects off the diffuse light
        below; Burley's lobe belongs to a model without such a layer."""
        return self if self.lobe == "burley" else DiffuseChoice("layered" if layer else "lambert", self.gain)


def choose_diffuse(
    observations: Observations, linear: Linearised, schlick: NDArray[np.floating], decisions: Decisions
) -> DiffuseChoice:
    """The lobe under which the views of each patch agree.

    Args:
        schlick: (M,) Schlick's S of the angle between normal and camera.
        decisions: where Burley's lobe is decided.
    """
    o = observations
    usable = linear.well_exposed & (linear.radiance.min(1) > DIFFUSE_MIN_RADIANCE) & (o.count >= DIFFUSE_MIN_PIXELS)
    weight = np.where(usable, np.sqrt(np.minimum(o.count, 25.0)), 0.0)
    if not weight.any():
        return DiffuseChoice("lambert", 0.0)
    brightness = np.log(np.maximum(linear.radiance, DIFFUSE_MIN_RADIANCE)).mean(1)
    rough = float(grazing_gain("burley", np.array(1.0)))
    lambert = _disagreement(brightness, o.patch, weight)
    burley = _disagreement(brightness - np.log1p(rough * schlick), o.patch, weight)
    accepted = decisions.accept("burley", lambert, burley)
    return DiffuseChoice("burley" if accepted else "lambert", 1 - burley / max(lambert, 1e-9))


def _disagreement(brightness: NDArray[np.floating], patch: NDArray[np.integer], weight: NDArray[np.floating]) -> float:
    """Robust mean deviation of log brightness (M,) from one value per patch, with ``weight`` (M,)."""
    n = int(patch.max()) + 1
    robust_weight, deviation = weight, np.zeros_like(brightness)
    for _ in range(3):
        mean = np.bincount(patch, robust_weight * brightness, n) / np.maximum(
            np.bincount(patch, robust_weight, n), 1e-9
        )
        deviation = (brightness - mean[patch]) / DIFFUSE_ROBUST_LOG
        robust_weight = weight / (1 + deviation**2)
    return float(weight @ np.log1p(deviation**2) / weight.sum())


# ---- Observations of curved surfaces --------------------------------------------------------------------------------


def mirrored_radiance(
    observations: Observations,
    linear: Linearised,
    observed: GroupRadiance,
    photos: PhotoSamples,
    photometry: Photometry,
) -> NDArray[np.float64]:
    """(M, 3) radiance that the reflected rays of each observation explain.

    An observation is the mean over the pixels of one photo on one patch, and its reflected rays start at one of them.
    The normals of a ball turn by twenty degrees across a patch, and what its pixels mirror lies forty degrees apart: no
    metal with one normal shows the mean of that. On curved surfaces the radiance of the one pixel is taken, elsewhere
    the mean, which has less noise.

    Args:
        linear: radiance of the observations; the result is meaningless where it is clipped.
        observed: radiance of the patches, which black pixels take as far as their upper bound allows.
    """
    expected = observed.radiance[observations.patch]
    radiance = linear.agreeing_with(expected).radiance
    at = np.flatnonzero(on_curved_surface(observations, photos.samples.normal))
    pixel, samples = observations.sample[at], photos.samples
    alone = photometry.linearise_pixels(photos.z[pixel], samples.view[pixel], samples.pixel[pixel])
    radiance[at] = alone.agreeing_with(expected[at]).radiance
    return radiance


def on_curved_surface(observations: Observations, normal: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(M,) observations whose pixel has another normal than the mean of their pixels; ``normal`` (n, 3) of all."""
    o = observations
    mean = group_sums(normal, o.sample_to_observation, len(o.patch))
    return np.einsum("mk,mk->m", mean, normal[o.sample]) < CURVED_COSINE * np.linalg.norm(mean, axis=1)
