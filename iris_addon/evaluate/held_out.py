"""Held-out photos of a real capture against path-traced novel views, exposure and white balance fitted per photo."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from ..capture.photos import load_photo
from ..model.capture import Photo, View
from ..model.response import Response
from ..results.result import Result
from . import metrics
from .metrics import FloatArray

FIT_PIXELS = 8192
DARK, BRIGHT = 0.02, 0.98


def score_held_out(result: Result, views: Sequence[View], images: Sequence[FloatArray]) -> dict[str, dict[str, float]]:
    """``nvs_psnr`` and ``nvs_ssim`` by view name.

    A photo whose exposure is unknown may be brightened and tinted: an exposure and a white balance are fitted to it.

    Args:
        views: held-out views with their photos.
        images: their renderings, (H, W, 3) linear radiance each.
    """
    scores: dict[str, dict[str, float]] = {"nvs_psnr": {}, "nvs_ssim": {}}
    for view, radiance in zip(views, images, strict=True):
        photo = load_photo(view)
        gains = fit_gains(radiance, photo, result.response)
        ldr = metrics.to_ldr(radiance, result.response, gains)
        # Pixels that undistortion could not fill count as right on both sides: SSIM wants a full image.
        truth = np.where(photo.valid[..., None], photo.values, ldr)
        scores["nvs_psnr"][view.name] = metrics.psnr(ldr, truth, photo.valid)
        scores["nvs_ssim"][view.name] = metrics.ssim(ldr, truth)
    return scores


def fit_gains(radiance: FloatArray, photo: Photo, response: Response) -> FloatArray:
    """(3,) exposure × white balance with the least squared error of the photo f(radiance · gains).

    The start is the median ratio of exposures over pixels that are neither black nor blown; photos without such pixels
    start from the ratio of means.
    """
    usable = np.flatnonzero(photo.valid.ravel() & np.isfinite(radiance).all(-1).ravel())
    rng = np.random.default_rng(0)
    chosen = rng.choice(usable, min(FIT_PIXELS, len(usable)), replace=False)
    L = np.maximum(radiance.reshape(-1, 3)[chosen].astype(np.float64), 1e-9)
    z = photo.values.reshape(-1, 3)[chosen].astype(np.float64)
    x = response.invert(np.clip(z, 0.0, 1.0))
    mid = (z > DARK) & (z < BRIGHT)
    start = np.array(
        [
            np.median(np.log(x[m, c] + 1e-9) - np.log(L[m, c]))
            if m.any()
            else np.log((x[:, c].mean() + 1e-9) / L[:, c].mean())
            for c, m in enumerate(mid.T)
        ]
    )

    def residual(log_gains: FloatArray) -> FloatArray:
        return (response.apply(np.multiply(L, np.exp(log_gains))) - z).ravel()

    # The table of f is piecewise linear, so derivatives need steps that cross its knots.
    return np.exp(least_squares(residual, start, diff_step=1e-3, method="trf").x)
