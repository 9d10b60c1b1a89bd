"""Specular lobes of observations and pixels: traced where glossy, from irradiance where rough, denoised over pixels.

Neighbouring pixels reflect nearly the same things, so :func:`pixel_lobes` averages their lobes
(:func:`denoise_lobes`) and needs fewer rays than :func:`specular_lobes`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import kernel
from ..base.parallel import BLOCK, over_blocks, over_random_blocks
from ..base.progress import Progress
from ..brdf.ggx import DIELECTRIC_F0, ray_alpha, specular_integrals
from ..model.capture import Camera
from ..rays.sampling import dot
from ..surface.photo_samples import PhotoSamples
from ..surface.primary_rays import Lattice, PixelSamples
from .lobes import Scene, trace_lobes

SPECULAR_ROUGH = 0.75
"""Roughness above which a lobe sees about what the whole hemisphere sees."""
DENOISE_STEPS = (1, 2, 4)
"""Spacing in pixels of the neighbours in each pass of the filter."""
DENOISE_TURN = 0.6
"""Standard deviation of the filter in the reflected direction, in GGX widths."""
DENOISE_SIDE, DENOISE_CORNER = 0.5, 0.25
"""Weights of the eight neighbours relative to the pixel itself: a binomial kernel."""


def rough_lobes(
    roughness: NDArray[np.floating], cosine: NDArray[np.floating], irradiance: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """``Ls0`` and ``Ls1`` (n, 3) of lobes that see the whole hemisphere, from tables and free of the noise of rays.

    Args:
        roughness: (n,) Principled roughness.
        cosine: (n,) between the normal and the direction to the camera.
        irradiance: (n, 3) irradiance / pi.
    """
    ls0, ls1 = np.empty(irradiance.shape, np.float32), np.empty(irradiance.shape, np.float32)

    def work(rows: slice) -> None:
        f0, f1 = specular_integrals(roughness[rows], cosine[rows])
        ls0[rows], ls1[rows] = f0[:, None] * irradiance[rows], f1[:, None] * irradiance[rows]

    over_blocks(len(cosine), BLOCK, work)
    return ls0, ls1


def specular_lobes(
    scene: Scene,
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """``Ls0`` and ``Ls1`` (n, 3) of the pixels ``rows`` (n,): traced where glossy, from irradiance where rough.

    Args:
        roughness: (n,) Principled roughness at each pixel.
        irradiance: (n, 3) irradiance / pi at each pixel.
    """
    rough, traced = np.flatnonzero(roughness >= SPECULAR_ROUGH), np.flatnonzero(roughness < SPECULAR_ROUGH)
    ls0, ls1 = np.empty((len(rows), 3), np.float32), np.empty((len(rows), 3), np.float32)
    ls0[rough], ls1[rough] = rough_lobes(roughness[rough], samples.cosine[rows[rough]], irradiance[rough])

    def work(block: slice, rng: np.random.Generator) -> None:
        at = traced[block]
        ls0[at], ls1[at] = scene.lobes(trace_lobes(scene, samples, rows[at], roughness[at], n_rays, rng))

    over_random_blocks(len(traced), BLOCK // n_rays, work, rng, progress.update)
    return ls0, ls1


def pixel_lobes(
    scene: Scene,
    photos: PhotoSamples,
    cameras: Sequence[Camera],
    roughness: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """:func:`specular_lobes` (n, 3) of all pixels, denoised, with half the rays.

    Args:
        cameras: of all views.
        roughness: (n,) Principled roughness at each pixel.
        irradiance: (n, 3) irradiance / pi at each pixel.
    """
    samples = photos.samples
    rows, region = np.arange(len(samples.face)), scene.regions[samples.face]
    ls0, ls1 = specular_lobes(scene, samples, rows, roughness, irradiance, max(1, n_rays // 2), rng, progress)
    traced = np.flatnonzero(roughness < SPECULAR_ROUGH)
    both = np.concatenate([ls0[traced], ls1[traced]], 1)
    smooth = denoise_lobes(both, samples, traced, region[traced], roughness[traced], cameras)
    ls0[traced], ls1[traced] = smooth[:, :3], smooth[:, 3:]
    return ls0, ls1


def subtract_specular(
    ls0: NDArray[np.floating], ls1: NDArray[np.floating], metallic: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(n, 3) specular radiance to subtract before a colour is fitted: all of a dielectric's, and ``Ls1`` alone of a
    metal, whose colour explains ``Ls0``."""
    return (DIELECTRIC_F0 * (1 - metallic))[:, None].astype(np.float32) * ls0 + ls1


# ---- Denoising ------------------------------------------------------------------------------------------------------


def denoise_lobes(
    lobes: NDArray[np.float32],
    samples: PixelSamples,
    rows: NDArray[np.integer],
    region: NDArray[np.integer],
    roughness: NDArray[np.floating],
    cameras: Sequence[Camera],
) -> NDArray[np.float32]:
    """Lobes (n, C) of the pixels ``rows`` (n,), averaged over neighbours that reflect nearly the same direction.

    The radiance in a lobe changes over the width of the lobe. If the reflected directions of two neighbouring pixels
    differ by less, the rays of one serve the other. Three passes with doubled steps (à trous, Dammertz et al. 2010)
    cover 225 pixels with 27 samples. The filter stops at borders of regions and where the reflected direction turns by
    more than the lobe's width, so mirrors keep sharp images.

    Args:
        region, roughness: (n,) of each pixel.
        cameras: of the views, for the width of their photos.
    """
    lattice = Lattice.of(samples.view[rows], samples.pixel[rows], cameras, max(DENOISE_STEPS))
    normal, toward = samples.normal[rows], samples.direction[rows]
    reflected = (2 * dot(normal, toward)[:, None] * normal - toward).astype(np.float32)
    precision = 0.5 / (np.float32(DENOISE_TURN) * ray_alpha(roughness)) ** 2
    for step in DENOISE_STEPS:
        smooth, noisy = np.empty_like(lobes), lobes

        def work(block: slice, step: int, smooth: NDArray[np.float32], noisy: NDArray[np.float32]) -> None:
            places = lattice.slot[block], lattice.pitch[block], lattice.occupant
            _average(block.start, *places, step, region, reflected, precision, noisy, smooth)

        over_blocks(len(lobes), BLOCK // 4, partial(work, step=step, smooth=smooth, noisy=noisy))
        lobes = smooth
    return lobes


@kernel
def _average(
    first: int,
    slot: NDArray[np.int64],
    pitch: NDArray[np.int64],
    occupant: NDArray[np.int32],
    step: int,
    region: NDArray[np.integer],
    reflected: NDArray[np.float32],
    precision: NDArray[np.float32],
    noisy: NDArray[np.float32],
    smooth: NDArray[np.float32],
) -> None:
    """One pass: the weighted mean over each pixel and eight others, ``step`` rows and columns away.

    Args:
        first: the first pixel of the block.
        reflected: (n, 3) unit vectors.
        precision: (n,) of the filter in the reflected direction.
        noisy, smooth: (n, C) lobes before and after.
    """
    for k in range(len(slot)):
        own, norm = first + k, 1.0
        for c in range(noisy.shape[1]):
            smooth[own, c] = noisy[own, c]
        for down in range(-1, 2):
            for across in range(-1, 2):
                near = occupant[slot[k] + step * (down * pitch[k] + across)]
                if near < 0 or near == own or region[near] != region[own]:
                    continue
                turn = 0.0
                for axis in range(3):
                    turn += (reflected[near, axis] - reflected[own, axis]) ** 2
                weight = (DENOISE_CORNER if down and across else DENOISE_SIDE) * math.exp(-precision[own] * turn)
                norm += weight
                for c in range(noisy.shape[1]):
                    smooth[own, c] += weight * noisy[near, c]
        for c in range(noisy.shape[1]):
            smooth[own, c] /= norm
