"""Which diffuse lobe the surfaces of a room have, from how their brightness changes with the angle of view."""

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

ROBUST_LOG = 0.1
MIN_PIXELS = 2
MIN_RADIANCE = 1e-3


@dataclass(frozen=True)
class DiffuseChoice:
    """The lobe of every diffuse surface, and the relative fall of the disagreement that Burley's brings."""

    lobe: DiffuseLobe
    gain: float

    def under(self, layer: bool) -> DiffuseChoice:
        """The same room with or without a dielectric layer that takes its light off what is below; Burley's lobe is of
        models that have none."""
        return self if self.lobe == "burley" else DiffuseChoice("layered" if layer else "lambert", self.gain)


def choose_diffuse(
    observations: Observations, linear: Linearised, schlick: NDArray[np.floating], decisions: Decisions
) -> DiffuseChoice:
    """The lobe under which the views of each patch agree.

    Args:
        schlick: (M,) S of the direction each observation was made from.
    """
    o = observations
    usable = linear.well_exposed & (linear.radiance.min(1) > MIN_RADIANCE) & (o.count >= MIN_PIXELS)
    weight = np.where(usable, np.sqrt(np.minimum(o.count, 25.0)), 0.0)
    if not weight.any():
        return DiffuseChoice("lambert", 0.0)
    brightness = np.log(np.maximum(linear.radiance, MIN_RADIANCE)).mean(1)
    rough = float(grazing_gain("burley", np.array(1.0)))
    lambert = _disagreement(brightness, o.patch, weight)
    burley = _disagreement(brightness - np.log1p(rough * schlick), o.patch, weight)
    accepted = decisions.accept("burley", lambert, burley)
    return DiffuseChoice("burley" if accepted else "lambert", 1 - burley / max(lambert, 1e-9))


def _disagreement(brightness: NDArray[np.floating], patch: NDArray[np.integer], weight: NDArray[np.floating]) -> float:
    """Robust mean deviation of log brightness (M,) from one value per patch."""
    n = int(patch.max()) + 1
    say, deviation = weight, np.zeros_like(brightness)
    for _ in range(3):
        mean = np.bincount(patch, say * brightness, n) / np.maximum(np.bincount(patch, say, n), 1e-9)
        deviation = (brightness - mean[patch]) / ROBUST_LOG
        say = weight / (1 + deviation**2)
    return float(weight @ np.log1p(deviation**2) / weight.sum())


# ---- Observations on curved surfaces, whose highlights one pixel shows and the mean over several does not -----------
#
# An observation is the mean over the pixels of one view on one patch, and its reflected rays start at one of them. A
# ball turns by twenty degrees from one side of a patch to the other, and what its pixels mirror lies forty degrees
# apart: the mean of them is nothing that a metal with one normal could show.


TURN = np.cos(np.radians(5.0))
"""Cosine between the normal of the one pixel and the mean normal of all, from which on they show different things."""


def mirrored_radiance(
    observations: Observations,
    linear: Linearised,
    observed: GroupRadiance,
    photos: PhotoSamples,
    photometry: Photometry,
) -> NDArray[np.float64]:
    """(M, 3) radiance of the pixel whose reflected rays stand for each observation: its own where the surface turns,
    elsewhere the mean ``linear``, which has less noise. Meaningless where that is not open.

    What is black is as bright as its patch is ``observed`` to be in other photos, as far as black allows.
    """
    expected = observed.radiance[observations.patch]
    radiance = linear.agreeing_with(expected).radiance
    at = np.flatnonzero(turning(observations, photos.samples.normal))
    pixel, samples = observations.sample[at], photos.samples
    alone = photometry.linearise_pixels(photos.z[pixel], samples.view[pixel], samples.pixel[pixel])
    radiance[at] = alone.agreeing_with(expected[at]).radiance
    return radiance


def turning(observations: Observations, normal: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(M,) observations whose one pixel faces elsewhere than their pixels do on average; ``normal`` (n, 3) of all."""
    o = observations
    mean = group_sums(normal, o.sample_to_observation, len(o.patch))
    return np.einsum("mk,mk->m", mean, normal[o.sample]) < TURN * np.linalg.norm(mean, axis=1)
