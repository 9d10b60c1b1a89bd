"""Specular radiance of observations and pixels under the materials and lamps at hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..parallel import BLOCK, over_blocks, over_random_blocks
from ..progress import Progress
from ..surface.samples import PixelSamples
from .ggx import DIELECTRIC_F0, specular_integrals
from .gloss import Gloss
from .lobe_filter import denoise_lobes
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
    gloss: Gloss,
    samples: PixelSamples,
    rows: NDArray[np.integer],
    part: NDArray[np.integer],
    irradiance: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """``Ls0`` and ``Ls1`` (n, 3) of the pixels ``rows``: traced where glossy, from irradiance where rough.

    Args:
        part: (n,) part of each pixel.
        irradiance: (n, 3) irradiance / pi at each pixel.
    """
    roughness = gloss.roughness[part]
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
    gloss: Gloss,
    samples: PixelSamples,
    irradiance: NDArray[np.floating],
    cameras: Sequence[Camera],
    stride: int,
    n_rays: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """:func:`specular_lobes` of all pixels, which then take the noise off each other and so need half the rays.

    Args:
        cameras, stride: of the lattice that the pixels are of.
    """
    rows, part = np.arange(len(samples.face)), scene.parts[samples.face]
    ls0, ls1 = specular_lobes(scene, gloss, samples, rows, part, irradiance, max(1, n_rays // 2), rng, progress)
    roughness = gloss.roughness[part]
    traced = np.flatnonzero(roughness < ROUGH)
    both = np.concatenate([ls0[traced], ls1[traced]], 1)
    smooth = denoise_lobes(both, samples, traced, part[traced], roughness[traced], cameras, stride)
    ls0[traced], ls1[traced] = smooth[:, :3], smooth[:, 3:]
    return ls0, ls1


def subtract_specular(
    ls0: NDArray[np.floating], ls1: NDArray[np.floating], metallic: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(n, 3) specular radiance to take off a dielectric; metals keep ``ks Ls0``, which their colour explains."""
    return (DIELECTRIC_F0 * (1 - metallic))[:, None].astype(np.float32) * ls0 + ls1
