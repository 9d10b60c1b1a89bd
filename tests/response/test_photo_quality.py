"""Noise and compression of photos are measured, and only what results suffer from is warned of."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from PIL import Image, ImageFilter

from iris_addon.response.photo_quality import PhotoQuality
from tests.engine_room import observe_off_edges

HEIGHT, WIDTH, SIDE = 96, 128, 4


def taken(noise: float, share: float, blur: float, quality: int) -> PhotoQuality:
    """Of two photos of smoothly lit walls, with noise of ``noise`` codes and a ``share`` of the value, as JPEG."""
    rng = np.random.default_rng(0)
    row, column = np.indices((HEIGHT, WIDTH))
    values, patches, views = [], [], []
    for view in range(2):
        light = 70 + 1.2 * column + 0.3 * row - 20 * view
        wall = np.where(column // 32 % 2, 0.9, 1.0) * light
        photo = Image.fromarray(np.repeat(wall[..., None], 3, -1).astype(np.uint8))
        x = np.asarray(photo.filter(ImageFilter.GaussianBlur(blur)) if blur else photo, np.float32)
        noisy = x + rng.normal(size=x.shape) * (noise + share * x)
        stored = BytesIO()
        Image.fromarray(np.clip(noisy + 0.5, 0, 255).astype(np.uint8)).save(stored, "JPEG", quality=quality)
        values.append(np.asarray(Image.open(stored)).reshape(-1, 3) / 255)
        patches.append((row // SIDE * (WIDTH // SIDE) + column // SIDE).ravel())
        views.append(np.full(row.size, view))
    return PhotoQuality.of(
        observe_off_edges(np.concatenate(patches), np.concatenate(views), np.concatenate(values), rng)
    )


@pytest.mark.parametrize("photo", [(0.0, 0.0, 0.0, 95), (1.0, 0.02, 0.5, 88)], ids=["as rendered", "by a phone"])
def test_good_photos_are_not_warned_of(photo: tuple) -> None:
    quality = taken(*photo)
    assert quality.warnings == ()
    assert quality.noise < 0.01 and quality.flattened < 0.05


def test_very_noisy_photos_are_named() -> None:
    quality = taken(8.0, 0.16, 0.5, 88)
    (warning,) = quality.warnings
    assert quality.noise > 4 * taken(1.0, 0.02, 0.5, 88).noise > 0
    assert "noisy" in warning and "lower ISO" in warning and f"{quality.noise:.1%}" in warning


def test_strong_compression_is_named_though_it_takes_the_noise_away() -> None:
    quality = taken(3.0, 0.06, 1.2, 15)
    assert quality.flattened > 0.2
    assert any("less compression" in warning for warning in quality.warnings)
    assert quality.report() == {"noise": round(quality.noise, 4), "flattened": round(quality.flattened, 3)}


def test_dark_and_clipped_patches_tell_nothing_of_compression() -> None:
    rng = np.random.default_rng(0)
    patch = np.repeat(np.arange(400), 16)
    z = np.repeat(np.where(patch % 2, 1.0, 0.05)[:, None], 3, 1)
    assert PhotoQuality.of(observe_off_edges(patch, np.zeros(len(patch), int), z, rng)).flattened == 0
