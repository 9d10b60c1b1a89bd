"""The specular lobes towards the cameras, from cached reflected rays: equation (3).

The split ``L = kd Fd Ld + ks Ls0(σ) + Ls1(σ)``, equation (2), is FIPT's (Wu et al. 2023, eq. 6) with another Fresnel
term. Both lobes are integrals of incoming radiance. Most of their rays are drawn from the visible GGX normals, some are
aimed at lamps (:class:`LampAim`). They are traced once per roughness, and what they meet is kept (:class:`LobeRays`),
so that a new guess of the lamps costs one look-up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined, kernel, rows_of
from ..base.parallel import BLOCK, over_blocks, over_random_blocks
from ..brdf.diffuse import cosine_of_schlick
from ..brdf.ggx import ray_alpha
from ..brdf.ggx_sampling import visible_normal_density, visible_normal_weights
from ..lighting.backdrop import SeenBackdrop
from ..model.lamp_profile import LampProfile
from ..model.response import LUMINANCE
from ..rays.sampling import Vector, ggx_direction, grazing, r2_sequence, vector
from ..rays.tracer import Tracer
from ..surface.patches import Lookup
from ..surface.primary_rays import PixelSamples
from ..transport.form_factors import emitter_of_face
from ..transport.gather import ESCAPED, find_patch
from ..transport.transport import Transport, radiance_table

AIMED_EVERY = 3
"""One ray in so many is aimed at a lamp."""
AIMED_MIN_WEIGHT = 1e-7
"""Weight below which a ray aimed at a lamp is not cast."""


@dataclass(frozen=True)
class Scene:
    """Light and materials that reflected rays meet.

    Attributes:
        regions: (F,) region of each face.
        sample_patch: (n,) patch of every pixel.
        patch_radiance: (N, 3) reflected radiance, scene-linear Rec.709.
        face_emission: (F, 3) emitted radiance.
        unknown: (3,) radiance of surfaces without a patch.
        backdrop: what escaping rays meet.
        aim: how rays are aimed at lamps.
        lamp_share: (N,) what each patch on a lamp emits over ``face_emission``, 1 elsewhere; None where all are even.
        profiled: faces and profile of the lamps that do not shine alike in all directions.
    """

    tracer: Tracer
    transport: Transport
    regions: NDArray[np.int32]
    sample_patch: NDArray[np.integer]
    patch_radiance: NDArray[np.floating]
    face_emission: NDArray[np.floating]
    unknown: NDArray[np.floating]
    backdrop: SeenBackdrop
    aim: LampAim
    lamp_share: NDArray[np.floating] | None = None
    profiled: Sequence[tuple[NDArray[np.int64], LampProfile]] = ()

    def lobes(self, rays: LobeRays) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """``Ls0`` and ``Ls1`` (n, 3) of equation (3) at the points of the reflected ``rays``."""
        for faces, profile in self.profiled:
            rays = rays.towards(faces, profile, len(self.face_emission))
        return rays.radiance(*self._met, self.face_emission, self.unknown, self.lamp_share)

    @cached_property
    def _met(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Radiance (N + T, 3) of what rays meet, patches and then texels of the backdrop, and the kappa (N + T,) of
        their diffuse lobes."""
        texels = self.backdrop.radiance
        radiance = np.concatenate([self.patch_radiance, texels])
        return radiance, np.concatenate([self.transport.kappa, np.zeros(len(texels))])


def trace_lobes(
    scene: Scene,
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
) -> LobeRays:
    """Reflected rays of some pixels, weighted by equation (23).

    Args:
        rows: (n,) the pixels among ``samples``.
        roughness: (n,) Principled roughness.
        n_rays: per pixel, those aimed at lamps included.
    """
    rays = LobeRays.nothing(len(rows), n_rays)

    def work(block: slice, rng: np.random.Generator) -> None:
        _trace_block(scene, samples, rows[block], roughness[block], rows_of(rays, block), rng)

    over_random_blocks(len(rows), BLOCK // n_rays, work, rng)
    return rays


def _trace_block(
    scene: Scene,
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    rays: LobeRays,
    rng: np.random.Generator,
) -> None:
    """Fill ``rays`` with the reflected rays of the pixels ``rows``.

    The weight of equation (23) divides by the density of all rays of a pixel, drawn and aimed, wherever a ray may be
    aimed. Surfaces that are no lamp are met by drawn rays only.
    """
    n, n_rays = rays.target.shape
    n_aimed = n_rays // AIMED_EVERY if len(scene.aim.faces) else 0
    n_drawn = n_rays - n_aimed
    points = _Points(
        samples.position[rows],
        samples.normal[rows],
        samples.direction[rows],
        ray_alpha(roughness),
        scene.sample_patch[rows],
    )
    meets = _Meets(scene.transport.grid.lookup, scene.tracer.normals, scene.regions)

    cast = _Cast.empty(n * n_drawn)
    count = _draw(points, scene.tracer.epsilon, r2_sequence(n, n_drawn, rng), cast, rays)
    cast = rows_of(cast, slice(count))
    hits = scene.tracer.closest(cast.start, cast.along)
    _arrive(points, cast, hits.face, hits.distance, meets, scene.aim, n_drawn, n_aimed, rays)
    _escape(rows_of(cast, hits.face < 0), scene, rays)
    if n_aimed:
        cast = _Cast.empty(n * n_aimed)
        u = rng.random((n, n_aimed, 4), np.float32)
        count = _aim(points, scene.tracer.epsilon, u, scene.aim, n_drawn, cast, rays)
        cast = rows_of(cast, slice(count))
        clear = scene.tracer.unoccluded(cast.start, cast.along, cast.length)
        _arrive_on_lamps(cast, clear, meets, rays)


class _Points(NamedTuple):
    """Where the rays of n pixels start.

    Attributes:
        position: (n, 3) metres.
        normal, toward: (n, 3) unit normals, and directions to the camera.
        alpha: (n,) GGX width.
        patch: (n,) patch of each pixel.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    toward: NDArray[np.float32]
    alpha: NDArray[np.float32]
    patch: NDArray[np.integer]


class _Cast(NamedTuple):
    """Rays to be traced.

    Attributes:
        start, along: (m, 3) metres, and unit directions.
        length: (m,) metres, of aimed rays only.
        row, column: (m,) pixel of each, and its number among the rays of that pixel.
    """

    start: NDArray[np.float32]
    along: NDArray[np.float32]
    length: NDArray[np.float32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]

    @staticmethod
    def empty(n: int) -> _Cast:
        """Memory for ``n`` rays."""
        start, along = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        return _Cast(start, along, np.empty(n, np.float32), np.empty(n, np.int32), np.empty(n, np.int32))


class _Meets(NamedTuple):
    """What identifies the patch that a ray meets: the grid of patches, and normals (F, 3) and regions (F,) of faces."""

    grid: Lookup
    normals: NDArray[np.float32]
    regions: NDArray[np.int32]


@inlined
def _cast_ray(
    cast: _Cast, at: Integer, points: _Points, i: Integer, epsilon: float, d: Vector, column: Integer
) -> None:
    """Write the ray from point ``i`` in direction ``d`` to place ``at`` of ``cast``."""
    for axis in range(3):
        cast.start[at, axis] = points.position[i, axis] + epsilon * points.normal[i, axis]
        cast.along[at, axis] = d[axis]
    cast.row[at], cast.column[at] = i, column


@kernel
def _draw(points: _Points, epsilon: float, u: NDArray[np.float32], cast: _Cast, rays: LobeRays) -> int:
    """Cast rays off visible normals, from points (n, S, 2) of the unit square; returns how many leave the surface."""
    count = 0
    for i in range(u.shape[0]):
        n, o, alpha = vector(points.normal, i), vector(points.toward, i), points.alpha[i]
        for j in range(u.shape[1]):
            x, y, z, half = ggx_direction(n, o, alpha, u[i, j, 0], u[i, j, 1])
            w0, w1 = visible_normal_weights(x * n[0] + y * n[1] + z * n[2], half, alpha)
            if w0 + w1 > 0:
                rays.weight0[i, j], rays.weight1[i, j] = w0, w1
                _cast_ray(cast, count, points, i, epsilon, (x, y, z), j)
                count += 1
    return count


@kernel
def _arrive(
    points: _Points,
    cast: _Cast,
    face: NDArray[np.int32],
    distance: NDArray[np.float32],
    meets: _Meets,
    aim: LampAim,
    n_drawn: int,
    n_aimed: int,
    rays: LobeRays,
) -> None:
    """Write to ``rays`` what the drawn rays ``cast`` meet, and their weights by equation (23).

    Args:
        face, distance: (m,) face hit, negative for none, and metres to it.
        n_drawn, n_aimed: rays of each pixel.
    """
    for k in range(len(face)):
        i, j, f, reach = cast.row[k], cast.column[k], face[k], distance[k]
        share = 1.0 / n_drawn
        if f >= 0:
            d = vector(cast.along, k)
            cosine = d[0] * meets.normals[f, 0] + d[1] * meets.normals[f, 1] + d[2] * meets.normals[f, 2]
            lamp = aim.label[f]
            if n_aimed and lamp >= 0 and aim.chance[points.patch[i], lamp] > 0:
                n, o = vector(points.normal, i), vector(points.toward, i)
                drawn = visible_normal_density(n, o, d, points.alpha[i])
                aimed = aimed_density(aim, points.patch[i], lamp, reach, cosine)
                share = drawn / (n_drawn * drawn + n_aimed * aimed)
            x, y, z = cast.start[k, 0] + reach * d[0], cast.start[k, 1] + reach * d[1], cast.start[k, 2] + reach * d[2]
            rays.face[i, j] = f
            rays.target[i, j] = find_patch(meets.grid, meets.normals, meets.regions, f, x, y, z, d[0], d[1], d[2])
            rays.schlick[i, j] = grazing(abs(cosine))
        rays.weight0[i, j] *= share
        rays.weight1[i, j] *= share


def _escape(cast: _Cast, scene: Scene, rays: LobeRays) -> None:
    """Write to ``rays`` the texels of the backdrop that the escaping rays ``cast`` meet."""
    texel = scene.backdrop.texels(cast.start, cast.along)
    met = texel >= 0
    rays.target[cast.row[met], cast.column[met]] = texel[met] + scene.transport.n_patches


@kernel
def _aim(
    points: _Points, epsilon: float, u: NDArray[np.float32], aim: LampAim, n_drawn: int, cast: _Cast, rays: LobeRays
) -> int:
    """Cast rays to points on lamps, from numbers (n, S, 4) in [0, 1); returns how many have a noticeable weight."""
    count, n_aimed = 0, u.shape[1]
    for i in range(u.shape[0]):
        n, o, alpha, patch = vector(points.normal, i), vector(points.toward, i), points.alpha[i], points.patch[i]
        for j in range(n_aimed):
            lamp = lamp_after(aim, patch, (j + u[i, j, 0]) / n_aimed)
            if lamp < 0:
                break
            face, x, y, z = point_on_lamp(aim, lamp, u[i, j, 1], u[i, j, 2], u[i, j, 3])
            x -= points.position[i, 0] + epsilon * n[0]
            y -= points.position[i, 1] + epsilon * n[1]
            z -= points.position[i, 2] + epsilon * n[2]
            length = max(math.sqrt(x * x + y * y + z * z), 1e-9)
            x, y, z = x / length, y / length, z / length
            half = math.sqrt(min(max(0.5 + 0.5 * (x * o[0] + y * o[1] + z * o[2]), 0.0), 1.0))
            w0, w1 = visible_normal_weights(x * n[0] + y * n[1] + z * n[2], half, alpha)
            if w0 + w1 > 0:
                cosine = x * aim.normals[face, 0] + y * aim.normals[face, 1] + z * aim.normals[face, 2]
                drawn = visible_normal_density(n, o, (x, y, z), alpha)
                share = drawn / (n_drawn * drawn + n_aimed * aimed_density(aim, patch, lamp, length, cosine))
                if (w0 + w1) * share > AIMED_MIN_WEIGHT:
                    column = n_drawn + j
                    _cast_ray(cast, count, points, i, epsilon, (x, y, z), column)
                    cast.length[count] = length
                    rays.face[i, column] = face
                    rays.weight0[i, column], rays.weight1[i, column] = w0 * share, w1 * share
                    rays.schlick[i, column] = grazing(abs(cosine))
                    count += 1
    return count


@kernel
def _arrive_on_lamps(cast: _Cast, clear: NDArray[np.bool_], meets: _Meets, rays: LobeRays) -> None:
    """Write to ``rays`` the patches that aimed rays meet; the rays that are not ``clear`` (m,) are dropped."""
    for k in range(len(clear)):
        i, j, reach = cast.row[k], cast.column[k], cast.length[k]
        face = rays.face[i, j]
        if clear[k]:
            d = vector(cast.along, k)
            x, y, z = cast.start[k, 0] + reach * d[0], cast.start[k, 1] + reach * d[1], cast.start[k, 2] + reach * d[2]
            rays.target[i, j] = find_patch(meets.grid, meets.normals, meets.regions, face, x, y, z, d[0], d[1], d[2])
        else:
            rays.face[i, j] = -1
            rays.weight0[i, j] = rays.weight1[i, j] = rays.schlick[i, j] = 0.0


# ---- Cached rays ----------------------------------------------------------------------------------------------------


class LobeRays(NamedTuple):
    """S reflected rays of each of n points, at one roughness per point.

    Attributes:
        target: (n, S) int32 patch hit, N + t for texel t of the backdrop, UNKNOWN or ESCAPED.
        face: (n, S) int32 face hit, -1 where escaped.
        weight0, weight1: (n, S) float32 weights of equation (23) in ``Ls0`` and ``Ls1``.
        schlick: (n, S) float32 Schlick's S of the angle at which each ray arrives.
    """

    target: NDArray[np.int32]
    face: NDArray[np.int32]
    weight0: NDArray[np.float32]
    weight1: NDArray[np.float32]
    schlick: NDArray[np.float32]

    @staticmethod
    def nothing(n: int, n_rays: int) -> LobeRays:
        """Rays that meet nothing."""
        shape = n, n_rays
        weight0, weight1, schlick = (np.zeros(shape, np.float32) for _ in range(3))
        return LobeRays(np.full(shape, ESCAPED, np.int32), np.full(shape, -1, np.int32), weight0, weight1, schlick)

    def towards(self, faces: NDArray[np.integer], profile: LampProfile, n_faces: int) -> LobeRays:
        """The same rays, weighed by the ``profile`` of a lamp of ``faces`` where they meet it."""
        on = np.zeros(n_faces + 1, bool)  # the last entry is for rays that meet no face
        on[faces] = True
        met = np.nonzero(on[self.face])
        share = profile.at(cosine_of_schlick(self.schlick[met]))
        weight0, weight1 = self.weight0.copy(), self.weight1.copy()
        weight0[met] *= share
        weight1[met] *= share
        return self._replace(weight0=weight0, weight1=weight1)

    def radiance(
        self,
        met: NDArray[np.floating],
        kappa: NDArray[np.floating],
        face_emission: NDArray[np.floating],
        unknown: NDArray[np.floating],
        lamp_share: NDArray[np.floating] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """``Ls0`` and ``Ls1``, (n, 3) each.

        Args:
            met: (N + T, 3) reflected radiance of every patch, and radiance of every texel of the backdrop.
            kappa: (N + T,) grazing gain of their diffuse lobes.
            face_emission: (F, 3) emitted radiance.
            unknown: (3,) radiance of hits without a patch.
            lamp_share: (N,) of :class:`Scene`.
        """
        n, samples = self.target.shape
        lobes = np.empty((2, n, 3), np.float32)
        table = radiance_table(met, unknown)
        own = np.append(kappa, [0.0, 0.0])  # the last two for ESCAPED and UNKNOWN
        emitted, emits, share = face_emission.astype(np.float32), face_emission.any(1), np.ones(len(own), np.float32)
        if lamp_share is not None:
            share[: len(lamp_share)] = lamp_share
        of_hits = table, own, emitted, emits, share
        over_blocks(n, BLOCK // samples, lambda rows: _sum_up(rows_of(self, rows), *of_hits, lobes[:, rows]))
        return lobes[0], lobes[1]


@kernel
def _sum_up(
    rays: LobeRays,
    table: NDArray[np.float32],
    kappa: NDArray[np.float64],
    emitted: NDArray[np.float32],
    emits: NDArray[np.bool_],
    share: NDArray[np.float32],
    lobes: NDArray[np.float32],
) -> None:
    """Fill both ``lobes`` (2, n, 3): weighted sums of the emission of lamps and the radiance of patches."""
    for i in range(rays.target.shape[0]):
        for c in range(3):
            lobes[0, i, c] = lobes[1, i, c] = 0.0
        for j in range(rays.target.shape[1]):
            w0, w1 = rays.weight0[i, j], rays.weight1[i, j]
            if w0 + w1 > 0:
                face, target, spread = rays.face[i, j], rays.target[i, j], 1.0
                on_lamp = face >= 0 and emits[face]
                if on_lamp:
                    spread = share[target]
                else:
                    spread += kappa[target] * rays.schlick[i, j]
                for c in range(3):
                    light = spread * (emitted[face, c] if on_lamp else table[target, c])
                    lobes[0, i, c] += w0 * light
                    lobes[1, i, c] += w1 * light


# ---- Rays aimed at lamps --------------------------------------------------------------------------------------------


class LampAim(NamedTuple):
    """How rays from each of P patches are aimed at E lamps.

    A wide lobe meets a small lamp with one ray in hundreds, which then carries all of its light; in such noise a matte
    wall and a varnished one look alike. Rays aimed at lamps always meet them, but are useless for narrow lobes. Both
    are combined by the balance heuristic (Veach 1997, eq. 9.8), like light at patches in equation (8).

    Attributes:
        corners: (F, 3, 3) of the mesh's faces, metres.
        normals: (F, 3) unit normals.
        faces: (K,) faces of all lamps, one lamp after the other.
        cumulative: (K,) area of ``faces`` up to and including each, square metres.
        end: (E,) value of ``cumulative`` at the last face of each lamp.
        area: (E,) square metres.
        label: (F + 1,) lamp of every face, -1 for none; the last entry, index -1, stands for a ray that hits no face.
        chance: (P, E) probability that a ray is aimed at each lamp, its share of the light there. Rows of patches that
            no lamp lights are zero.
    """

    corners: NDArray[np.floating]
    normals: NDArray[np.float32]
    faces: NDArray[np.int64]
    cumulative: NDArray[np.float64]
    end: NDArray[np.float64]
    area: NDArray[np.float64]
    label: NDArray[np.int64]
    chance: NDArray[np.float32]

    @staticmethod
    def at(
        tracer: Tracer,
        emitters: Sequence[NDArray[np.integer]],
        radiance: NDArray[np.floating],
        form_factors: NDArray[np.floating],
    ) -> LampAim:
        """Aim in proportion to the light of lamps of ``radiance`` (E, 3) with ``form_factors`` (P, E)."""
        power = form_factors * np.maximum(radiance @ LUMINANCE, 0.0)
        faces = np.concatenate([np.zeros(0, np.int64), *emitters]).astype(np.int64)
        cumulative = np.cumsum(tracer.areas[faces], dtype=np.float64)
        end = cumulative[np.cumsum([len(lamp) for lamp in emitters], dtype=np.int64) - 1]
        return LampAim(
            corners=tracer.corners,
            normals=tracer.normals,
            faces=faces,
            cumulative=cumulative,
            end=end,
            area=np.diff(end, prepend=0.0),
            label=emitter_of_face(emitters, len(tracer.areas)),
            chance=(power / np.maximum(power.sum(1, keepdims=True), 1e-12)).astype(np.float32),
        )

    @staticmethod
    def nowhere(tracer: Tracer) -> LampAim:
        """No aim: for a room without lamps, or to leave all lamps to drawn rays."""
        return LampAim.at(tracer, [], np.zeros((0, 3)), np.zeros((0, 0), np.float32))


@inlined
def lamp_after(aim: LampAim, patch: Integer, chosen: Real) -> Integer:
    """The lamp that the number ``chosen`` in [0, 1) selects from ``patch``, -1 if no lamp lights it."""
    last, total = -1, 0.0
    for lamp in range(len(aim.area)):
        total += aim.chance[patch, lamp]
    upto = 0.0
    for lamp in range(len(aim.area)):
        if aim.chance[patch, lamp] > 0:
            last = lamp
            upto += aim.chance[patch, lamp]
            if chosen * total < upto:
                break
    return last


@inlined
def point_on_lamp(aim: LampAim, lamp: Integer, along: Real, u: Real, v: Real) -> tuple[Integer, Real, Real, Real]:
    """Face and position of a point uniformly distributed over a lamp, from three numbers in [0, 1)."""
    area = aim.end[lamp] - aim.area[lamp] * along
    face = aim.faces[min(np.searchsorted(aim.cumulative, area), len(aim.faces) - 1)]
    if u + v > 1:
        u, v = 1 - u, 1 - v
    c, w = aim.corners, 1 - u - v
    return (
        face,
        w * c[face, 0, 0] + u * c[face, 1, 0] + v * c[face, 2, 0],
        w * c[face, 0, 1] + u * c[face, 1, 1] + v * c[face, 2, 1],
        w * c[face, 0, 2] + u * c[face, 1, 2] + v * c[face, 2, 2],
    )


@inlined
def aimed_density(aim: LampAim, patch: Integer, lamp: Integer, distance: Real, cosine: Real) -> Real:
    """Probability density per steradian of a ray aimed from ``patch`` at a point of ``lamp``.

    Args:
        distance: metres to the point.
        cosine: between the ray and the lamp's normal, of either sign.
    """
    return aim.chance[patch, lamp] / aim.area[lamp] * distance * distance / max(abs(cosine), 1e-6)
