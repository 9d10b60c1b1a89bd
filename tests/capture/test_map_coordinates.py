"""Georeferenced captures: what lies on a map is brought to the origin in double precision, and fits as before."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import trimesh

from iris_addon.base.errors import BadInput
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.model.capture import Capture, View, moved_by
from iris_addon.results.result import Result
from tests.box_room import RoomCapture
from tests.colmap_model import camera_of, poses, write_text
from tests.demo_capture import demo_capture
from tests.program_cameras import write_metashape
from tests.sparse_points import sparse_points, write_points

ON_THE_MAP = np.array([451_234.567, 5_412_345.678, 120.25])
"""Metres; the steps of single precision there are half a metre."""
MICROMETRE, CENTIMETRE, HALF_DEGREE = 1e-6, 0.01, np.radians(0.5)


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n")


def on_the_map(room: RoomCapture, away: np.ndarray = ON_THE_MAP) -> Path:
    for frame in room.meta["frames"]:
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3] += away
        frame["transform_matrix"] = pose.tolist()
    write_obj(room.root / "mesh.obj", room.mesh.vertices + away, room.mesh.faces)
    room.meta["mesh"] = "mesh.obj"
    room.save()
    return room.root


def seen(capture: Capture) -> np.ndarray:
    """(n, 3) positions of the cameras in the frame of a corner of the mesh, which no common shift changes."""
    return np.array([view.camera.position for view in capture.views]) - capture.mesh.vertices.min(0)


def test_a_room_on_the_map_is_the_room(nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    capture = read_capture(on_the_map(nerfstudio_room))
    assert any("map coordinates: mesh.obj by (-45123" in warning for warning in capture.warnings)
    np.testing.assert_allclose(seen(capture), seen(expected), atol=MICROMETRE)
    np.testing.assert_allclose(np.ptp(capture.mesh.vertices, axis=0), np.ptp(expected.mesh.vertices, axis=0), atol=2e-6)
    assert np.abs(capture.mesh.vertices).max() < 10
    assert capture.map_origin is not None
    np.testing.assert_allclose(capture.map_origin["mesh"], ON_THE_MAP, atol=4)
    assert capture.map_origin["mesh"] == capture.map_origin["poses"]


def as_taken(report: dict, views: tuple[View, ...]) -> list[View]:
    """As a result with nothing but this report takes views of its capture."""
    result = SimpleNamespace(report=report, camera_correction=None, pose_corrections=None)
    return Result.as_taken(cast(Result, result), views)


@pytest.mark.parametrize("unit", [None, 0.3048])
def test_views_on_the_map_follow_and_those_of_the_result_stay(
    nerfstudio_room: RoomCapture, tmp_path: Path, unit: float | None
) -> None:
    capture = read_capture(on_the_map(nerfstudio_room), metres_per_unit=unit)
    report = {"map_origin": capture.map_origin, "metres_per_unit": capture.metres_per_unit}
    for path in (nerfstudio_room.root, nerfstudio_room.transforms):
        for view, wanted in zip(as_taken(report, read_views(path, report)), capture.views, strict=True):
            np.testing.assert_allclose(view.camera.c2w, wanted.camera.c2w, atol=MICROMETRE)
    own = tmp_path / "cameras.json"
    frames = [{"file_path": "a", "transform_matrix": capture.views[0].camera.c2w.tolist()}]
    camera = capture.views[0].camera
    own.write_text(json.dumps({"w": camera.width, "h": camera.height, "fl_x": camera.fx, "frames": frames}))
    (view,) = read_views(own, report)
    np.testing.assert_array_equal(view.camera.c2w, capture.views[0].camera.c2w)


def test_a_scene_that_gets_its_result_back_where_it_stands_is_refused_with_the_shift(
    nerfstudio_room: RoomCapture,
) -> None:
    nerfstudio_room.meta["one_frame"] = True
    with pytest.raises(
        BadInput, match=r"mesh\.obj: lies 5\.43e\+06 from the origin .* by \(-45123\d, -541234\d, -12\d\)"
    ):
        read_capture(on_the_map(nerfstudio_room))


def test_a_mesh_in_single_precision_on_the_map_is_refused_with_the_way_out(nerfstudio_room: RoomCapture) -> None:
    root = on_the_map(nerfstudio_room)
    (root / "mesh.obj").unlink()
    mesh = trimesh.Trimesh(nerfstudio_room.mesh.vertices + ON_THE_MAP, nerfstudio_room.mesh.faces, process=False)
    mesh.export(root / "mesh.ply")
    del nerfstudio_room.meta["mesh"]
    nerfstudio_room.save()
    with pytest.raises(
        BadInput, match=r"mesh\.ply: .*steps of 0\.5.*by \(-45123\d, -541234\d, -12\d\), or the mesh as OBJ"
    ):
        read_capture(root)


@pytest.mark.parametrize("written", ["colmap", "metashape"])
def test_photos_in_a_shifted_frame_are_moved_to_the_mesh_on_the_map(tmp_path: Path, written: str) -> None:
    """The mesh as a survey exports it, the cameras in a frame that was moved by whole numbers; by the sparse points of
    COLMAP, and by corners that the photos show."""
    demo = demo_capture(tmp_path / "right", count=28 if written == "metashape" else 8)
    right = read_capture(demo.save())
    shifted = np.eye(4)
    shifted[:3, 3] = [34.0, -45.0, 20.0]
    moved = replace(right, views=tuple(moved_by(view, shifted) for view in right.views))
    root = tmp_path / "room"
    root.mkdir()
    shutil.copytree(demo.root / "images", root / "images")
    write_obj(root / "mesh.obj", right.mesh.vertices + ON_THE_MAP, right.mesh.faces)
    if written == "metashape":
        write_metashape(root, moved)
    else:
        (root / "sparse" / "0").mkdir(parents=True)
        write_text(root / "sparse" / "0", camera_of(moved), poses(moved))
        points = sparse_points(right, np.random.default_rng(1)) + shifted[:3, 3]
        write_points(root / "sparse" / "0" / "points3D.txt", points)
    capture = read_capture(root)
    assert capture.mismatch is None and capture.poses_to_mesh is not None
    np.testing.assert_allclose(seen(capture), seen(right), atol=2 * CENTIMETRE)
    for view, wanted in zip(capture.views, right.views, strict=True):
        turn = wanted.camera.c2w[:3, :3].T @ view.camera.c2w[:3, :3]
        assert np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) < HALF_DEGREE
    report = {"map_origin": capture.map_origin, "poses_to_mesh": capture.poses_to_mesh.tolist()}
    for view, wanted in zip(read_views(root, report), capture.views, strict=True):
        np.testing.assert_allclose(view.camera.c2w, wanted.camera.c2w, atol=MICROMETRE)
