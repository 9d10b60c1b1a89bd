"""ACEScg by its primaries, against what the Academy publishes, and what lies in a file."""

import numpy as np
import OpenEXR
import pytest

from headless.pictures import write_picture
from iris_addon.base.color_spaces import ACESCG, BRADFORD, REC709
from iris_addon.base.images import read_exr, write_exr

PUBLISHED = np.array(
    [
        [0.613097, 0.339523, 0.047379],
        [0.070194, 0.916354, 0.013452],
        [0.020616, 0.109570, 0.869815],
    ]
)
"""Linear sRGB to ACEScg with Bradford's adaptation, as OpenColorIO's ACES configuration has it."""


def chromaticity(xyz: np.ndarray) -> np.ndarray:
    return xyz[:2] / xyz.sum()


def test_the_matrix_is_the_published_one_and_goes_back():
    matrix = REC709.matrix_to(ACESCG)
    np.testing.assert_allclose(matrix, PUBLISHED, atol=2e-5)
    np.testing.assert_allclose(matrix @ np.ones(3), 1, atol=1e-12)
    np.testing.assert_allclose(ACESCG.matrix_to(REC709) @ matrix, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(REC709.matrix_to(REC709), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("space", [REC709, ACESCG])
def test_each_primary_has_its_chromaticity_and_white_has_luminance_one(space):
    for column, primary in zip(space.to_xyz.T, (space.red, space.green, space.blue), strict=True):
        np.testing.assert_allclose(chromaticity(column), primary, atol=1e-12)
    white = space.to_xyz @ np.ones(3)
    np.testing.assert_allclose([*chromaticity(white), white[1]], [*space.white, 1], atol=1e-12)


def test_a_color_is_the_same_light_in_both_but_for_the_adaptation_of_white():
    color = np.array([0.8, 0.3, 0.1])
    ours = BRADFORD @ (REC709.to_xyz @ color) / (BRADFORD @ (REC709.to_xyz @ np.ones(3)))
    theirs = BRADFORD @ (ACESCG.to_xyz @ (REC709.matrix_to(ACESCG) @ color)) / (BRADFORD @ (ACESCG.to_xyz @ np.ones(3)))
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_files_say_their_primaries_and_hold_the_same_light(tmp_path):
    radiance = np.random.default_rng(0).random((6, 5, 3)).astype(np.float32) * 7
    write_picture(tmp_path / "plain.exr", radiance)
    write_picture(tmp_path / "aces.exr", radiance, acescg=True)
    with OpenEXR.File(str(tmp_path / "aces.exr")) as file:
        held = np.ravel(file.header()["chromaticities"])
    np.testing.assert_allclose(held, ACESCG.chromaticities, atol=1e-6)
    np.testing.assert_array_equal(read_exr(tmp_path / "plain.exr"), radiance)
    back = read_exr(tmp_path / "aces.exr") @ ACESCG.matrix_to(REC709).T
    np.testing.assert_allclose(back, radiance, rtol=1e-5, atol=1e-5)
    write_exr(tmp_path / "depth.exr", radiance[..., 0], space=ACESCG)
    np.testing.assert_array_equal(read_exr(tmp_path / "depth.exr")[..., 0], radiance[..., 0])
