"""What is said about a capture before it is solved: alignment that measures, clipping that counts, files that last."""

import json
from dataclasses import replace

import numpy as np
import pytest

from iris_addon.base.errors import Cancelled
from iris_addon.base.images import write_png
from iris_addon.base.progress import Progress
from iris_addon.capture.alignment import align, geometry_edges
from iris_addon.capture.inspection import inspect
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, Mesh
from iris_addon.rays.tracer import Tracer
from tests.box_room import RoomCapture, box_mesh, look_at
from tests.capture.test_reader import with_exif
from tests.demo_capture import demo_capture

SEEN_FROM = look_at(np.array([3.2, 2.4, 1.6]), np.array([0.5, 0.3, 0.8]))


def furnished() -> Mesh:
    """The box room with two boxes in it: enough edges to tell one shift from another."""
    room, box = box_mesh(), box_mesh()
    pieces = [room.vertices]
    for scale, place in (((0.2, 0.25, 0.4), (0.6, 0.5, 0.0)), ((0.1, 0.3, 0.2), (1.6, 0.2, 0.0))):
        pieces.append(box.vertices * scale + place)
    faces = np.concatenate([room.faces + 8 * k for k in range(len(pieces))])
    return Mesh(np.concatenate(pieces), faces)


def camera(width=160, c2w=SEEN_FROM) -> Camera:
    height = width * 3 // 4
    return Camera(width=width, height=height, fx=0.7 * width, fy=0.7 * width, cx=width / 2, cy=height / 2, c2w=c2w)


def geometry(view: Camera, tracer: Tracer) -> tuple[np.ndarray, np.ndarray]:
    hits = tracer.closest(*view.rays())
    depth = hits.distance * (view.rays()[1] @ -view.c2w[:3, 2])
    normal = tracer.normals[hits.face]
    return depth.reshape(view.height, view.width), normal.reshape(view.height, view.width, 3)


def photo_from(view: Camera, tracer: Tracer) -> np.ndarray:
    """A picture shaded by the normal, with a texture that is no geometry."""
    _, normal = geometry(view, tracer)
    texture = 0.03 * np.sin(np.arange(view.width) / 3.0)
    return np.clip(0.5 + 0.3 * normal @ np.array([[0.9], [0.5], [0.2]]) + texture[None, :, None], 0, 1).repeat(3, -1)


def turned(view: Camera, degrees: float) -> Camera:
    """``view`` turned about its vertical axis: the picture moves sideways by f tan(angle)."""
    a = np.radians(degrees)
    yaw = np.eye(4)
    yaw[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(a), np.sin(a), -np.sin(a), np.cos(a)
    return replace(view, c2w=view.c2w @ yaw)


def test_alignment_measures_the_shift_of_a_wrong_pose():
    tracer, view = Tracer(furnished()), camera()
    photo = photo_from(view, tracer)
    fits = align(photo, *geometry(view, tracer), 4.0)
    assert fits.verdict == "aligned" and fits.shift <= 4 and fits.score > 0.4
    for degrees in (2.0, -3.0):
        off = align(photo, *geometry(turned(view, degrees), tracer), 4.0)
        assert off.verdict == "shifted" and off.score < fits.score / 2
        expected = 4.0 * view.fx * np.tan(np.radians(abs(degrees)))
        assert off.shift == pytest.approx(expected, abs=6)


def test_alignment_is_unclear_without_common_edges():
    tracer, view = Tracer(furnished()), camera()
    depth, normal = geometry(view, tracer)
    noise = np.random.default_rng(0).random((view.height, view.width, 3))
    assert align(noise, depth, normal, 1.0).verdict == "unclear"
    assert align(np.full((view.height, view.width, 3), 0.5), depth, normal, 1.0).verdict == "unclear"


@pytest.mark.parametrize("swapped", [(), (0, 9), (3, 11, 20)])
def test_photos_under_the_pose_of_another_are_named(swapped: tuple[int, ...], tmp_path):
    demo = demo_capture(tmp_path / "demo", count=24)
    photos = [demo.root / "images" / name for name in demo.names]
    contents = [path.read_bytes() for path in photos]
    names = [path.stem for path in photos]
    for k, source in zip(swapped, [*swapped[1:], *swapped[:1]], strict=True):
        photos[k].write_bytes(contents[source])
    inspect(read_capture(demo.save()), tmp_path / "look", Progress())
    content = json.loads((tmp_path / "look" / "capture.json").read_text())
    said = [warning for warning in content["warnings"] if "check that each photo belongs to its pose" in warning]
    with_another = [k for k, row in enumerate(content["views"]) if row["problem"].startswith("it shows what")]
    assert with_another == list(swapped)
    assert len(said) == bool(swapped)
    for k, source in zip(swapped, [*swapped[1:], *swapped[:1]], strict=True):
        assert f"{names[k]} shows what {names[source]} should" in said[0]
    assert not said or said[0].startswith(f"{len(swapped)} photos")


def test_a_plane_has_no_edges_however_slanted():
    view = camera(c2w=np.eye(4))  # looks along -z
    _, directions = view.rays()
    normal = np.array([0.5, 0.3, -1.0]) / np.linalg.norm([0.5, 0.3, -1.0])
    distance = 5.0 / (directions @ normal)
    assert distance.min() > 0
    depth = (-distance * directions[:, 2]).reshape(view.height, view.width)
    flat = np.broadcast_to(normal, (view.height, view.width, 3))
    assert np.ptp(depth) > 2
    assert geometry_edges(depth, flat).max() < 1e-6


def test_a_shrunk_camera_keeps_its_field_of_view():
    view = replace(camera(1000), cx=480.0, cy=390.0)
    small = view.shrunk(160)
    assert (small.width, small.height) == (160, 120)
    assert small.cx / small.width == pytest.approx(view.cx / view.width)
    assert small.width / small.fx == pytest.approx(view.width / view.fx)


def test_an_inspection_can_be_read_without_the_engine(nerfstudio_room: RoomCapture, tmp_path):
    capture = read_capture(nerfstudio_room.root)
    first = capture.views[0]
    assert first.photo is not None
    white = np.full((first.camera.height, first.camera.width, 3), 255, np.uint8)
    white[:, : first.camera.width // 2] = 0
    write_png(first.photo, white)
    inspect(capture, tmp_path / "look", Progress())
    content = json.loads((tmp_path / "look" / "capture.json").read_text())
    row = content["views"][0]
    assert row["saturated"] == pytest.approx(0.5) and row["black"] == pytest.approx(0.5)
    assert row["histogram"][0] == pytest.approx(0.5) and row["histogram"][-1] == pytest.approx(0.5)
    assert row["seen"] == 1.0 and row["camera"]["width"] == first.camera.width
    assert row["problem"] == "50% of its pixels are saturated"
    assert not any("saturated" in other["problem"] for other in content["views"][1:])
    assert any("saturated pixels" in warning and first.name in warning for warning in content["warnings"])
    arrays = np.load(tmp_path / "look" / "mesh.npz")
    np.testing.assert_array_equal(arrays["faces"], capture.mesh.faces)
    np.testing.assert_array_equal(arrays["vertices"], capture.mesh.vertices)


def test_an_inspection_has_the_luminance_that_exif_says_a_photo_was_exposed_for(nerfstudio_room: RoomCapture, tmp_path):
    """1/50 s, f/4 and ISO 100, 200 … 3200 but for one photo without: 12.5 · 16 · 50 / ISO."""
    with_exif(nerfstudio_room, skip=3)
    inspect(read_capture(nerfstudio_room.save()), tmp_path / "look", Progress())
    rows = json.loads((tmp_path / "look" / "capture.json").read_text())["views"]
    expected = [100.0, 50.0, 25.0, None, 6.25, 3.125]
    assert [row["metered"] for row in rows] == [value and pytest.approx(value) for value in expected]


def test_a_cancelled_inspection_leaves_no_capture_json(nerfstudio_room: RoomCapture, tmp_path):
    capture = read_capture(nerfstudio_room.root)
    inspect(capture, tmp_path, Progress())
    progress = Progress()
    progress.cancel()
    with pytest.raises(Cancelled):
        inspect(capture, tmp_path, progress)
    assert not (tmp_path / "capture.json").exists()
