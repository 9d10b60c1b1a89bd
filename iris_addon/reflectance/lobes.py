"""Specular radiance toward the cameras, by cached reflected rays.

FIPT's split (Wu et al. 2023, eq. 6): ``L_r = kd Ld + ks Ls0(σ) + Ls1(σ)`` with F0 = 1 - F1, F1 = (1 - h·ωi)^5. The
two lobes are integrals of incoming radiance. Most of their rays are drawn from the visible GGX normals, some are aimed
at lamps. They are traced once per roughness, and what they hit is kept, so that a new guess of the lamps costs one
look-up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..parallel import BLOCK, over_blocks, over_random_blocks
from ..surface.samples import PixelSamples
from ..transport.diffuse import schlick
from ..transport.sampling import dot, ggx_directions, r2_sequence
from ..transport.tracer import Tracer
from ..transport.transport import Transport, find_patches, radiance_table
from .ggx import ray_alpha
from .lamp_aim import LampAim
from .specular_weights import visible_normal_density, visible_normal_weights

AIMED = 3
"""One ray of so many is aimed at a lamp."""


@dataclass(frozen=True)
class Scene:
    """Light and materials that reflected rays meet.

    Attributes:
        parts: (F,) part per face.
        sample_patch: (n,) patch of every pixel.
        patch_radiance: (N, 3) reflected radiance.
        face_emission: (F, 3).
        unknown: (3,) radiance of surfaces without a patch.
        aim: where rays are aimed at lamps; None lets the lobes find them all.
    """

    tracer: Tracer
    transport: Transport
    parts: NDArray[np.int32]
    sample_patch: NDArray[np.integer]
    patch_radiance: NDArray[np.floating]
    face_emission: NDArray[np.floating]
    unknown: NDArray[np.floating]
    aim: LampAim | None = None

    def lobes(self, rays: LobeRays) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """``Ls0`` and ``Ls1`` (n, 3) of the points whose reflected rays these are."""
        return rays.radiance(self.patch_radiance, self.transport.kappa, self.face_emission, self.unknown)


@dataclass(frozen=True)
class LobeRays:
    """Reflected rays of n points at one roughness each.

    Attributes:
        target: (n, S) int32 patch hit, UNKNOWN or ESCAPED.
        face: (n, S) int32 face hit, -1 where escaped.
        weight0, weight1: (n, S) float16, what the radiance each ray meets counts for in either lobe.
        schlick: (n, S) float16, S of the angle at which each ray arrives.
    """

    target: NDArray[np.int32]
    face: NDArray[np.int32]
    weight0: NDArray[np.float16]
    weight1: NDArray[np.float16]
    schlick: NDArray[np.float16]

    def shaped(self, columns: int) -> LobeRays:
        """As tables with so many columns."""
        return LobeRays(*(getattr(self, field.name).reshape(-1, columns) for field in fields(self)))

    def beside(self, other: LobeRays) -> LobeRays:
        """The rays of both, of the same n points."""
        pairs = ((getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return LobeRays(*(np.concatenate(pair, 1) for pair in pairs))

    def radiance(
        self,
        patch_radiance: NDArray[np.floating],
        kappa: NDArray[np.floating],
        face_emission: NDArray[np.floating],
        unknown: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """``Ls0`` and ``Ls1``, (n, 3) each.

        Args:
            patch_radiance: (N, 3) reflected radiance of every patch, and ``kappa`` (N,) of its diffuse lobe.
            face_emission: (F, 3).
            unknown: (3,) for hits without a patch.
        """
        table, emits = radiance_table(patch_radiance, unknown), face_emission.any(1)
        n, samples = self.target.shape
        ls0, ls1 = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)

        def work(rows: slice) -> None:
            target, face = self.target[rows], self.face[rows]
            own = np.where(target >= 0, kappa[target], 0.0)
            spread = (1 + own * self.schlick[rows]).astype(np.float32)
            incoming = table[target] * spread[..., None]
            on_lamp = (face >= 0) & emits[face]
            incoming[on_lamp] = face_emission[face[on_lamp]]
            for result, weight in ((ls0, self.weight0), (ls1, self.weight1)):
                result[rows] = np.einsum("ns,nsc->nc", weight[rows].astype(np.float32), incoming)

        over_blocks(n, BLOCK // samples, work)
        return ls0, ls1


def trace_lobes(
    scene: Scene,
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
) -> LobeRays:
    """Reflected rays of some pixels, on the calling thread alone.

    Args:
        rows: (n,) the pixels among ``samples``.
        roughness: (n,) Principled roughness.
        n_rays: per pixel, those aimed at lamps included.
    """
    normal, toward = samples.normal[rows], samples.direction[rows]
    origin = samples.position[rows] + scene.tracer.epsilon * normal
    points = _Points(origin, normal, toward, ray_alpha(roughness), scene.sample_patch[rows])
    n_aimed = 0 if scene.aim is None else n_rays // AIMED
    n_drawn = n_rays - n_aimed
    each = points.repeated(n_drawn)
    direction, half_cosine = ggx_directions(
        each.normal, each.toward, each.alpha, r2_sequence(len(rows), n_drawn, rng).reshape(-1, 2)
    )
    drawn = _trace(scene, each, direction, half_cosine, n_drawn, n_aimed)
    if scene.aim is None or not n_aimed:
        return drawn.shaped(n_drawn)
    each = points.repeated(n_aimed)
    target, face = scene.aim.points(points.patch, n_aimed, rng)
    aimed = _trace(scene, each, *_reflection(each, target), n_drawn, n_aimed, face)
    return drawn.shaped(n_drawn).beside(aimed.shaped(n_aimed))


@dataclass(frozen=True)
class _Points:
    """Where n rays start: (n, 3) just off the surface, unit normals and directions to the camera, (n,) GGX widths and
    patches."""

    origin: NDArray[np.floating]
    normal: NDArray[np.floating]
    toward: NDArray[np.floating]
    alpha: NDArray[np.floating]
    patch: NDArray[np.integer]

    def repeated(self, times: int) -> _Points:
        """Every point as often."""
        return _Points(*(np.repeat(getattr(self, field.name), times, 0) for field in fields(self)))


def _reflection(points: _Points, target: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Unit directions (n, 3) to ``target`` (n, 3) metres, and the cosine (n,) that the half vector has with them."""
    offset = target - points.origin
    direction = offset / np.maximum(np.sqrt(dot(offset, offset)), 1e-9)[:, None]
    half_cosine = np.sqrt(np.clip(0.5 + 0.5 * dot(direction, points.toward), 0, 1))
    return direction.astype(np.float32), half_cosine.astype(np.float32)


def _trace(
    scene: Scene,
    points: _Points,
    direction: NDArray[np.float32],
    half_cosine: NDArray[np.float32],
    n_drawn: int,
    n_aimed: int,
    face: NDArray[np.integer] | None = None,
) -> LobeRays:
    """Rays (n,) that are some of ``n_drawn`` + ``n_aimed`` per pixel.

    A ray counts for G1 F over the density of all rays of its pixel, which makes both kinds of rays alike; only what is
    no lamp is left to the drawn ones.

    Args:
        face: (n,) that the rays were aimed at, if they were; those that end elsewhere count for nothing.
    """
    weight0, weight1, above = visible_normal_weights(points.normal, direction, half_cosine, points.alpha)
    hits = scene.tracer.closest(points.origin, np.where(above[:, None], direction, points.normal))
    share = np.full(len(direction), 1 / n_drawn if face is None else 0.0)
    if scene.aim is not None and n_aimed:
        aimed = n_aimed * scene.aim.density(points.patch, hits, direction)
        both = np.flatnonzero(aimed if face is None else (hits.face == face) * aimed)
        drawn = visible_normal_density(points.normal[both], points.toward[both], direction[both], points.alpha[both])
        share[both] = drawn / (n_drawn * drawn + aimed[both])
    end = points.origin + direction * np.where(hits.face >= 0, hits.distance, 0)[:, None]
    target = find_patches(scene.tracer, scene.transport.grids, scene.parts, hits.face, end, direction)
    arrival = schlick(np.abs(dot(scene.tracer.normals[hits.face], direction)))
    weights = (weight0 * share).astype(np.float16), (weight1 * share).astype(np.float16)
    return LobeRays(target, hits.face, *weights, arrival.astype(np.float16))


def lobe_cache(
    scene: Scene,
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
) -> LobeRays:
    """:func:`trace_lobes` on all cores, for rays that are looked at more than once."""
    shape = (len(rows), n_rays)
    indices = np.empty(shape, np.int32), np.empty(shape, np.int32)
    weights = np.empty(shape, np.float16), np.empty(shape, np.float16), np.empty(shape, np.float16)
    cache = LobeRays(*indices, *weights)

    def work(block: slice, rng: np.random.Generator) -> None:
        piece = trace_lobes(scene, samples, rows[block], roughness[block], n_rays, rng)
        for field in fields(LobeRays):
            getattr(cache, field.name)[block] = getattr(piece, field.name)

    over_random_blocks(len(rows), BLOCK // n_rays, work, rng)
    return cache
