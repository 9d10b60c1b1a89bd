"""Photos and mesh in different frames: mended where the mend is clear, refused by a solve where none is."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress
from iris_addon.capture.common_frame import MISMATCH_PEAK, FrameMeter
from iris_addon.capture.inspection import inspect
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.config import preset
from iris_addon.model.capture import Capture, Mesh
from iris_addon.pipeline import solve
from tests.demo_capture import DemoCapture, demo_capture

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""How exporters turn a z-up room."""
CYCLE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture
def demo(tmp_path: Path) -> DemoCapture:
    return demo_capture(tmp_path / "room")


def turned(poses: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix @ poses


def centred_y_up(demo: DemoCapture) -> None:
    """A centred room is closed under every turn: no count of rays tells that it lies on its side."""
    middle = (demo.vertices.min(0) + demo.vertices.max(0)) / 2
    demo.poses[:, :3, 3] -= middle
    demo.vertices, demo.mesh_name = (demo.vertices - middle) @ Y_UP.T, "mesh.glb"


def y_up_obj(demo: DemoCapture) -> None:
    demo.vertices, demo.mesh_name = demo.vertices @ Y_UP.T, "mesh.obj"


def polycam(demo: DemoCapture) -> None:
    demo.poses = turned(demo.poses, CYCLE @ Y_UP)
    demo.vertices, demo.mesh_name = demo.vertices @ Y_UP.T, "raw.glb"


def scannetpp(demo: DemoCapture) -> None:
    demo.poses = turned(demo.poses, SWAPPED)


def unit(per_metre: float) -> Callable[[DemoCapture], None]:
    def change(demo: DemoCapture) -> None:
        demo.vertices = demo.vertices * per_metre

    return change


def poses_in_millimetres(demo: DemoCapture) -> None:
    demo.poses[:, :3, 3] *= 1000


def opencv_axes(demo: DemoCapture) -> None:
    demo.poses = demo.poses @ DOWN_FORWARD


def opencv_world_to_camera(demo: DemoCapture) -> None:
    demo.poses = np.linalg.inv(demo.poses @ DOWN_FORWARD)


def transposed(demo: DemoCapture) -> None:
    demo.poses[:, :3, :3] = demo.poses[:, :3, :3].transpose(0, 2, 1)


def y_up_in_centimetres(demo: DemoCapture) -> None:
    demo.vertices = demo.vertices @ Y_UP.T * 100


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (centred_y_up, "(x, y, z) → (x, -z, y)"),
        (y_up_obj, "(x, y, z) → (x, -z, y)"),
        (polycam, "(x, y, z) → (z, x, y)"),
        (scannetpp, "(x, y, z) → (y, x, -z)"),
        (unit(100), "centimeters against meters of the poses"),
        (unit(1 / 0.3048), "feet against meters of the poses"),
        (unit(1000), "millimeters against meters of the poses"),
        (poses_in_millimetres, "meters against millimeters of the poses"),
        (opencv_axes, "OpenCV's axes"),
        (opencv_world_to_camera, "world to camera with OpenCV's axes"),
        (transposed, "transposed rotations"),
        pytest.param(y_up_in_centimetres, "→ (x, -z, y) and the mesh is taken in centimeters", marks=pytest.mark.slow),
    ],
)
def test_photos_and_mesh_are_brought_into_one_frame(
    demo: DemoCapture, change: Callable[[DemoCapture], None], said: str
) -> None:
    """Distances of the cameras from the mesh, in metres, are what they were."""
    right = read_capture(demo.save())
    (demo.root / demo.mesh_name).unlink()
    change(demo)
    mended = read_capture(demo.save())
    assert mended.mismatch is None
    assert len(mended.warnings) == 1 and said in mended.warnings[0]
    np.testing.assert_allclose(depths(mended), depths(right), rtol=1e-4)
    assert mended.up == pytest.approx(tuple(turned_up(change, right)))
    assert_read_again_as_taken(demo, mended)


def assert_read_again_as_taken(demo: DemoCapture, mended: Capture) -> None:
    """Cameras to render from are those of the solve where the file is the capture's or has one of its poses, else as
    they stand there."""
    report = json.loads(json.dumps({"mended_poses": mended.mended_poses}))
    taken = {view.name: view.camera.c2w for view in mended.views}
    raw = {view.name: view.camera.c2w for view in read_views(demo.root)}
    for view in read_views(demo.root, report):
        np.testing.assert_allclose(view.camera.c2w, taken[view.name], atol=1e-9)
    path = demo.root / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"] = content["frames"][2:4]
    path.write_text(json.dumps(content))
    some = read_views(path, report)
    assert len(some) == 2
    for view in some:
        np.testing.assert_allclose(view.camera.c2w, taken[view.name], atol=1e-9)
    for frame in content["frames"]:
        frame["transform_matrix"][0][3] += 0.01 * np.abs(demo.poses[:, :3, 3]).max()
    path.write_text(json.dumps(content))
    for view in read_views(path, report):
        moved = view.camera.c2w - raw[view.name]
        assert np.abs(moved).max() == abs(moved[0, 3]) > 0


@pytest.mark.parametrize(
    "record",
    [
        None,
        3,
        {"convention": "sideways"},
        {"scale": 0},
        {"scale": "much"},
        {"scale": np.nan},
        {"poses": 4},
        {"poses": [[]]},
    ],
)
def test_a_report_that_is_damaged_moves_no_camera(demo: DemoCapture, record: object) -> None:
    opencv_axes(demo)
    mended = read_capture(demo.save())
    good = dict(mended.mended_poses or {})
    report = {"mended_poses": {**good, **record} if isinstance(record, dict) else record}
    raw = read_views(demo.root)
    for view, given in zip(read_views(demo.root, report), raw, strict=True):
        np.testing.assert_array_equal(view.camera.c2w, given.camera.c2w)


def turned_up(change: Callable, right: Capture) -> np.ndarray:
    """The axes are those of the poses."""
    return SWAPPED @ right.up if change is scannetpp else np.array(right.up)


def depths(capture: Capture) -> np.ndarray:
    """(n, photos) distance of each of some vertices from each camera."""
    positions = np.array([view.camera.position for view in capture.views])
    return np.linalg.norm(capture.mesh.vertices[::500, None] - positions, axis=-1)


def test_a_right_capture_is_left_alone(demo: DemoCapture) -> None:
    capture = read_capture(demo.save())
    assert capture.warnings == () and capture.mismatch is None
    np.testing.assert_allclose(capture.mesh.vertices, demo.vertices, atol=1e-6)


@pytest.fixture
def other_room(demo: DemoCapture) -> DemoCapture:
    """The mesh of a room that is not that of the photos."""
    rng = np.random.default_rng(0)
    low, high = demo.vertices.min(0), demo.vertices.max(0)
    boxes = [trimesh.creation.box(bounds=(low, high))]
    for corner in rng.uniform(low, high - 0.8, (12, 3)):
        boxes.append(trimesh.creation.box(bounds=(corner, corner + rng.uniform(0.2, 0.8, 3))))
    mesh = trimesh.util.concatenate(boxes).apply_transform(trimesh.transformations.euler_matrix(0.3, 0.6, 0.1))
    demo.vertices, demo.faces = np.array(mesh.vertices), np.array(mesh.faces)
    return demo


@pytest.mark.slow
def test_a_solve_refuses_photos_of_another_room_and_an_inspection_says_why(
    other_room: DemoCapture, tmp_path: Path
) -> None:
    capture = read_capture(other_room.save())
    with pytest.raises(BadInput, match="the photos do not fit the mesh") as caught:
        solve(capture, preset("draft"), tmp_path / "result")
    assert caught.value.exit_code == 3 and not (tmp_path / "result").exists()
    warnings = inspect(capture, tmp_path / "inspection", Progress())["warnings"]
    assert any("the photos do not fit the mesh" in warning for warning in warnings)


def test_a_capture_that_was_written_as_one_is_refused_rather_than_turned(demo: DemoCapture) -> None:
    """A scene's result goes back to its objects, which do not turn along."""
    scannetpp(demo)
    demo.meta["one_frame"] = True
    capture = read_capture(demo.save())
    assert capture.mismatch is not None and "the photos do not fit the mesh" in capture.mismatch.what
    np.testing.assert_allclose(capture.mesh.vertices, demo.vertices, atol=1e-6)


def test_the_fit_needs_no_absolute_scale_of_the_mesh(demo: DemoCapture) -> None:
    capture = read_capture(demo.save())
    fit = FrameMeter(capture.views, capture.mesh, lambda: None).fit()
    larger = replace(capture.mesh, vertices=capture.mesh.vertices * 10)
    views = [
        replace(view, camera=replace(view.camera, c2w=view.camera.c2w * np.array([[1, 1, 1, 10.0]])))
        for view in capture.views
    ]
    scaled = FrameMeter(views, larger, lambda: None).fit()
    assert scaled.peak == pytest.approx(fit.peak, rel=0.02) and fit.peak > 4 * MISMATCH_PEAK


@pytest.mark.parametrize("name", ["redkitchen", "apt0", "staircase2"])
def test_no_false_alarm_on_captures_and_scans(name: str, shared: Path) -> None:
    capture = read_capture(shared / "captures" / name)
    assert capture.mismatch is None and not any("different frames" in warning for warning in capture.warnings)
    scan = shared / "scans" / f"{name}.ply"
    if scan.is_file():
        loaded = trimesh.load(scan, process=False)
        mesh = Mesh(np.array(loaded.vertices), np.array(loaded.faces))
        assert FrameMeter(capture.views, mesh, lambda: None).fit().peak > 4 * MISMATCH_PEAK
