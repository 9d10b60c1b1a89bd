"""The map of what photos show: smooth over the surface, whatever the atlas does."""

import numpy as np
import pytest

from iris_addon.model.capture import Mesh
from iris_addon.rays.tracer import Tracer
from iris_addon.textures.atlas import covered_texels
from iris_addon.textures.coverage import COVERAGE_CELL, smooth_coverage
from iris_addon.textures.texel_points import TexelPoints

SIDE = 1024


def strips(count: int = 8, height: float = 0.0) -> Mesh:
    """A floor of 4 by 4 metres in strips along x, each a chart of its own, in reversed order on the atlas."""
    vertices, faces, uv = [], [], []
    for k in range(count):
        low, high = 4 * k / count, 4 * (k + 1) / count
        first = len(vertices)
        vertices += [[low, 0, height], [high, 0, height], [high, 4, height], [low, 4, height]]
        faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
        at = (count - 1 - k) / count
        corner = np.array([[at, 0], [at + 0.8 / count, 0], [at + 0.8 / count, 1], [at, 1]])
        uv += [corner[[0, 1, 2]], corner[[0, 2, 3]]]
    return Mesh(np.array(vertices, float), np.array(faces, np.int64), np.array(uv, np.float32))


def mapped(mesh: Mesh, confidence) -> tuple[np.ndarray, TexelPoints]:
    assert mesh.uv is not None
    points = TexelPoints.of(Tracer(mesh), mesh.uv, SIDE)
    return smooth_coverage(points, confidence(points), SIDE), points


def test_seams_that_no_pixel_shows_do_not_appear():
    """Texels beside the border of a chart have no confidence, as on scans; the floor is well seen all the same."""

    def confidence(points: TexelPoints) -> np.ndarray:
        column = points.texel % SIDE
        within = column % (SIDE // 8)
        return np.where((within < 2) | (within > 99), 0.0, 1.0)

    image, points = mapped(strips(), confidence)
    seen = image.flat[points.texel]
    assert confidence(points).min() == 0 and 0.94 < confidence(points).mean() < 0.98
    assert seen.min() > 0.8 and np.ptp(seen) < 0.2


def test_a_corner_that_no_photo_shows_stays_unseen_and_the_border_is_smooth():
    image, points = mapped(strips(), lambda points: (points.position[:, 1] < 2).astype(np.float32))
    seen, y = image.flat[points.texel], points.position[:, 1]
    assert seen[y < 2 - 2 * COVERAGE_CELL].min() > 0.999 and seen[y > 2 + 2 * COVERAGE_CELL].max() < 0.001
    order = np.argsort(y)
    assert np.diff(seen[order]).max() < 0.05, "no texel differs much from the next"


def test_the_two_sides_of_a_thin_board_are_told_apart():
    top, under = strips(height=0.02), strips(height=0.0)
    assert top.uv is not None and under.uv is not None
    below = under.faces[:, ::-1] + len(top.vertices)
    squeezed = np.concatenate([top.uv * [1, 0.49], under.uv[:, ::-1] * [1, 0.49] + [0, 0.51]]).astype(np.float32)
    board = Mesh(np.concatenate([top.vertices, under.vertices]), np.concatenate([top.faces, below]), squeezed)
    image, points = mapped(board, lambda points: (points.normal[:, 2] > 0).astype(np.float32))
    seen = image.flat[points.texel]
    assert seen[points.normal[:, 2] > 0].min() > 0.99 and seen[points.normal[:, 2] < 0].max() < 0.01


def test_gutters_continue_the_surface_beside_them():
    mesh = strips()
    assert mesh.uv is not None
    image, _ = mapped(mesh, lambda points: np.ones(len(points.texel)))
    covered = np.zeros(SIDE * SIDE, bool)
    covered[covered_texels(mesh.uv, SIDE).texel] = True
    assert not covered.all()
    assert image.ravel()[~covered] == pytest.approx(1.0, abs=1e-3)


def test_a_mesh_in_far_coordinates_and_a_large_one_work_too():
    mesh = strips()
    far = Mesh(mesh.vertices * 200 + [1e5, -1e5, 0], mesh.faces, mesh.uv)
    image, points = mapped(far, lambda points: np.full(len(points.texel), 0.5))
    assert image.flat[points.texel] == pytest.approx(0.5, abs=1e-3)
