"""One correction of all cameras: found where photos and mesh disagree, refused where they do not; files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.images import write_png
from iris_addon.base.progress import Cancelled, Progress
from iris_addon.cameras.calibration import calibrate
from iris_addon.decide import REFINEMENTS
from iris_addon.model.capture import Capture, Mesh, View
from iris_addon.model.corrections import CameraCorrection
from iris_addon.model.response import gamma
from iris_addon.rays.tracer import Tracer
from tests.engine_room import cameras, furnished_room, photograph, render, repainted


def checkered(point: np.ndarray) -> np.ndarray:
    """(n,) display value of a pattern of 35 cm that is painted on everything."""
    cell = np.floor(point / 0.35).astype(int)
    shade = np.random.default_rng(3).uniform(0.1, 0.9, 4096)
    return shade[(cell[:, 0] * 73 + cell[:, 1] * 179 + cell[:, 2] * 283) % 4096]


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, Tracer]:
    """Photos of a painted room by sound cameras, with exposures that differ by up to a factor of two."""
    folder = tmp_path_factory.mktemp("painted")
    room = furnished_room()
    tracer, views = Tracer(room.mesh), []
    for k, camera in enumerate(cameras(16, 96, 72)):
        origin, direction = camera.rays()
        hits = tracer.closest(origin.astype(np.float32), direction.astype(np.float32))
        value = checkered(origin + direction * hits.distance[:, None]) * (0.6 + 0.4 * (k % 3) / 2)
        path = folder / f"{k:02d}.png"
        write_png(path, (255 * np.repeat(value.reshape(72, 96, 1), 3, -1)).astype(np.uint8))
        views.append(View(f"{k:02d}", camera, path))
    return Capture(name="painted", root=folder, views=tuple(views), val_views=(), mesh=room.mesh), tracer


def test_correct_cameras_are_kept(painted: tuple[Capture, Tracer]) -> None:
    capture, calibration = calibrate(*painted, np.random.default_rng(0), Progress())
    assert calibration.correction is None and capture is painted[0]
    assert calibration.warnings == () and calibration.report()["correction"] is None


@pytest.mark.parametrize(("n_views", "width"), [(8, 48), (6, 64)])
def test_few_small_photos_of_a_plain_room_keep_their_focal_length(n_views: int, width: int, tmp_path: Path) -> None:
    """With a longer focal length photos overlap less, and what is left to disagree about is less."""
    fine, views = furnished_room(), cameras(n_views, width, width * 3 // 4)
    radiance = render(fine, Tracer(fine.mesh), views, 48)
    exposures = 0.25 / np.median(radiance.mean(-1).reshape(n_views, -1), 1) * 2.0 ** np.linspace(-3, 1, n_views)
    capture = photograph(furnished_room(np.inf), views, radiance, exposures, gamma(), tmp_path)
    _, calibration = calibrate(capture, Tracer(capture.mesh), np.random.default_rng(0), Progress())
    assert calibration.correction is None


def test_photos_without_overlap_keep_their_cameras(painted: tuple[Capture, Tracer]) -> None:
    """In millimetres no two photos show the same cell of four units, and there is nothing to agree about."""
    room, _ = painted
    mesh = replace(room.mesh, vertices=1000 * room.mesh.vertices)
    poses = [view.camera.c2w * np.array([1, 1, 1, 1000]) for view in room.views]
    for pose in poses:
        pose[3, 3] = 1
    views = [replace(v, camera=replace(v.camera, c2w=pose)) for v, pose in zip(room.views, poses, strict=True)]
    capture = replace(room, mesh=mesh, views=tuple(views))
    same, calibration = calibrate(capture, Tracer(mesh), np.random.default_rng(0), Progress())
    assert same is capture and calibration.correction is None and calibration.gain == 0


def test_a_wrong_focal_length_and_offset_are_found(painted: tuple[Capture, Tracer]) -> None:
    """Cameras given 12 % too long and 4 cm to the left of the true ones come back to within 1.5 % and 3 cm.

    A pixel spans 4 cm at 2 m, and a principal point off by one looks almost like such an offset.
    """
    capture, tracer = painted
    true = capture.views[0].camera
    damage = CameraCorrection(true.fx / true.width, 1.12, (0.0, 0.0), (-0.04, 0.0))
    wrong = replace(capture, views=tuple(damage.view(view) for view in capture.views))
    mended, calibration = calibrate(wrong, tracer, np.random.default_rng(0), Progress())
    assert calibration.gain > 0.2
    for got, want in zip(mended.views, capture.views, strict=True):
        assert got.camera.fx == pytest.approx(want.camera.fx, rel=0.015)
        assert np.linalg.norm(got.camera.position - want.camera.position) < 0.03
    assert "focal length" in calibration.warnings[0]


def test_polished_walls_do_not_change_the_focal_length(painted: tuple[Capture, Tracer], tmp_path: Path) -> None:
    """Walls show a pattern one metre behind them, as where they mirror, and floors one of their own: brightness agrees
    better with a wrong focal length, local contrast does not."""
    capture, tracer = painted

    def shade(point: np.ndarray, direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
        mirrored = 0.1 + 0.8 * (np.floor((point + direction) / 1.4).sum(1) % 2)
        return np.where(np.abs(normal[:, 2]) < 0.9, mirrored, 0.3 + 0.4 * checkered(point))

    mirrored = repainted(capture, tracer, shade, tmp_path)
    same, calibration = calibrate(mirrored, tracer, np.random.default_rng(0), Progress())
    assert calibration.gain > 2 * REFINEMENTS["cameras"].gain  # which alone would correct them
    assert same is mirrored and calibration.correction is None


def test_a_focal_length_that_no_common_point_confirms_is_named(painted: tuple[Capture, Tracer]) -> None:
    """Where only two photos of a light state overlap, brightness compares them and contrast, which needs three, not."""
    capture, tracer = painted
    true = capture.views[0].camera
    damage = CameraCorrection(true.fx / true.width, 1.12, (0.0, 0.0), (0.0, 0.0))
    pairs = [replace(damage.view(view), light_state=f"{k // 2}") for k, view in enumerate(capture.views)]
    wrong = replace(capture, views=tuple(pairs))
    same, calibration = calibrate(wrong, tracer, np.random.default_rng(0), Progress())
    assert same is wrong and calibration.correction is None
    assert calibration.unconfirmed == pytest.approx(1 / 1.12, rel=0.1)
    assert "check the focal length" in calibration.warnings[0]


def test_calibration_can_be_cancelled(painted: tuple[Capture, Tracer]) -> None:
    progress = Progress()
    progress.cancel()
    with pytest.raises(Cancelled):
        calibrate(*painted, np.random.default_rng(0), progress)


def test_a_correction_applies_to_its_own_cameras_only() -> None:
    camera = cameras(1, 96, 72)[0]
    correction = CameraCorrection(camera.fx / camera.width, 0.9, (0.01, -0.02), (0.03, 0.05))
    moved = correction.camera(camera)
    assert (moved.fx, moved.fy) == pytest.approx((0.9 * camera.fx, 0.9 * camera.fy))
    assert (moved.cx, moved.cy) == pytest.approx((camera.cx + 0.96, camera.cy - 1.92))
    assert camera.c2w[:3, :3].T @ (moved.position - camera.position) == pytest.approx([0.03, 0.05, 0.0])
    other = replace(camera, fx=2 * camera.fx)
    assert correction.camera(other) is other
    assert CameraCorrection.from_content(correction.content()) == correction


@pytest.mark.parametrize("damage", [{"focal": float("nan")}, {"focal": -1.0}, {"offset": [0.0]}, {"principal": "far"}])
def test_a_damaged_correction_is_refused(damage: dict) -> None:
    content = CameraCorrection(0.9).content() | damage
    with pytest.raises((TypeError, ValueError)):
        CameraCorrection.from_content(content)


def test_the_mesh_is_not_touched(painted: tuple[Capture, Tracer], tmp_path: Path) -> None:
    mesh: Mesh = painted[0].mesh
    calibrated, _ = calibrate(*painted, np.random.default_rng(0), Progress())
    assert calibrated.mesh is mesh and calibrated.val_views == ()
