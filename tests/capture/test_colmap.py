"""COLMAP models, text and binary: the same cameras as the capture they were written from; damage is told."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.model.capture import Capture, Distortion
from tests.box_room import RoomCapture, render_walls
from tests.colmap_model import Model, camera_of, poses, write_binary, write_text

Writer = Callable[[Path, Model, list[tuple[str, list[float]]]], None]


@pytest.fixture
def colmap_room(nerfstudio_room: RoomCapture) -> tuple[Path, Capture]:
    """A room whose photos lie in images/, its poses gone, and what it was as a nerfstudio capture."""
    expected = read_capture(nerfstudio_room.root)
    (nerfstudio_room.root / "images").mkdir(exist_ok=True)
    for photo in nerfstudio_room.photos:
        photo.rename(nerfstudio_room.root / "images" / photo.name)
    nerfstudio_room.transforms.unlink()
    (nerfstudio_room.root / "sparse" / "0").mkdir(parents=True)
    return nerfstudio_room.root, expected


@pytest.mark.parametrize("write", [write_text, write_binary])
@pytest.mark.parametrize("named", [".", "sparse/0"])
def test_cameras_are_those_of_the_model(write: Writer, named: str, colmap_room: tuple[Path, Capture]) -> None:
    root, expected = colmap_room
    write(root / "sparse" / "0", camera_of(expected), poses(expected))
    capture = read_capture(root / named)
    assert [view.name for view in capture.views] == sorted(view.name for view in expected.views)
    by_name = {view.name: view for view in expected.views}
    for view in capture.views:
        wanted = by_name[view.name].camera
        np.testing.assert_allclose(view.camera.c2w, wanted.c2w, atol=1e-12)
        assert (view.camera.fx, view.camera.cx, view.camera.width) == (wanted.fx, wanted.cx, wanted.width)
        shown = np.rint(load_photo(view).values * 255)
        np.testing.assert_array_equal(shown, render_walls(view.camera, capture.mesh))
    assert capture.up[2] > 0.99, "the photos were taken upright"
    assert any("no unit" in warning for warning in capture.warnings)


def test_lens_distortion_comes_along(colmap_room: tuple[Path, Capture]) -> None:
    root, expected = colmap_room
    _, width, height, (fx, _, cx, cy) = camera_of(expected)
    write_text(root / "sparse" / "0", ("SIMPLE_RADIAL", width, height, (fx, cx, cy, -0.05)), poses(expected))
    view = read_capture(root).views[0]
    assert view.distortion is not None and view.distortion.k1 == -0.05 and not view.distortion.fisheye


@pytest.mark.parametrize("write", [write_text, write_binary])
@pytest.mark.parametrize(
    ("model", "more", "expected_lens"),
    [
        ("SIMPLE_RADIAL_FISHEYE", (-0.05,), Distortion(k1=-0.05, fisheye=True)),
        ("RADIAL_FISHEYE", (-0.05, 0.01), Distortion(k1=-0.05, k2=0.01, fisheye=True)),
        ("FULL_OPENCV", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), Distortion(
            k1=0.1, k2=0.2, p1=0.3, p2=0.4, k3=0.5, d1=0.6, d2=0.7, d3=0.8
        )),
        ("FULL_OPENCV", (0.0,) * 8, None),
        ("FOV", (0.9,), Distortion(omega=0.9)),
        ("FOV", (0.0,), None),
        ("SIMPLE_FISHEYE", (), Distortion(fisheye=True)),
        ("FISHEYE", (), Distortion(fisheye=True)),
        ("THIN_PRISM_FISHEYE", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), Distortion(
            k1=0.1, k2=0.2, p1=0.3, p2=0.4, k3=0.5, k4=0.6, sx1=0.7, sy1=0.8, fisheye=True
        )),
    ],
)  # fmt: skip
def test_every_camera_model_has_its_coefficients_in_order(
    write: Writer,
    model: str,
    more: tuple[float, ...],
    expected_lens: Distortion | None,
    colmap_room: tuple[Path, Capture],
) -> None:
    root, expected = colmap_room
    _, width, height, (fx, fy, cx, cy) = camera_of(expected)
    focal = (fx, cx, cy) if "RADIAL" in model or "SIMPLE" in model else (fx, fy, cx, cy)
    write(root / "sparse" / "0", (model, width, height, (*focal, *more)), poses(expected))
    assert read_views(root)[0].distortion == expected_lens


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_the_model_with_most_photos_is_read_and_the_rest_is_said(
    write: Writer, colmap_room: tuple[Path, Capture]
) -> None:
    root, expected = colmap_room
    (root / "sparse" / "1").mkdir()
    write(root / "sparse" / "0", camera_of(expected), poses(expected)[:2])
    write(root / "sparse" / "1", camera_of(expected), poses(expected)[:5])
    capture = read_capture(root)
    assert len(capture.views) == 5
    said = " ".join(capture.warnings)
    assert "sparse/1 is used, with 5 photos" in said and "sparse/0 has 2" in said
    assert "1 of 6 photos have no pose in the model and are left out: 005.png" in said


@pytest.mark.parametrize("model", ["RAD_TAN_THIN_PRISM_FISHEYE", "DIVISION"])
def test_a_camera_model_that_is_not_read_is_named(model: str, colmap_room: tuple[Path, Capture]) -> None:
    root, expected = colmap_room
    _, width, height, lens = camera_of(expected)
    write_binary(root / "sparse" / "0", (model, width, height, (*lens, 0.5)), poses(expected))
    with pytest.raises(BadInput, match=f"camera model {model} is not supported"):
        read_views(root)


def test_files_of_rigs_and_frames_change_nothing(colmap_room: tuple[Path, Capture]) -> None:
    """As COLMAP 3.12 and later write them: the poses of images are there as before."""
    root, expected = colmap_room
    model = root / "sparse" / "0"
    write_text(model, camera_of(expected), poses(expected))
    (model / "rigs.txt").write_text("# Rig calib list\n1 1 CAMERA 3\n")
    frames = [f"{k} 1 1 0 0 0 9 9 9 1 CAMERA 3 {k}" for k, _ in enumerate(expected.views, 1)]
    (model / "frames.txt").write_text("# Frame list\n" + "\n".join(frames) + "\n")
    for view, wanted in zip(read_capture(root).views, expected.views, strict=True):
        np.testing.assert_allclose(view.camera.c2w, wanted.camera.c2w, atol=1e-9)


def test_images_without_their_line_of_points(colmap_room: tuple[Path, Capture]) -> None:
    root, expected = colmap_room
    write_text(root / "sparse" / "0", camera_of(expected), poses(expected))
    images = root / "sparse" / "0" / "images.txt"
    lines = [line for line in images.read_text().splitlines() if line.endswith(".png") or line.startswith("#")]
    images.write_text("\n".join(lines) + "\n")
    assert len(read_capture(root).views) == len(expected.views)


def test_a_photo_that_is_not_there_is_left_out(colmap_room: tuple[Path, Capture]) -> None:
    root, expected = colmap_room
    write_text(
        root / "sparse" / "0", camera_of(expected), [("nowhere.png", poses(expected)[0][1]), *poses(expected)[1:]]
    )
    assert any("nowhere (no photo)" in warning for warning in read_capture(root).warnings)


def test_the_mesh_may_be_that_of_the_dense_reconstruction(colmap_room: tuple[Path, Capture]) -> None:
    root, expected = colmap_room
    write_binary(root / "sparse" / "0", camera_of(expected), poses(expected))
    (mesh,) = [path for path in root.iterdir() if path.suffix in (".ply", ".obj", ".glb")]
    (root / "dense").mkdir()
    mesh.rename(root / "dense" / mesh.name)
    assert len(read_capture(root).mesh.faces) == len(expected.mesh.faces)


def test_a_model_without_photos_and_mesh_still_has_cameras(colmap_room: tuple[Path, Capture], tmp_path: Path) -> None:
    _, expected = colmap_room
    write_binary(tmp_path, camera_of(expected), poses(expected))
    views = read_views(tmp_path)
    assert len(views) == len(expected.views) and all(view.photo is None for view in views)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda f: (f / "images.bin").write_bytes((f / "images.bin").read_bytes()[:-30]), "damaged"),
        (lambda f: (f / "images.bin").write_bytes(struct.pack("<Q", 2**60)), "damaged"),
        (lambda f: (f / "images.bin").write_bytes(struct.pack("<Q", 0)), "no images"),
        (lambda f: (f / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 3, 13, 32, 24)), "model DIVISION"),
        (lambda f: (f / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 3, 60, 32, 24)), "number 60"),
        (lambda f: (f / "cameras.bin").write_bytes(struct.pack("<Q", 0)), "no camera 3"),
    ],
)
def test_a_damaged_model_is_named(
    damage: Callable[[Path], object], said: str, colmap_room: tuple[Path, Capture]
) -> None:
    root, expected = colmap_room
    folder = root / "sparse" / "0"
    write_binary(folder, camera_of(expected), poses(expected))
    damage(folder)
    with pytest.raises(BadInput, match=said) as raised:
        read_capture(root)
    assert str(folder) in str(raised.value)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (("000.png", [np.nan, 0, 0, 0, 0, 0, 0]), "NaN"),
        (("000.png", [0.0, 0, 0, 0, 0, 0, 0]), "quaternion"),
        (("../../secret.png", [1.0, 0, 0, 0, 0, 0, 0]), "outside the capture"),
    ],
)
def test_an_image_that_cannot_be_is_named(
    image: tuple[str, list[float]], said: str, colmap_room: tuple[Path, Capture]
) -> None:
    root, expected = colmap_room
    images = poses(expected)
    name = images[0][0] if image[0] == "000.png" else image[0]
    write_text(root / "sparse" / "0", camera_of(expected), [(name, image[1]), *images[1:]])
    with pytest.raises(BadInput, match=said):
        read_capture(root)
