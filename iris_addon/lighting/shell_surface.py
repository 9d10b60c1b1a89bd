"""The backdrop as a reflecting surface, where holes of the mesh are gaps in a scan of walls.

What photos show through such a hole is a surface under the light of the room: switch off a lamp, and it darkens. Its
albedo is the radiance shown over the irradiance there, equation (22). Where that exceeds what a surface can reflect,
the hole is an opening to the outside, whose light does not depend on that of the room.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.progress import Progress
from ..base.random_streams import stream
from ..model.lamp_profile import profile_basis
from ..model.recovered import Backdrop
from ..model.sphere import equirect_directions
from ..rays.sampling import Origins
from ..transport.form_factors import emitter_form_factors, profile_form_factors
from ..transport.gather import gather
from ..transport.transport import radiance_table, table_rows, targets_of
from .backdrop import BACKDROP_HEIGHT, SeenBackdrop, Shell, blurred_panorama
from .balance import MAX_ALBEDO
from .lamp_radiance import mean_radiance
from .problem import LightProblem, Lights

SHELL_COARSENESS = 4
"""Texels of the picture, across and down, that share one estimate of the irradiance, which is smooth."""
SHELL_RAYS, SHELL_SHADOW_RAYS = 64, 16
"""Gather rays per point of the shell, and shadow rays from it to each lamp."""
SHELL_NEIGHBOURS = 16
"""Seen patches whose irradiance is averaged for a point of the shell."""
SHELL_NORMAL_METRES = 1.0
"""Distance in metres that a difference of normals of one radian counts for, so that the neighbours of a point are the
wall around a hole and not the table in front of it."""


def as_surface(backdrop: SeenBackdrop, problem: LightProblem, lights: Lights, progress: Progress) -> Backdrop | None:
    """The backdrop with the albedo of equation (22); its picture keeps only the openings. None without a backdrop."""
    if backdrop.recovered is None or backdrop.shell is None:
        return None
    shown = backdrop.recovered.picture
    light = _irradiance(backdrop, backdrop.shell, problem, lights, progress)
    outside = shown.mean(-1, keepdims=True) > MAX_ALBEDO * light.mean(-1, keepdims=True)
    albedo = np.clip(shown / np.maximum(light, 1e-9), 0.0, MAX_ALBEDO).astype(np.float32)
    return replace(backdrop.recovered, picture=np.where(outside, shown, 0), albedo=np.where(outside, 0, albedo))


def _irradiance(
    backdrop: SeenBackdrop, shell: Shell, problem: LightProblem, lights: Lights, progress: Progress
) -> NDArray[np.float64]:
    """(H, 2 H, 3) irradiance / pi of the surfaces that the shell stands for.

    The shell lies behind these surfaces, so the walls around a hole shade it from light that reaches them. The walls
    have about the same irradiance as the missing surfaces, and where there are no walls nothing shades the shell: the
    larger of both values is taken.
    """
    height = BACKDROP_HEIGHT // SHELL_COARSENESS
    place, normal = shell.places(equirect_directions(2 * height, height).reshape(-1, 3))
    at_itself = _at_shell(place, normal, backdrop, problem, lights, progress)
    light = np.maximum(_at_neighbours(place, normal, problem, lights), at_itself)
    fine = light.reshape(height, 2 * height, 3).repeat(SHELL_COARSENESS, 0).repeat(SHELL_COARSENESS, 1)
    return blurred_panorama(fine, SHELL_COARSENESS / 2)


def _at_neighbours(
    place: NDArray[np.floating], normal: NDArray[np.floating], problem: LightProblem, lights: Lights
) -> NDArray[np.float64]:
    """(n, 3) irradiance / pi of the seen patches nearest to each point in place and normal, weighted by 1 / distance.

    Args:
        place: (n, 3) metres.
        normal: (n, 3) unit vectors.
    """
    origins = problem.transport.origins
    known = cKDTree(np.concatenate([origins.position.mean(1), SHELL_NORMAL_METRES * origins.normal.mean(1)], 1))
    k = min(SHELL_NEIGHBOURS, problem.transport.n_seen)
    distance, patch = known.query(np.concatenate([place, SHELL_NORMAL_METRES * normal], 1), np.arange(1, k + 1))
    weight = 1 / np.maximum(distance, 1e-9)
    weight /= weight.sum(1, keepdims=True)
    return np.einsum("nk,nkc->nc", weight, lights.irradiance[patch])


def _at_shell(
    place: NDArray[np.floating],
    normal: NDArray[np.floating],
    backdrop: SeenBackdrop,
    problem: LightProblem,
    lights: Lights,
    progress: Progress,
) -> NDArray[np.float64]:
    """(n, 3) irradiance / pi at points of the shell itself.

    Args:
        place: (n, 3) metres.
        normal: (n, 3) inward unit vectors.
    """
    origins = Origins(*(column.astype(np.float32)[:, None] for column in (place, normal)))
    rng = stream(problem.seed, "lighting.shell_irradiance")
    rays, point = gather(problem.tracer, origins, SHELL_RAYS, rng, progress)
    target = targets_of(problem.tracer, problem.transport.grid, problem.regions, rays, point)
    table = radiance_table(lights.patch_radiance, mean_radiance(lights.patch_radiance, problem))
    radiance = table[table_rows(target, rays.face, lights.mask)]
    row, ray = np.nonzero(rays.face < 0)
    start = (place + problem.tracer.epsilon * normal)[row]
    texel = backdrop.texels(start, rays.direction[row, ray])
    radiance[row, ray] = backdrop.radiance[texel] * (texel >= 0)[:, None]
    traced = problem.tracer, origins, rays
    factors = emitter_form_factors(*traced, lights.emitters, SHELL_SHADOW_RAYS, rng, progress)[..., 0]
    for k, faces in enumerate(lights.emitters):
        profile = lights.profile_of(faces)
        if profile is not None:
            factors[:, k] = profile_form_factors(*traced, faces, SHELL_SHADOW_RAYS, rng, profile_basis)[..., 0] @ (
                profile.values
            )
    return radiance.mean(1) + factors @ lights.radiance
