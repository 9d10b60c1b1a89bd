"""Specular radiance of observations and pixels under the materials and lamps at hand."""

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

ROUGH = 0.75
"""From this roughness on the lobe is so wide that it sees about what the whole hemisphere sees."""


def rough_lobes(
    roughness: NDArray[np.floating], cosine: NDArray[np.floating], irradiance: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """``Ls0`` and ``Ls1`` (n, 3) of lobes that see what the hemisphere sees: free of the noise of few rays.

    Args:
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
    """``Ls0`` and ``Ls1`` (n, 3) of the pixels ``rows``: traced where glossy, from irradiance where rough.

    Args:
        roughness: (n,) Principled roughness at each pixel.
        irradiance: (n, 3) irradiance / pi at each pixel.
    """
    rough, traced = np.flatnonzero(roughness >= ROUGH), np.flatnonzero(roughness < ROUGH)
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
    """:func:`specular_lobes` of all pixels, which then take the noise off each other and so need half the rays.

    Args:
        cameras: of all views.
        roughness: (n,) Principled roughness at each pixel.
        irradiance: (n, 3) irradiance / pi at each pixel.
    """
    samples = photos.samples
    rows, region = np.arange(len(samples.face)), scene.regions[samples.face]
    ls0, ls1 = specular_lobes(scene, samples, rows, roughness, irradiance, max(1, n_rays // 2), rng, progress)
    traced = np.flatnonzero(roughness < ROUGH)
    both = np.concatenate([ls0[traced], ls1[traced]], 1)
    smooth = denoise_lobes(both, samples, traced, region[traced], roughness[traced], cameras, photos.stride)
    ls0[traced], ls1[traced] = smooth[:, :3], smooth[:, 3:]
    return ls0, ls1


def subtract_specular(
    ls0: NDArray[np.floating], ls1: NDArray[np.floating], metallic: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(n, 3) specular radiance to take off a dielectric; metals keep ``ks Ls0``, which their colour explains."""
    return (DIELECTRIC_F0 * (1 - metallic))[:, None].astype(np.float32) * ls0 + ls1


# ---- Noise taken off specular lobes: pixels side by side reflect nearly the same things -----------------------------
#
# What a lobe sees changes over the width of the lobe. Where neighbours of a pixel reflect towards less than that, their
# rays serve it too. Passes with doubled steps (à trous, Dammertz et al. 2010) let 27 looks cover 225 pixels; what stops
# them are the borders of regions and the turn of the reflected direction, held against the width of the lobe: mirrors
# keep their images sharp.


STEPS = (1, 2, 4)
REACH = 0.6
"""Turn of the reflected direction, in GGX widths, that is one standard deviation of the filter."""
SIDE, CORNER = 0.5, 0.25
"""Say of the eight neighbours against the pixel's own: a binomial kernel."""


def denoise_lobes(
    lobes: NDArray[np.float32],
    samples: PixelSamples,
    rows: NDArray[np.integer],
    region: NDArray[np.integer],
    roughness: NDArray[np.floating],
    cameras: Sequence[Camera],
    stride: int,
) -> NDArray[np.float32]:
    """Lobes (n, C) of the pixels ``rows`` (n,), averaged over neighbours that reflect the same.

    Args:
        part, roughness: (n,) of each pixel.
        cameras: of the views, for the width of their photos.
        stride: spacing of the lattice of pixels, see :func:`iris_addon.surface.primary_rays.pixel_lattice`.
    """
    lattice = Lattice.of(samples.view[rows], samples.pixel[rows], cameras, stride, max(STEPS))
    normal, toward = samples.normal[rows], samples.direction[rows]
    reflected = (2 * dot(normal, toward)[:, None] * normal - toward).astype(np.float32)
    precision = 0.5 / (np.float32(REACH) * ray_alpha(roughness)) ** 2
    for step in STEPS:
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
    """One pass: the mean over a pixel and eight others, ``step`` rows and columns away; of pixels from ``first`` on."""
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
                say = (CORNER if down and across else SIDE) * math.exp(-precision[own] * turn)
                norm += say
                for c in range(noisy.shape[1]):
                    smooth[own, c] += say * noisy[near, c]
        for c in range(noisy.shape[1]):
            smooth[own, c] /= norm
