"""Light by way of glossy surfaces: rare bright paths are spread over the patches around, and none of it is lost."""

from dataclasses import replace

import numpy as np

from iris_addon.surface.irradiance import IrradianceField
from iris_addon.transport.aimed_rays import SparseRays
from iris_addon.transport.glossy_bounce import SPREAD_WIDTH, GlossyBounce

SIDE, SPACING = 40, 0.05
N = SIDE * SIDE
LAMP, FACES = 0, 3


def floor() -> IrradianceField:
    """The patches of a square floor of two metres."""
    column, row = np.meshgrid(*[SPACING * np.arange(SIDE)] * 2)
    position = np.stack([column.ravel(), row.ravel(), np.zeros(N)], 1).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), (N, 3)).copy()
    return IrradianceField.of(position, normal, np.full(N, SPACING, np.float32))


def bounce(rows: np.ndarray, n_rows: int = N) -> GlossyBounce:
    """Paths from patches ``rows`` that end on the lamp, each for 1/64 of what its patch gathers."""
    k = len(rows)
    weight = np.full((k, 3), 1 / 64, np.float32)
    paths = SparseRays(
        n_rows=n_rows,
        row=rows.astype(np.int32),
        weight=weight,
        target=np.full(k, -1, np.int32),
        face=np.zeros(k, np.int32),
    )
    return GlossyBounce(paths, floor().kernel(SPREAD_WIDTH))


def test_spreading_keeps_uniform_light():
    factors = bounce(np.arange(N)).form_factors([np.array([LAMP])], FACES)
    np.testing.assert_allclose(factors, 1 / 64, rtol=1e-4)


def test_single_bright_paths_are_spread_and_their_light_is_kept():
    """One patch in a hundred has met the lamp: all of them get a share, and together they get what was carried."""
    rng = np.random.default_rng(0)
    rows = rng.choice(N, N // 100, replace=False)
    factors = bounce(rows).form_factors([np.array([LAMP])], FACES)[:, 0]
    assert abs(factors.sum() / (len(rows) / 64) - 1) < 0.1
    assert factors.max() < 0.15 / 64


def test_light_from_other_patches_is_spread_too_and_unseen_ones_keep_theirs():
    one = bounce(np.array([N // 2 + SIDE // 2, N]), n_rows=N + 1)
    to_first = replace(one.paths, target=np.zeros(2, np.int32), face=np.full(2, 2, np.int32))
    radiance = np.full((N + 1, 3), 6.4)
    arrived = GlossyBounce(to_first, one.kernel).gather_radiance(radiance, np.zeros(3), np.zeros(FACES, bool))
    np.testing.assert_allclose(arrived[N], 0.1, rtol=1e-4)
    assert 0 < arrived[:N].max() < 0.02 and abs(arrived[:N, 0].sum() / 0.1 - 1) < 0.1
