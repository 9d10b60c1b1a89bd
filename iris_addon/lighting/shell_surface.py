"""What the shell around a mesh with holes reflects, where these are gaps in a scan of walls.

What photos show through such a hole is a surface under the light of the room: put out a lamp, and it darkens. Its
albedo is the radiance shown over the irradiance there. Where that is more than a surface can reflect one looks outside,
at light that does not depend on that of the room.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.progress import Progress
from ..base.random_streams import stream
from ..model.recovered import Backdrop
from ..model.sphere import equirect_directions
from ..rays.sampling import Origins
from ..transport.form_factors import emitter_form_factors
from ..transport.gather import gather
from ..transport.transport import radiance_table, table_rows, targets_of
from .backdrop import HEIGHT, Beyond, Shell, blurred_panorama
from .balance import MAX_ALBEDO
from .lamp_radiance import mean_radiance
from .problem import LightProblem, Lights

COARSENESS = 4
"""Texels of the picture, across and down, that share one measurement of the light, which is smooth."""
RAYS, SHADOW_RAYS = 64, 16
NEIGHBOURS = 16
TURNED = 1.0
"""Metres that a normal turned by a radian counts for: the wall around a hole, not the table before it."""


def as_surface(beyond: Beyond, problem: LightProblem, lights: Lights, progress: Progress) -> Backdrop | None:
    """The backdrop with what it reflects of ``lights``, and only the rest, what one sees outside, in its picture."""
    if beyond.backdrop is None or beyond.shell is None:
        return None
    shown = beyond.backdrop.picture
    light = _irradiance(beyond, beyond.shell, problem, lights, progress)
    outside = shown.mean(-1, keepdims=True) > MAX_ALBEDO * light.mean(-1, keepdims=True)
    albedo = np.clip(shown / np.maximum(light, 1e-9), 0.0, MAX_ALBEDO).astype(np.float32)
    return replace(beyond.backdrop, picture=np.where(outside, shown, 0), albedo=np.where(outside, 0, albedo))


def _irradiance(
    beyond: Beyond, shell: Shell, problem: LightProblem, lights: Lights, progress: Progress
) -> NDArray[np.float64]:
    """(H, 2 H, 3) irradiance / pi of the surfaces that the shell stands for.

    It stands behind them, and the walls around a hole keep light from it that reaches them. These walls themselves have
    about as much; where there are none, none is kept from it.
    """
    height = HEIGHT // COARSENESS
    place, normal = shell.places(equirect_directions(2 * height, height).reshape(-1, 3))
    at_itself = _at(place, normal, beyond, problem, lights, progress)
    light = np.maximum(_of_neighbours(place, normal, problem, lights), at_itself)
    fine = light.reshape(height, 2 * height, 3).repeat(COARSENESS, 0).repeat(COARSENESS, 1)
    return blurred_panorama(fine, COARSENESS / 2)


def _of_neighbours(
    place: NDArray[np.floating], normal: NDArray[np.floating], problem: LightProblem, lights: Lights
) -> NDArray[np.float64]:
    """(n, 3) irradiance / pi of the seen patches near points (n, 3) that face alike, weighted by nearness."""
    origins = problem.transport.origins
    known = cKDTree(np.concatenate([origins.position.mean(1), TURNED * origins.normal.mean(1)], 1))
    k = min(NEIGHBOURS, problem.transport.n_seen)
    distance, patch = known.query(np.concatenate([place, TURNED * normal], 1), np.arange(1, k + 1))
    weight = 1 / np.maximum(distance, 1e-9)
    weight /= weight.sum(1, keepdims=True)
    return np.einsum("nk,nkc->nc", weight, lights.irradiance[patch])


def _at(
    place: NDArray[np.floating],
    normal: NDArray[np.floating],
    beyond: Beyond,
    problem: LightProblem,
    lights: Lights,
    progress: Progress,
) -> NDArray[np.float64]:
    """(n, 3) irradiance / pi at points (n, 3) of the shell itself."""
    origins = Origins(*(column.astype(np.float32)[:, None] for column in (place, normal)))
    rng = stream(problem.seed, "lighting.shell_irradiance")
    rays, point = gather(problem.tracer, origins, RAYS, rng, progress)
    target = targets_of(problem.tracer, problem.transport.grid, problem.regions, rays, point)
    table = radiance_table(lights.patch_radiance, mean_radiance(lights.patch_radiance, problem))
    radiance = table[table_rows(target, rays.face, lights.mask)]
    row, ray = np.nonzero(rays.face < 0)
    start = (place + problem.tracer.epsilon * normal)[row]
    texel = beyond.texels(start, rays.direction[row, ray])
    radiance[row, ray] = beyond.radiance[texel] * (texel >= 0)[:, None]
    factors = emitter_form_factors(problem.tracer, origins, rays, lights.emitters, SHADOW_RAYS, rng, progress)
    return radiance.mean(1) + factors[..., 0] @ lights.radiance
