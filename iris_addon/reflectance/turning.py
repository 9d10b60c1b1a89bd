"""Observations on curved surfaces, whose highlights one pixel shows and the mean over several does not.

An observation is the mean over the pixels of one view on one patch, and its reflected rays start at one of them. A ball
turns by twenty degrees from one side of a patch to the other, and what its pixels mirror lies forty degrees apart: the
mean of them is nothing that a metal with one normal could show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_sums
from ..photo_samples import PhotoSamples
from ..photometry import Photometry
from ..response.observations import Observations
from ..response.radiance import GroupRadiance, Linearised

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
