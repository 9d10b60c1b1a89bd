from __future__ import annotations

import numpy as np
import pytest

from iris_addon.evaluate import metrics
from iris_addon.model.response import LUMINANCE, gamma, grey_exposure, identity


def test_psnr_is_minus_ten_log_of_the_mean_square():
    truth = np.full((4, 5, 3), 0.5)
    assert metrics.psnr(truth + 0.1, truth) == pytest.approx(20.0)
    assert metrics.psnr(truth, truth) == pytest.approx(100.0)
    mask = np.zeros((4, 5), bool)
    assert np.isnan(metrics.psnr(truth, truth, mask))
    mask[0, 0] = True
    image = truth.copy()
    image[0, 0] += 0.01
    assert metrics.psnr(image, truth, mask) == pytest.approx(40.0)


def test_texture_finer_than_a_block_drops_out_of_the_block_metric():
    """An error whose mean over each block is d scores as d everywhere, cut blocks and masks included."""
    rows, columns = np.mgrid[:20, :36]
    checkers = 0.2 * (-1.0) ** (rows + columns)[..., None] * np.ones(3)
    truth = np.full((20, 36, 3), 0.5)
    assert metrics.psnr(truth + checkers, truth) < 15
    assert metrics.block_psnr(truth + checkers + 0.01, truth) == pytest.approx(40.0)
    mask = np.zeros((20, 36), bool)
    assert np.isnan(metrics.block_psnr(truth, truth, mask))
    mask[:4, :6] = True
    assert metrics.block_psnr(np.where(mask[..., None], truth + 0.1, 0), truth, mask) == pytest.approx(20.0)
    # A block of which the mask leaves eight pixels counts a sixteenth of two whole ones.
    mask[:] = False
    mask[:8, :16] = mask[8, :8] = True
    error = np.zeros((20, 36))
    error[8] = 0.1
    assert metrics.block_psnr(error, np.zeros((20, 36)), mask) == pytest.approx(-10 * np.log10(0.1**2 / 17))


def test_zeroed_pixels_stay_in_the_denominator():
    """An error of d on a share s of the pixels costs −10 log10(s d²)."""
    image, truth = np.zeros((10, 10)), np.zeros((10, 10))
    image[:1] = 0.1
    assert metrics.psnr(image, truth) == pytest.approx(-10 * np.log10(0.1 * 0.01))


def test_quantise8_rounds_to_the_nearest_code():
    assert np.array_equal(metrics.quantise8(np.array([-1, 0.0019, 0.0020, 0.5, 2.0])) * 255, [0, 0, 1, 128, 255])


def test_to_ldr_is_what_a_camera_stores():
    radiance = np.linspace(0, 2, 600).reshape(10, 20, 3)
    expected = np.floor(255 * gamma().apply(np.clip(radiance * 0.7, 0, 1)) + 1e-9)
    assert np.array_equal(np.round(metrics.to_ldr(radiance, gamma(), 0.7) * 255), expected)
    # Codes themselves survive the trip: nothing falls one code down by rounding of k / 255.
    codes = np.arange(256).repeat(3).reshape(16, 16, 3)
    assert np.array_equal(np.round(metrics.to_ldr(codes / 255, identity(), 1.0) * 255), codes)


def test_grey_exposure_brings_the_median_to_middle_grey():
    radiance = np.random.default_rng(0).random((9, 9, 3)) * 30
    luminance = radiance * grey_exposure(radiance) @ LUMINANCE
    assert np.median(luminance) == pytest.approx(0.18)


def test_ssim_of_an_image_with_itself_is_one_and_falls_with_noise():
    rng = np.random.default_rng(1)
    image = rng.random((40, 50, 3))
    assert metrics.ssim(image, image) == pytest.approx(1.0)
    values = [metrics.ssim(image + s * rng.normal(size=image.shape), image) for s in (0.01, 0.1, 0.5)]
    assert 1 > values[0] > values[1] > values[2] > 0


def test_ssim_of_flat_images_is_the_luminance_term():
    a, b, c1 = 0.4, 0.7, 0.01**2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    assert metrics.ssim(np.full((20, 20, 3), a), np.full((20, 20, 3), b)) == pytest.approx(expected, rel=1e-6)


def test_ssim_matches_sums_over_explicit_windows():
    rng = np.random.default_rng(2)
    x, y = rng.random((14, 13)), rng.random((14, 13))
    g = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weights = np.outer(g, g) / g.sum() ** 2
    values = []
    for i in range(14 - 10):
        for j in range(13 - 10):
            a, b = x[i : i + 11, j : j + 11], y[i : i + 11, j : j + 11]
            mean_a, mean_b = (weights * a).sum(), (weights * b).sum()
            var_a, var_b = (weights * (a - mean_a) ** 2).sum(), (weights * (b - mean_b) ** 2).sum()
            cov = (weights * (a - mean_a) * (b - mean_b)).sum()
            luminance = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
            values.append(luminance * (2 * cov + 9e-4) / (var_a + var_b + 9e-4))
    assert metrics.ssim(x, y) == pytest.approx(np.mean(values), rel=1e-9)


def test_iou_and_log_l2_against_hand_counts():
    a, b = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    assert np.isnan(metrics.iou(a, b))
    a[:2], b[1:3] = True, True
    assert metrics.iou(a, b) == pytest.approx(4 / 12)
    ours, truth = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    truth[0, 0] = np.e - 1
    assert metrics.log_l2(ours, truth) == pytest.approx(0.25)


def test_crf_l2_is_the_frobenius_norm():
    samples = identity().samples
    assert metrics.crf_l2(samples + 0.1, samples) == pytest.approx(0.1 * np.sqrt(3 * 1024))


def test_exposure_error_is_invariant_to_a_common_factor():
    truth = 2.0 ** np.array([-2, -1, 0, 1, 2.0])
    assert metrics.exposure_log2_rmse(7 * truth, truth) == pytest.approx(0.0, abs=1e-12)
    assert metrics.exposure_log2_rmse(truth * 2.0 ** np.array([1, -1, 0, 0, 0]), truth) == pytest.approx(np.sqrt(0.4))


def test_combine_ignores_nan():
    assert metrics.combine([1.0, float("nan"), 3.0]) == 2.0
    assert np.isnan(metrics.combine([]))
