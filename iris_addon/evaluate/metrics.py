"""Metrics as pure functions of arrays, independent of files, meshes and renderers.

Images are (H, W, 3) or (H, W) in [0, 1]; a mask is (H, W) bool.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..model.response import Response

FloatArray = NDArray[np.floating]
Mask = NDArray[np.bool_]

MIN_MSE = 1e-10
"""Equal images score 100 dB, so that a mean over images stays finite."""
BLOCK = 8
"""Side in pixels of the blocks of :func:`block_psnr`."""


# ---- Images ---------------------------------------------------------------------------------------------------------


def quantise8(image: FloatArray) -> FloatArray:
    """Clamped to [0, 1] and rounded to 8 bits, as values in [0, 1]."""
    return np.round(np.clip(image, 0.0, 1.0) * 255.0) / 255.0


def to_ldr(radiance: FloatArray, response: Response, exposure: float | FloatArray) -> FloatArray:
    """floor(255 f(clip(radiance · exposure))) / 255, the photo a camera takes of ``radiance`` (H, W, 3)."""
    return np.floor(255.0 * response.apply(np.clip(radiance * exposure, 0.0, 1.0)) + 1e-9) / 255.0


def mse(image: FloatArray, truth: FloatArray, mask: Mask | None = None) -> float:
    """Mean squared error over all pixels and channels, or over those of ``mask``; NaN if the mask is empty."""
    difference = np.asarray(image, np.float64) - truth
    if mask is not None:
        difference = difference[mask]
    return float(np.mean(difference**2)) if difference.size else float("nan")


def psnr(image: FloatArray, truth: FloatArray, mask: Mask | None = None) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 1; equal images give 100, an empty mask NaN."""
    return float(-10.0 * np.log10(np.maximum(mse(image, truth, mask), MIN_MSE)))


def block_psnr(image: FloatArray, truth: FloatArray, mask: Mask | None = None) -> float:
    """PSNR in dB between the means over blocks of BLOCK x BLOCK pixels, of all pixels or of those of ``mask``.

    A block counts by its pixels, so that blocks that the border or the mask cuts weigh less. Texture finer than a block
    drops out, and with it all that depends on whether it is sampled like the truth.
    """
    difference = np.asarray(image, np.float64) - truth
    weight = np.ones(difference.shape[:2]) if mask is None else mask.astype(np.float64)
    sums = _block_sums(difference * weight.reshape(*weight.shape, *[1] * (difference.ndim - 2)))
    count = _block_sums(weight)
    kept = count > 0
    if not kept.any():
        return float("nan")
    squares = (sums[kept].reshape(np.count_nonzero(kept), -1) / count[kept, None]) ** 2
    return float(-10.0 * np.log10(max(np.average(squares.mean(1), weights=count[kept]), MIN_MSE)))


def _block_sums(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over the blocks of an image (H, W, ...); those at its right and lower border may be cut."""
    height, width = image.shape[:2]
    rows = np.add.reduceat(image, np.arange(0, height, BLOCK), axis=0)
    return np.add.reduceat(rows, np.arange(0, width, BLOCK), axis=1)


def ssim(image: FloatArray, truth: FloatArray) -> float:
    """Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004, eq. 13), mean over pixels and channels.

    The 11 x 11 Gaussian window of σ = 1.5, K1 = 0.01, K2 = 0.03, range 1; a border of 5 pixels is left out.
    """
    sigma = (1.5, 1.5) + (0.0,) * (image.ndim - 2)

    def local_mean(x: FloatArray) -> FloatArray:
        return gaussian_filter(x, sigma, truncate=5 / 1.5)[5:-5, 5:-5]

    x, y = np.asarray(image, np.float64), np.asarray(truth, np.float64)
    if min(x.shape[:2]) <= 10:
        raise ValueError(f"images of {x.shape[1]}x{x.shape[0]} are smaller than the window of SSIM")
    c1, c2 = 0.01**2, 0.03**2
    mu_x, mu_y = local_mean(x), local_mean(y)
    var_x, var_y = local_mean(x * x) - mu_x**2, local_mean(y * y) - mu_y**2
    cov = local_mean(x * y) - mu_x * mu_y
    similarity = (2 * mu_x * mu_y + c1) * (2 * cov + c2) / ((mu_x**2 + mu_y**2 + c1) * (var_x + var_y + c2))
    return float(similarity.mean())


# ---- Light ----------------------------------------------------------------------------------------------------------


def iou(mask: Mask, truth: Mask) -> float:
    """Intersection over union of two masks; NaN if both are empty."""
    union = np.count_nonzero(mask | truth)
    return np.count_nonzero(mask & truth) / union if union else float("nan")


def log_l2(emission: FloatArray, truth: FloatArray) -> float:
    """Mean over pixels and channels of (log(e + 1) − log(e* + 1))²."""
    return float(np.mean((np.log1p(np.maximum(emission, 0.0)) - np.log1p(np.maximum(truth, 0.0))) ** 2))


# ---- Camera ---------------------------------------------------------------------------------------------------------


def crf_l2(samples: FloatArray, truth: FloatArray) -> float:
    """Frobenius norm of the difference of two responses (3, 1024)."""
    return float(np.linalg.norm(samples - truth))


def exposure_log2_rmse(exposures: FloatArray, truth: FloatArray) -> float:
    """Stops between exposures (n,) and the true ones, after removing the mean offset."""
    stops = np.log2(exposures) - np.log2(truth)
    return float(np.sqrt(np.mean((stops - stops.mean()) ** 2)))


def combine(values: list[float]) -> float:
    """Mean of the per-image values, without images that have nothing to compare (NaN); NaN if none has."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")
