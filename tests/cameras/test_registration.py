"""Poses one by one: found where photos and mesh disagree, left alone where they do not, and what other cameras get."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from iris_addon.base.images import write_png
from iris_addon.base.progress import Cancelled, Progress
from iris_addon.cameras import registration
from iris_addon.cameras.registration import SurfacePoints, _Sightings, photo_disagreement, register, seen_points
from iris_addon.decide import REFINEMENTS, Decisions
from iris_addon.model.capture import Camera, Capture, View
from iris_addon.model.corrections import PoseCorrections, rigid, rotation, rotation_vector, twist
from iris_addon.model.light_states import LightStates
from iris_addon.rays.tracer import Tracer
from tests.engine_room import cameras, furnished_room, repainted

VIEWS, WIDTH, HEIGHT = 12, 160, 120


def waves(point: np.ndarray) -> np.ndarray:
    """(n,) display value of a smooth pattern that repeats nowhere, painted on everything."""
    phase = point @ np.random.default_rng(2).normal(0, 7, (3, 12)) + np.arange(12)
    return np.clip(0.45 + 0.1 * np.sin(phase).sum(-1), 0.05, 0.93)


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, Tracer]:
    """Photos of a painted room by sound cameras, with exposures that differ by up to a factor of two."""
    folder = tmp_path_factory.mktemp("waves")
    room = furnished_room()
    tracer, views = Tracer(room.mesh), []
    for k, camera in enumerate(cameras(VIEWS, WIDTH, HEIGHT)):
        origin, direction = camera.rays()
        hits = tracer.closest(origin, direction)
        value = waves(origin + direction * hits.distance[:, None]) * (0.6 + 0.4 * (k % 3) / 2)
        path = folder / f"{k:02d}.png"
        write_png(path, (255 * np.repeat(value.reshape(HEIGHT, WIDTH, 1), 3, -1)).astype(np.uint8))
        views.append(View(f"{k:02d}", camera, path))
    return Capture(name="painted", root=folder, views=tuple(views), val_views=(), mesh=room.mesh), tracer


def shaken(capture: Capture, centimetres: float, seed: int = 0) -> Capture:
    """Every photo's pose off by so much, and by a quarter of a degree per centimetre, RMS per axis."""
    rng = np.random.default_rng(seed)
    size = np.repeat([np.radians(0.25), 0.01], 3) * centimetres
    moved = (view.camera.c2w @ rigid(size * rng.normal(size=6)) for view in capture.views)
    views = tuple(
        replace(view, camera=replace(view.camera, c2w=c2w)) for view, c2w in zip(capture.views, moved, strict=True)
    )
    return replace(capture, views=views)


def pixels_off(capture: Capture, true: Capture, tracer: Tracer) -> float:
    """Median distance between where photos are thought to show points of the surface and where they do."""
    points = SurfacePoints.of([view.camera for view in true.views], tracer, 2000, np.random.default_rng(1))
    off = []
    for got, want in zip(capture.views, true.views, strict=True):
        seen = points.position[seen_points(points, want.camera, tracer)]
        at = [c.project(c.local(seen)) for c in (got.camera, want.camera)]
        off.append(np.linalg.norm(at[0] - at[1], axis=1))
    return float(np.median(np.concatenate(off)))


def test_correct_poses_are_kept(painted: tuple[Capture, Tracer]) -> None:
    capture, registration_ = register(*painted, np.random.default_rng(0), Progress())
    assert capture is painted[0] and registration_.corrections is None
    assert registration_.warnings == () and registration_.report()["poses"] is None


def test_wrong_poses_are_corrected_one_by_one(painted: tuple[Capture, Tracer]) -> None:
    """Poses 2 cm and half a degree off: photos come to lie on the surface a quarter as far off as they did."""
    true, tracer = painted
    wrong = shaken(true, 2.0)
    mended, found = register(wrong, tracer, np.random.default_rng(0), Progress())
    assert found.corrections is not None and found.gain > 0.5
    before, after = pixels_off(wrong, true, tracer), pixels_off(mended, true, tracer)
    assert before > 1.0 and after < before / 3, (before, after)
    assert "poses moved" in found.warnings[0]
    for view, given in zip(mended.views, wrong.views, strict=True):
        assert np.allclose(found.corrections.camera(given.camera).c2w, view.camera.c2w, atol=1e-6)


def test_what_moves_with_the_camera_does_not_move_right_poses(tmp_path: Path, painted: tuple[Capture, Tracer]) -> None:
    """Floors show a pattern 8 cm behind them, as where they mirror, and walls are of little contrast. Held-out points
    lie on the floors too, so that photos agree better by wrong poses, but not at most points."""
    capture, tracer = painted

    def shade(point: np.ndarray, direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
        floor = np.abs(normal[:, 2]) > 0.9
        return np.where(floor, waves(point + 0.08 * direction), 0.5 + 0.15 * (waves(point) - 0.45))

    mirrored = repainted(capture, tracer, shade, tmp_path)
    same, found = register(mirrored, tracer, np.random.default_rng(0), Progress())
    assert found.gain > 1.5 * REFINEMENTS["poses"].gain  # which alone would move them
    assert same is mirrored and found.corrections is None


def test_photos_under_other_lamps_do_not_move_poses(tmp_path: Path, painted: tuple[Capture, Tracer]) -> None:
    """Shadows of half of the photos lie 4 cm beside those of the others, which have other lamps on."""
    capture, tracer = painted
    views = []
    for k, view in enumerate(capture.views):
        origin, direction = view.camera.rays()
        hits = tracer.closest(origin, direction)
        beside = np.array([0.04, 0.0, 0.0]) * (k % 2)
        value = waves(origin + direction * hits.distance[:, None] + beside)
        path = tmp_path / f"{k:02d}.png"
        write_png(path, (255 * np.repeat(value.reshape(HEIGHT, WIDTH, 1), 3, -1)).astype(np.uint8))
        views.append(replace(view, photo=path, light_state=("left", "right")[k % 2]))
    named = replace(capture, views=tuple(views))
    unnamed = replace(capture, views=tuple(replace(view, light_state="") for view in views))
    same = register(named, tracer, np.random.default_rng(0), Progress())[0]
    assert same is named
    moved = register(unnamed, tracer, np.random.default_rng(0), Progress(), Decisions({"poses": True}))[0]
    assert pixels_off(moved, capture, tracer) > 0.5  # as one light they disagree
    (apart,), (together,) = (
        photo_disagreement(room, [tracer], np.random.default_rng(0), Progress()) for room in (named, unnamed)
    )
    assert apart < 0.8 * together


def test_the_same_seed_gives_the_same_poses(painted: tuple[Capture, Tracer]) -> None:
    wrong = shaken(painted[0], 2.0)
    first, second = (register(wrong, painted[1], np.random.default_rng(3), Progress())[0] for _ in range(2))
    assert all(np.array_equal(a.camera.c2w, b.camera.c2w) for a, b in zip(first.views, second.views, strict=True))


@pytest.mark.parametrize("n_views", [1, 2])
def test_photos_without_a_third_overlapping_one_keep_their_poses(painted: tuple[Capture, Tracer], n_views: int) -> None:
    few = replace(painted[0], views=painted[0].views[:n_views])
    assert register(few, painted[1], np.random.default_rng(0), Progress())[0] is few
    asked, found = register(few, painted[1], np.random.default_rng(0), Progress(), Decisions({"poses": True}))
    assert found.gain == 0 and all(
        np.allclose(a.camera.c2w, b.camera.c2w) for a, b in zip(asked.views, few.views, strict=True)
    )


def test_registration_can_be_cancelled(painted: tuple[Capture, Tracer]) -> None:
    progress = Progress()
    progress.cancel()
    with pytest.raises(Cancelled):
        register(*painted, np.random.default_rng(0), progress)


def test_derivatives_by_the_pose_match_finite_differences(painted: tuple[Capture, Tracer]) -> None:
    """Derivatives by the twist against differences; those of the picture span two pixels, which flattens waves."""
    capture, tracer = painted
    given = [view.camera for view in capture.views]
    points = SurfacePoints.of(given, tracer, 600, np.random.default_rng(0))
    seen = _Sightings.of(points, given, LightStates.of(capture.views), tracer, np.random.default_rng(0))
    photos = registration._brightness(capture.views, Progress())
    pictures = registration._pictures(photos, 100)
    slope = seen._look(pictures, given)[1]
    for axis, step in enumerate(np.repeat([2e-3, 4e-3], 3)):
        nudge = step * np.eye(6)[axis]
        ends = [[replace(c, c2w=c.c2w @ rigid(sign * nudge)) for c in given] for sign in (1, -1)]
        ahead, behind = (seen._look(pictures, moved)[0] for moved in ends)
        numeric = (ahead - behind) / (2 * step)
        known = np.isfinite(numeric) & np.isfinite(slope[:, axis])
        assert known.mean() > 0.8
        assert np.corrcoef(numeric[known], slope[known, axis])[0, 1] > 0.97
        assert np.polyfit(numeric[known], slope[known, axis], 1)[0] == pytest.approx(1.0, abs=0.1)


# ---- other cameras, files, rotations ---------------------------------------------------------------------------------


def drifting(smooth: bool) -> PoseCorrections:
    """Corrections of a walk of 40 photos: those of neighbours alike, or each its own."""
    rng = np.random.default_rng(4)
    before = [replace(cameras(1)[0], c2w=rigid(np.array([0, 0.02 * k, 0, 0.05 * k, 0, 0]))) for k in range(40)]
    twists = (0.02 * np.sin(np.arange(40) / 8)[:, None] if smooth else 0.02 * rng.normal(size=(40, 1))) * np.ones(6)
    after = [replace(c, c2w=c.c2w @ rigid(t)) for c, t in zip(before, twists, strict=True)]
    return PoseCorrections.between(before, after)


def between_photos(k: float) -> Camera:
    return replace(cameras(1)[0], c2w=rigid(np.array([0, 0.02 * k, 0, 0.05 * k, 0, 0])))


def test_a_camera_between_photos_gets_their_smooth_correction() -> None:
    corrections = drifting(True)
    assert corrections.smooth
    camera = between_photos(10.5)
    moved = twist(np.linalg.inv(camera.c2w) @ corrections.camera(camera).c2w)
    assert moved == pytest.approx(np.full(6, 0.02 * np.sin(10.5 / 8)), abs=1e-3)
    far = replace(camera, c2w=rigid(np.array([0, 0, 0, 0, 9.0, 0])))
    assert corrections.camera(far).c2w == pytest.approx(far.c2w, abs=1e-3)


def test_a_camera_between_independent_corrections_is_unchanged() -> None:
    corrections = drifting(False)
    assert not corrections.smooth
    camera = between_photos(10.5)
    assert corrections.camera(camera) is camera
    own = between_photos(10)
    assert np.abs(corrections.camera(own).c2w - own.c2w).max() > 1e-3


def test_corrections_of_poses_survive_their_file_and_damaged_ones_are_refused() -> None:
    corrections = drifting(True)
    back = PoseCorrections.from_content(corrections.content())
    assert np.allclose(back.twists, corrections.twists, atol=1e-6) and back.smooth
    camera = between_photos(10)
    assert np.allclose(back.camera(camera).c2w, corrections.camera(camera).c2w, atol=1e-5)
    for damage in ({"twists": [[0.0] * 6]}, {"given": [[float("nan")] * 12] * 40}, {"given": [], "twists": []}):
        with pytest.raises(ValueError, match="corrections"):
            PoseCorrections.from_content(corrections.content() | damage)


def test_rotations_agree_with_scipy_and_invert() -> None:
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-10, 1e-4, 0.5, 3.0, np.pi):
        direction = rng.normal(size=3)
        vector = size * direction / np.linalg.norm(direction)
        assert rotation(vector) == pytest.approx(Rotation.from_rotvec(vector).as_matrix(), abs=1e-12)
        assert rotation(rotation_vector(rotation(vector))) == pytest.approx(rotation(vector), abs=1e-7)
    move = np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    assert twist(rigid(move)) == pytest.approx(move)
