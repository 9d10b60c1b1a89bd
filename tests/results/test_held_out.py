"""Photos that the solved room does not explain are named, and no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from iris_addon.base.images import read_image, write_png
from iris_addon.base.progress import Progress
from iris_addon.capture.reader import read_capture
from iris_addon.config import preset
from iris_addon.model.capture import first_of_pose
from iris_addon.pipeline import solve
from iris_addon.rays.tracer import Tracer
from iris_addon.results.held_out import MIN_TESTED, errors_of_photos, hold_out, misfits
from iris_addon.surface.primary_rays import trace_pixels
from tests.demo_capture import demo_capture
from tests.engine_room import cameras, furnished_room

PHOTOS, PIXELS = 20, 300
SMALL = preset("draft", max_patches=4000, gather_rays=64, shadow_rays=64, max_atlas_size=512, rounds=1)


def pixels(rng: np.random.Generator, exposures: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Display values explained with 5 % of error, those shown, and the photo of each pixel."""
    view = np.repeat(np.arange(len(exposures)), PIXELS)
    shown = np.clip(rng.uniform(0.1, 0.9, (len(view), 3)) * exposures[view, None], 0, 1)
    return shown * (1 + 0.05 * rng.normal(size=shown.shape)), shown, view


@pytest.mark.parametrize("unit", [1.0, 1e4])
def test_exchanged_photos_are_named_whatever_the_exposures_and_the_unit(unit: float) -> None:
    rng = np.random.default_rng(0)
    found, shown, view = pixels(rng, 2.0 ** rng.uniform(-4, 1, PHOTOS))
    assert not len(misfits(errors_of_photos(unit * found, unit * shown, view, PHOTOS)))
    a, b = view == 3, view == 17
    shown[a], shown[b] = shown[b].copy(), shown[a].copy()
    assert sorted(misfits(errors_of_photos(unit * found, unit * shown, view, PHOTOS))) == [3, 17]


def test_lamps_and_edges_make_no_misfit() -> None:
    """A third of the pixels of one photo are wrong by the whole range: its mean squared error is a hundredfold."""
    rng = np.random.default_rng(1)
    found, shown, view = pixels(rng, np.ones(PHOTOS))
    lamp = (view == 5) & (rng.random(len(view)) < 0.33)
    found[lamp] = 1 - np.round(shown[lamp])
    assert ((found - shown)[view == 5] ** 2).mean() > 50 * ((found - shown)[view == 6] ** 2).mean()
    assert not len(misfits(errors_of_photos(found, shown, view, PHOTOS)))


def test_a_capture_that_is_explained_badly_as_a_whole_names_no_photo() -> None:
    rng = np.random.default_rng(2)
    _, shown, view = pixels(rng, np.ones(PHOTOS))
    assert not len(misfits(errors_of_photos(shown[::-1], shown, view, PHOTOS)))


def test_photos_that_are_negatives_are_said_to_be_unexplained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
    demo = demo_capture(tmp_path / "demo", count=12)
    for name in demo.names[::2]:
        path = demo.root / "images" / name
        write_png(path, 255 - read_image(path).astype(np.uint8))
    result = solve(read_capture(demo.save()), SMALL, tmp_path / "out")
    assert any("does not explain the photos" in warning for warning in result.report["warnings"])


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mirrored_mesh_whose_walls_still_lie_in_place_is_said_to_explain_little(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mirrored: bool
) -> None:
    """Most pixels show walls and the floor, which are as before: the typical error stays below that of a scan."""
    monkeypatch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
    capture = read_capture(demo_capture(tmp_path / "demo", count=12).save())
    mesh = capture.mesh
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    if mirrored:
        turned = mesh.vertices * [-1, 1, 1] + middle * [2, 0, 0]
        capture = replace(capture, mesh=replace(mesh, vertices=turned, faces=mesh.faces[:, ::-1]))
    result = solve(capture, SMALL, tmp_path / "out")
    assert any("photos poorly" in warning for warning in result.report["warnings"]) == mirrored


def test_few_pixels_say_nothing() -> None:
    shown, view = np.full((2 * MIN_TESTED - 1, 3), 0.5), np.repeat([0, 1], [MIN_TESTED, MIN_TESTED - 1])
    errors = errors_of_photos(shown + 0.4, shown, view, 3)
    assert np.isfinite(errors).tolist() == [True, False, False]
    assert not len(misfits(np.full(3, np.nan)))


def test_photos_that_were_exchanged_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of twenty photos of the demo room lie under each other's pose, which the mean error hardly tells."""
    monkeypatch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
    demo = demo_capture(tmp_path / "demo", count=20)
    first, second = (demo.root / "images" / demo.names[k] for k in (4, 14))
    contents = first.read_bytes(), second.read_bytes()
    first.write_bytes(contents[1])
    second.write_bytes(contents[0])
    result = solve(read_capture(demo.save()), SMALL, tmp_path / "out")
    said = [warning for warning in result.report["warnings"] if "check that each photo belongs to its pose" in warning]
    assert len(said) == 1 and said[0].startswith("2 of 20 photos")
    assert f"{first.stem} (" in said[0] and f"{second.stem} (" in said[0]


# ---- brackets ------------------------------------------------------------------------------------------------------


def test_photos_of_one_pose_lack_the_same_pixels() -> None:
    """What one photo of a bracket shows the textures, another must not be tested on."""
    room = furnished_room()
    poses = cameras(4, 48, 36)
    bracket = [pose for pose in poses for _ in range(3)]
    tracer = Tracer(room.mesh)
    traced = SimpleNamespace(samples=trace_pixels(tracer, bracket, Progress()), cameras=bracket)
    found = hold_out(traced, np.random.default_rng(0))  # type: ignore[arg-type]
    hidden = np.zeros((len(bracket), 48 * 36), bool)
    hidden[traced.samples.view, traced.samples.pixel] = found.hidden
    assert hidden.any() and not (hidden[0::3] == hidden[[3, 6, 9, 0]]).all()
    assert (hidden[0::3] == hidden[1::3]).all() and (hidden[0::3] == hidden[2::3]).all()


def test_poses_are_one_within_half_a_pixel() -> None:
    one, other = cameras(2, 480, 360)
    moved, turned = one.c2w.copy(), one.c2w.copy()
    moved[0, 3] += 0.1
    turned[:3, :3] = one.c2w[:3, :3] @ Rotation.from_rotvec([0, 1e-4, 0]).as_matrix()
    views = [one, other, replace(one, c2w=turned), replace(one, c2w=moved), one.resized(240, 180), other]
    assert first_of_pose(views).tolist() == [0, 1, 0, 3, 4, 1]
