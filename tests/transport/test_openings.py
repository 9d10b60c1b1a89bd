"""Light through a window: rays aimed at it against quadrature, and against gather rays alone."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.rays.sampling import Origins
from iris_addon.transport.gather import ESCAPED, gather
from iris_addon.transport.openings import Openings
from tests.engine_room import SIZE, Patched, Room, assemble, box, cameras, patched, quad

LEFT, RIGHT, LOW, HIGH = 1.2, 2.8, 0.8, 2.1
"""The window in the wall y = 0, metres in x and z."""
SOUTH = 2


def window_room(garden: bool) -> Patched:
    """The box room with a window. With a ``garden`` the box around the mesh reaches far beyond it."""
    sides = box(np.zeros(3), SIZE, 0.5)
    del sides[SOUTH]
    around = (
        ([0, 0, 0], LEFT, SIZE[2]),
        ([RIGHT, 0, 0], SIZE[0] - RIGHT, SIZE[2]),
        ([LEFT, 0, 0], RIGHT - LEFT, LOW),
        ([LEFT, 0, HIGH], RIGHT - LEFT, SIZE[2] - HIGH),
    )
    pieces = [*sides, *(quad(corner, [wide, 0, 0], [0, 0, high]) for corner, wide, high in around)]
    if garden:
        pieces.append(quad([-5, -9, -0.1], [14, 0, 0], [0, 8, 0]))
    albedo = np.full((len(pieces), 3), 0.5)
    return patched(
        Room(assemble(pieces, range(len(pieces))), albedo, np.zeros_like(albedo)), cameras(8, 48, 36), 600, 32
    )


def through_window(point: np.ndarray) -> float:
    """Irradiance / pi of a floor patch at ``point`` by a sky of radiance 1, by quadrature over the window."""
    x, z = (low + (high - low) * (np.arange(400) + 0.5) / 400 for low, high in ((LEFT, RIGHT), (LOW, HIGH)))
    off = np.stack([*np.meshgrid(x - point[0], z - point[2]), np.full((400, 400), -point[1])], -1)
    square = (off**2).sum(-1)
    area = (RIGHT - LEFT) * (HIGH - LOW) / 400**2
    return float((off[..., 1] * point[1] / (np.pi * square**2)).sum() * area)


@pytest.mark.parametrize("garden", [False, True])
def test_light_through_a_window_is_that_of_quadrature_with_less_noise_than_by_gather_rays(garden: bool) -> None:
    p = window_room(garden)
    openings = Openings.of(p.tracer, p.transport)
    assert openings is not None and openings.chance.sum() == pytest.approx(1)
    point, copies, n_rays, aimed = np.array([1.0, 2.2, 1e-4]), 3000, 48, 32
    up = np.tile(np.float32([0, 0, 1]), (copies, 1, 1))
    origins = Origins(np.tile(point.astype(np.float32), (copies, 1, 1)), up)
    rays, _ = gather(p.tracer, origins, n_rays, np.random.default_rng(3), Progress())
    target = np.where(rays.face < 0, ESCAPED, 0).astype(np.int32)
    rows, sums = slice(0, copies), np.zeros(copies)
    for found in (
        openings.gathered(target, rays.direction, origins, rows, aimed),
        openings.aimed(origins, rows, n_rays, aimed, np.random.default_rng(4)),
    ):
        sums += np.bincount(found.row, found.weight, copies)
    alone = openings.gathered(target, rays.direction, origins, rows, 0)
    by_gather_rays = np.bincount(alone.row, alone.weight, copies)
    expected = through_window(point) if not garden else by_gather_rays.mean()
    assert by_gather_rays.mean() == pytest.approx(through_window(point), rel=0.05)
    assert sums.mean() == pytest.approx(expected, rel=0.03 if not garden else 0.06)
    assert sums.std() < (0.5 if not garden else 1.0) * by_gather_rays.std()


def test_a_closed_room_has_no_openings() -> None:
    mesh = assemble(box(np.zeros(3), SIZE, 0.5), range(6))
    p = patched(Room(mesh, np.full((6, 3), 0.5), np.zeros((6, 3))), cameras(8, 48, 36), 600, 32)
    assert Openings.of(p.tracer, p.transport) is None
