"""Lens distortion: a point the lens moves must come back to where a pinhole would put it. Photos at smaller sizes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from iris_addon.base.errors import BadInput
from iris_addon.base.images import write_exr, write_png
from iris_addon.capture.lens import distort
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, Distortion, View
from iris_addon.model.response import SATURATED
from tests.box_room import RoomCapture

CAMERA = Camera(width=160, height=120, fx=130.0, fy=125.0, cx=83.0, cy=57.5, c2w=np.eye(4))
VIEW = View("a", CAMERA, None)
LENS = Distortion(k1=-0.21, k2=0.06, p1=0.004, p2=-0.003, k3=-0.01)
FISHEYE = Distortion(k1=-0.03, k2=0.008, k3=-0.002, k4=0.0004, fisheye=True)
# Pinhole pixel positions spread over the image, away from its border.
MARKERS = [(x, y) for x in (30.5, 83.0, 131.5) for y in (24.5, 57.5, 95.5)]


def opencv(x: float, y: float, lens: Distortion) -> tuple[float, float]:
    """cv::projectPoints, as its documentation writes it."""
    r2 = x * x + y * y
    radial = 1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3
    return (
        x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
        y * radial + lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y,
    )


def opencv_fisheye(x: float, y: float, lens: Distortion) -> tuple[float, float]:
    """cv::fisheye::projectPoints, as its documentation writes it."""
    r = np.hypot(x, y)
    theta = np.arctan(r)
    theta_d = theta * (1 + lens.k1 * theta**2 + lens.k2 * theta**4 + lens.k3 * theta**6 + lens.k4 * theta**8)
    return (x, y) if r == 0 else (x * theta_d / r, y * theta_d / r)


def photo_with_blob(path: Path, u: float, v: float) -> None:
    """A soft white blob centred at (u, v), pixel centres at half integers."""
    i, j = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    blob = np.exp(-((i - u) ** 2 + (j - v) ** 2) / (2 * 2.0**2))
    write_png(path, np.repeat(np.rint(blob * 255).astype(np.uint8)[..., None], 3, axis=-1))


def centroid(image: np.ndarray) -> tuple[float, float]:
    i, j = np.meshgrid(np.arange(image.shape[1]) + 0.5, np.arange(image.shape[0]) + 0.5)
    return (i * image).sum() / image.sum(), (j * image).sum() / image.sum()


RATIONAL = Distortion(k1=0.3, k2=0.1, k3=0.02, p1=0.002, p2=-0.001, d1=0.45, d2=0.12, d3=0.01)
THIN_PRISM = Distortion(k1=-0.03, k2=0.008, p1=0.003, p2=-0.002, sx1=0.004, sy1=-0.003, fisheye=True)


def opencv_rational(x: float, y: float, lens: Distortion) -> tuple[float, float]:
    """cv::projectPoints with k4, k5 and k6, which we call d1, d2 and d3."""
    r2 = x * x + y * y
    radial = (1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3) / (
        1 + lens.d1 * r2 + lens.d2 * r2**2 + lens.d3 * r2**3
    )
    return (
        x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
        y * radial + lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y,
    )


def colmap_thin_prism(x: float, y: float, lens: Distortion) -> tuple[float, float]:
    """THIN_PRISM_FISHEYE of COLMAP's models.h: thin prism and tangential terms on the fisheye's coordinates."""
    r = np.hypot(x, y)
    theta = np.arctan(r)
    u, v = (x, y) if r == 0 else (x * theta / r, y * theta / r)
    t2 = theta**2
    radial = lens.k1 * t2 + lens.k2 * t2**2 + lens.k3 * t2**3 + lens.k4 * t2**4
    return (
        u + u * radial + 2 * lens.p1 * u * v + lens.p2 * (t2 + 2 * u * u) + lens.sx1 * t2,
        v + v * radial + 2 * lens.p2 * u * v + lens.p1 * (t2 + 2 * v * v) + lens.sy1 * t2,
    )


FOV = Distortion(omega=0.95)


def colmap_fov(x: float, y: float, lens: Distortion) -> tuple[float, float]:
    """FOV of COLMAP's models.h, with its series near the middle."""
    radius2, tan_half = x * x + y * y, np.tan(lens.omega / 2)
    if radius2 < 1e-4:
        factor = (-2 * tan_half * (4 * radius2 * tan_half**2 - 3)) / (3 * lens.omega)
    else:
        factor = np.arctan(np.sqrt(radius2) * 2 * tan_half) / (np.sqrt(radius2) * lens.omega)
    return x * factor, y * factor


@pytest.mark.parametrize(
    ("lens", "project"),
    [
        (LENS, opencv),
        (FISHEYE, opencv_fisheye),
        (RATIONAL, opencv_rational),
        (THIN_PRISM, colmap_thin_prism),
        (FOV, colmap_fov),
        (Distortion(omega=0.05), colmap_fov),
    ],
)
@pytest.mark.parametrize("marker", MARKERS)
def test_marker_returns_to_its_pinhole_position(tmp_path: Path, lens, project, marker) -> None:
    x, y = project((marker[0] - CAMERA.cx) / CAMERA.fx, (marker[1] - CAMERA.cy) / CAMERA.fy, lens)
    photo_with_blob(tmp_path / "a.png", x * CAMERA.fx + CAMERA.cx, y * CAMERA.fy + CAMERA.cy)
    photo = load_photo(View("a", CAMERA, tmp_path / "a.png", distortion=lens))
    np.testing.assert_allclose(centroid(photo.values[..., 0]), marker, atol=0.15)


@pytest.mark.parametrize("omega", [0.02, 0.3, 0.95, 2.5])
def test_lines_through_the_middle_of_an_fov_lens_keep_their_places(omega: float) -> None:
    """As COLMAP puts them, from the middle to the border, and back by the inverse of the paper."""
    x, y = np.linspace(-0.8, 0.8, 41), np.linspace(-0.5, 0.6, 41)
    u, v, unique = distort(x, y, Distortion(omega=omega))
    expected = np.array([colmap_fov(a, b, Distortion(omega=omega)) for a, b in zip(x, y, strict=True)])
    np.testing.assert_allclose(np.stack([u, v], -1), expected, atol=2e-7)
    r = np.hypot(u, v)
    np.testing.assert_allclose(np.tan(r * omega) / (2 * np.tan(omega / 2)), np.hypot(x, y), rtol=1e-9, atol=1e-12)
    assert unique.all()


def test_where_the_lens_saw_nothing_is_invalid(tmp_path: Path) -> None:
    """Pincushion distortion pulls the corners of the pinhole image from beyond the photo."""
    write_png(tmp_path / "a.png", np.full((120, 160, 3), 200, np.uint8))
    photo = load_photo(View("a", CAMERA, tmp_path / "a.png", distortion=Distortion(k1=0.3)))
    assert photo.valid[60, 80] and not photo.valid[0, 0] and not photo.valid[-1, -1]
    np.testing.assert_allclose(photo.values[photo.valid], 200 / 255, atol=1e-6)
    assert (photo.values[~photo.valid] == 0).all()


def test_folded_region_of_the_polynomial_is_invalid(tmp_path: Path) -> None:
    """r (1 - r^2) turns back at r = 0.577: beyond, the formula would show a mirrored second copy."""
    write_png(tmp_path / "a.png", np.full((120, 160, 3), 200, np.uint8))
    camera = Camera(width=160, height=120, fx=80.0, fy=80.0, cx=80.0, cy=60.0, c2w=np.eye(4))
    photo = load_photo(View("a", camera, tmp_path / "a.png", distortion=Distortion(k1=-1.0)))
    i, j = np.meshgrid(np.arange(160) + 0.5 - 80, np.arange(120) + 0.5 - 60)
    np.testing.assert_array_equal(photo.valid, np.hypot(i, j) / 80 < np.sqrt(1 / 3))


def test_photo_without_distortion_is_untouched(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    write_png(tmp_path / "a.png", pixels)
    photo = load_photo(View("a", CAMERA, tmp_path / "a.png"))
    np.testing.assert_array_equal(np.rint(photo.values * 255), pixels)


def test_coefficients_of_the_file_reach_the_view(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta.update({"k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002})
    nerfstudio_room.meta["frames"][1]["k1"] = -0.2
    first, second, *_ = read_capture(nerfstudio_room.save()).views
    assert first.distortion == Distortion(k1=-0.1, k2=0.02, p1=0.001, p2=-0.002)
    assert second.distortion is not None and second.distortion.k1 == -0.2


def test_k5_and_k6_make_the_model_rational(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta.update({"k1": 0.1, "k4": 0.4, "k5": 0.5, "k6": 0.6})
    lens = read_capture(nerfstudio_room.save()).views[0].distortion
    assert lens == Distortion(k1=0.1, d1=0.4, d2=0.5, d3=0.6)


def test_zero_coefficients_are_a_pinhole(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta.update({"k1": 0, "k2": 0.0, "p1": 0, "p2": 0})
    assert all(view.distortion is None for view in read_capture(nerfstudio_room.save()).views)


def test_fisheye_is_read_even_without_coefficients(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta["camera_model"] = "OPENCV_FISHEYE"
    assert read_capture(nerfstudio_room.save()).views[0].distortion == Distortion(fisheye=True)


def test_other_camera_models_are_refused_by_name(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta["camera_model"] = "EQUIRECTANGULAR"
    with pytest.raises(BadInput, match="camera model EQUIRECTANGULAR is not supported"):
        read_capture(nerfstudio_room.save())


# ---- reduced photos ------------------------------------------------------------------------------------------------


def textured(height: int, width: int) -> np.ndarray:
    """(h, w, 3) uint8, no pixel clipped: a soft pattern and fine noise."""
    i, j = np.meshgrid(np.arange(width), np.arange(height))
    soft = 110 + 60 * np.sin(i / 17)[..., None] * np.cos(j / 23)[..., None] * [1, 0.6, 0.3]
    noise = np.random.default_rng(0).uniform(-30, 30, (height, width, 1))
    return np.rint(soft + noise).astype(np.uint8)


@pytest.mark.parametrize("factor", [2, 3, 8])
def test_a_reduced_photo_has_the_mean_light_of_its_blocks(tmp_path: Path, factor: int) -> None:
    pixels = textured(101, 163)
    write_png(tmp_path / "a.png", pixels)
    view = replace(VIEW, camera=replace(CAMERA, width=163, height=101), photo=tmp_path / "a.png").reduced(factor)
    h, w = 101 // factor, 163 // factor
    light = (pixels[: h * factor, : w * factor] / 255.0) ** 2
    expected = light.reshape(h, factor, w, factor, 3).mean((1, 3)) ** 0.5
    assert load_photo(view).values == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("factor", [2, 8, 16])
def test_a_jpeg_that_its_decoder_shrinks_is_nearly_the_same(tmp_path: Path, factor: int) -> None:
    pixels = textured(16 * 31 + 5, 16 * 43 + 9)
    Image.fromarray(pixels).save(tmp_path / "a.jpg", quality=98, subsampling=0)
    write_png(tmp_path / "a.png", pixels)
    camera = replace(CAMERA, width=pixels.shape[1], height=pixels.shape[0])
    small = [
        load_photo(replace(VIEW, camera=camera, photo=tmp_path / name).reduced(factor)) for name in ("a.jpg", "a.png")
    ]
    assert small[0].values.shape == (pixels.shape[0] // factor, pixels.shape[1] // factor, 3)
    # The decoder averages display values, not light.
    assert np.abs(small[0].values - small[1].values).max() < 0.02


def test_a_block_that_is_clipped_in_part_is_clipped(tmp_path: Path) -> None:
    pixels = np.full((12, 12, 3), 60, np.uint8)
    pixels[4, 7, 1] = 255
    write_png(tmp_path / "a.png", pixels)
    view = replace(VIEW, camera=replace(CAMERA, width=12, height=12), photo=tmp_path / "a.png").reduced(4)
    clipped = load_photo(view).values >= SATURATED
    assert clipped[1, 1].tolist() == [False, True, False] and clipped.sum() == 1


def test_a_reduced_photo_shows_a_marker_in_its_place_also_through_a_lens(tmp_path: Path) -> None:
    photo_with_blob(tmp_path / "a.png", 100.0, 40.0)
    for lens in (None, LENS):
        whole = load_photo(replace(VIEW, photo=tmp_path / "a.png", distortion=lens)).values[..., 0] ** 2
        half = replace(VIEW, photo=tmp_path / "a.png", distortion=lens).reduced(2)
        small = load_photo(half).values[..., 0] ** 2
        assert np.multiply(centroid(small), 2) == pytest.approx(centroid(whole), abs=0.1)
        ray, reduced = CAMERA.project(np.array([0.1, 0.2, -1.0])), half.camera.project(np.array([0.1, 0.2, -1.0]))
        assert 2 * reduced == pytest.approx(ray)


def test_blocks_of_radiance_without_a_finite_value_are_not_valid(tmp_path: Path) -> None:
    radiance = np.full((8, 8, 3), 2.0, np.float32)
    radiance[5, 1] = np.inf
    write_exr(tmp_path / "a.exr", radiance)
    photo = load_photo(replace(VIEW, camera=replace(CAMERA, width=8, height=8), photo=tmp_path / "a.exr").reduced(4))
    assert photo.valid.tolist() == [[True, True], [False, True]] and photo.values[0, 0, 0] == 2
