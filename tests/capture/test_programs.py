"""Cameras of other programs: the box room written as each of them writes it is the room that was photographed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from iris_addon.base.errors import BadInput
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.model.capture import Capture, Distortion
from tests.box_room import RoomCapture

DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])
Writer = Callable[[Path, Capture], Path]


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{x:.12g}" for x in np.asarray(values).ravel())


def write_metashape(root: Path, capture: Capture) -> Path:
    """A chunk that is turned, moved and scaled against the world, as after setting a reference."""
    turn, shift, scale = Rotation.from_euler("xyz", (0.3, 0.2, 0.1)).as_matrix(), np.array([1.0, 2, 3]), 2.5
    camera = capture.views[0].camera
    rows = []
    for number, view in enumerate(capture.views):
        pose = view.camera.c2w @ DOWN_FORWARD
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turn.T @ pose[:3, :3], turn.T @ (pose[:3, 3] - shift) / scale
        assert view.photo is not None
        named = f'<camera id="{number}" sensor_id="0" label="{view.photo.stem}">'
        rows.append(f"{named}<transform>{numbers(own)}</transform></camera>")
    size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
    lens = f"<f>{camera.fx}</f><cx>{camera.cx - camera.width / 2}</cx><cy>{camera.cy - camera.height / 2}</cy>"
    path = root / "cameras.xml"
    path.write_text(
        f'<document version="2.0.0"><chunk label="c"><sensors><sensor id="0" type="frame">{size}'
        f'<calibration type="frame" class="initial">{size}<f>1</f></calibration>'
        f'<calibration type="frame" class="adjusted">{size}{lens}</calibration></sensor></sensors>'
        f"<cameras><group>{''.join(rows)}</group><camera id='99' sensor_id='0' label='lost'/></cameras>"
        f"<transform><rotation>{numbers(turn)}</rotation><translation>{numbers(shift)}</translation>"
        f"<scale>{scale}</scale></transform></chunk></document>"
    )
    return path


def write_meshroom(root: Path, capture: Capture) -> Path:
    camera = capture.views[0].camera
    views, poses = [], []
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        pose = view.camera.c2w @ DOWN_FORWARD
        views.append({"poseId": str(number), "intrinsicId": "7", "path": f"/home/else/{view.photo.name}"})
        transform = {"rotation": [str(x) for x in pose[:3, :3].ravel()], "center": [str(x) for x in pose[:3, 3]]}
        poses.append({"poseId": str(number), "pose": {"transform": transform, "locked": "1"}})
    intrinsic = {
        "intrinsicId": "7",
        "width": str(camera.width),
        "height": str(camera.height),
        "sensorWidth": "36",
        "focalLength": str(camera.fx / camera.width * 36),
        "type": "radial3",
        "principalPoint": [str(camera.cx - camera.width / 2), str(camera.cy - camera.height / 2)],
        "distortionParams": ["0.0", "0.0", "0.0"],
    }
    path = root / "sfm.sfm"
    path.write_text(json.dumps({"version": ["1", "2", "3"], "views": views, "intrinsics": [intrinsic], "poses": poses}))
    return path


def write_bundler(root: Path, capture: Capture) -> Path:
    lines, names = ["# Bundle file v0.3", f"{len(capture.views)} 0"], []
    for view in capture.views:
        assert view.photo is not None
        world_to_camera = np.linalg.inv(view.camera.c2w)
        lines.append(f"{view.camera.fx} 0 0")
        lines += [numbers(row) for row in world_to_camera[:3, :3]] + [numbers(world_to_camera[:3, 3])]
        names.append(f"images/{view.photo.name} 0 {view.camera.fx}")
    (root / "list.txt").write_text("\n".join(names) + "\n")
    path = root / "bundle.out"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_reality_scan(root: Path, capture: Capture) -> Path:
    lines = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for view in capture.views:
        assert view.photo is not None
        camera = view.camera
        yaw, pitch, roll = Rotation.from_matrix(camera.c2w[:3, :3]).as_euler("ZXY", degrees=True)
        x, y, z = camera.position
        focal = camera.fx / max(camera.width, camera.height) * 36
        lines.append(f"{view.photo.name},{x},{y},{z},{-yaw},{pitch},{roll},{focal},0,0,0,0,0,0,0,0")
    path = root / "cameras.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


FILES = (write_metashape, write_meshroom, write_bundler, write_reality_scan)


def write_scannet(root: Path, capture: Capture) -> Path:
    (root / "images").rename(root / "color")
    (root / "pose").mkdir()
    (root / "intrinsic").mkdir()
    camera = capture.views[0].camera
    matrix = np.eye(4)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    np.savetxt(root / "intrinsic" / "intrinsic_color.txt", matrix)
    for view in capture.views:
        assert view.photo is not None
        np.savetxt(root / "pose" / f"{view.photo.stem}.txt", view.camera.c2w @ DOWN_FORWARD)
    np.savetxt(root / "pose" / "lost.txt", np.full((4, 4), -np.inf))
    return root


@pytest.mark.parametrize(
    "write",
    [write_metashape, write_meshroom, write_bundler, write_reality_scan, write_scannet],
    ids=lambda w: w.__name__,
)
@pytest.mark.parametrize("by_file", [False, True])
def test_cameras_are_those_of_the_room(write: Writer, by_file: bool, nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    source = write(nerfstudio_room.root, expected)
    capture = read_capture(source if by_file else nerfstudio_room.root)
    assert [view.name for view in capture.views] == [view.name for view in expected.views]
    for view, wanted in zip(capture.views, expected.views, strict=True):
        np.testing.assert_allclose(view.camera.c2w, wanted.camera.c2w, atol=1e-6)
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(view.camera, name) == pytest.approx(getattr(wanted.camera, name)), name
        assert view.photo is not None and view.photo.name == wanted.photo.name  # type: ignore[union-attr]
        assert view.distortion is None
    assert len(read_views(source)) == len(expected.views)


def test_photos_without_a_pose_are_left_out_and_named(nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    write_metashape(nerfstudio_room.root, expected)
    assert any("lost (no pose)" in warning for warning in read_capture(nerfstudio_room.root).warnings)


def test_distortion_of_metashape_is_that_of_opencv_with_the_tangential_terms_exchanged(
    nerfstudio_room: RoomCapture,
) -> None:
    path = write_metashape(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    text = path.read_text().replace("</f><cx>", "</f><k1>-0.1</k1><k2>0.02</k2><p1>0.003</p1><p2>0.004</p2><cx>")
    path.write_text(text)
    nerfstudio_room.transforms.unlink()
    lens = read_capture(nerfstudio_room.root).views[0].distortion
    assert lens == Distortion(k1=-0.1, k2=0.02, p1=0.004, p2=0.003)


def test_entities_of_an_xml_are_not_expanded(nerfstudio_room: RoomCapture) -> None:
    path = write_metashape(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    path.write_text('<!DOCTYPE d [<!ENTITY a "aaaa">]>' + path.read_text())
    with pytest.raises(BadInput, match=r"cameras\.xml: declares entities"):
        read_capture(path)


@pytest.mark.parametrize("write", FILES, ids=lambda w: w.__name__)
def test_a_damaged_file_is_named(write: Writer, nerfstudio_room: RoomCapture) -> None:
    path = write(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    text = path.read_text()
    path.write_text(text[: int(0.6 * len(text))].rstrip("0123456789.- \n"))
    with pytest.raises(BadInput, match=path.name):
        read_capture(path)
