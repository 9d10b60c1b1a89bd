"""Posed depth becomes a mesh: where the surface lies, in which formats, and that a capture without a mesh gets one."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from iris_addon.base.errors import BadInput, Cancelled
from iris_addon.base.images import write_exr
from iris_addon.capture.alignment import seen_geometry
from iris_addon.capture.depth_fusion import DepthMap, choose_voxel, depth_noise, fuse
from iris_addon.capture.depth_maps import posed_depth
from iris_addon.capture.listing import FUSED_MESH
from iris_addon.capture.mesh_from_depth import fuse_capture
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.model.capture import Camera, Mesh, View
from iris_addon.rays.tracer import Tracer
from tests.box_room import ROOM_MAX, box_mesh, room_poses
from tests.demo_capture import DemoCapture, demo_capture
from tests.program_cameras import Writer, write_arkit_scenes, write_polycam, write_record3d

DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])


def depth_of(camera: Camera, mesh: Mesh) -> np.ndarray:
    """(H, W) metres, 0 where no surface is met."""
    depth, _ = seen_geometry(camera, Tracer(mesh))
    return np.where(np.isfinite(depth), depth, 0.0)


def pinhole(width: int, height: int, focal: float, pose: np.ndarray) -> Camera:
    return Camera(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2, c2w=pose)


def box_cameras(width: int = 160, height: int = 120) -> list[Camera]:
    focal = 0.6 * width
    made = [pinhole(width, height, focal, pose) for pose in room_poses(12)]
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_euler("x", -40, degrees=True).as_matrix()
    return [*made, *(replace(one, c2w=one.c2w @ tilt) for one in made)]


def maps_of(cameras: Sequence[Camera], mesh: Mesh, noise: float = 0.0) -> list[DepthMap]:
    """Maps in steps of a millimetre, with noise that grows as that of depth cameras, ``noise`` metres at one metre."""
    rng, maps = np.random.default_rng(0), []
    for camera in cameras:
        depth = depth_of(camera, mesh)
        depth = np.where(depth > 0, depth + rng.normal(0, noise, depth.shape) * depth**2, 0)
        stored = (depth * 1000).round().astype(np.float32) / 1000
        maps.append(DepthMap(camera, lambda stored=stored: stored))
    return maps


def off_the_box(vertices: np.ndarray) -> np.ndarray:
    """(V,) distance from the nearest wall of the box room, metres."""
    return np.minimum(np.abs(vertices), np.abs(vertices - ROOM_MAX)).min(1)


# ---- The surface ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("noise", "most"), [(0.0, 0.5), (0.002, 1.0)])
def test_the_fused_surface_lies_within_a_voxel_of_the_room(noise: float, most: float) -> None:
    fused = fuse(maps_of(box_cameras(), box_mesh(), noise))
    off = off_the_box(fused.mesh.vertices) / fused.voxel
    assert np.quantile(off, 0.99) < most and off.max() < 3
    areas = np.linalg.norm(np.cross(*_sides(fused.mesh)), axis=1) / 2
    seen = 0.0
    for camera in box_cameras():
        seen = max(seen, float((depth_of(camera, fused.mesh) > 0).mean()))
    assert seen > 0.97  # no camera looks through the wall of the room
    assert 0.5 * 59 < areas.sum() < 1.3 * 59  # square metres of the six walls


def _sides(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return b - a, c - a


def test_faces_are_turned_to_where_they_are_seen_from() -> None:
    mesh = fuse(maps_of(box_cameras(), box_mesh())).mesh
    normals = np.cross(*_sides(mesh))  # as long as twice the area
    inward = (normals * (ROOM_MAX / 2 - mesh.vertices[mesh.faces].mean(1))).sum(1) > 0
    areas = np.linalg.norm(normals, axis=1)
    assert areas[inward].sum() > 0.999 * areas.sum()


def test_the_bundled_room_comes_back_from_its_cameras(tmp_path: Path) -> None:
    """Measured along the rays of cameras that were not fused."""
    room = read_capture(demo_capture(tmp_path, 28).save())
    cameras = [view.camera for view in room.views]
    fused = fuse(maps_of(cameras[::2] + cameras[1::4], room.mesh))
    off, seen = [], []
    for camera in cameras[3::4]:
        truth, found = depth_of(camera, room.mesh), depth_of(camera, fused.mesh)
        seen.append((found > 0)[truth > 0].mean())
        off.append(np.abs(truth - found)[(truth > 0) & (found > 0)] / fused.voxel)
    errors = np.concatenate(off)
    assert np.mean(seen) > 0.9
    assert np.median(errors) < 0.1 and np.quantile(errors, 0.85) < 1


def test_voxels_follow_noise_and_resolution() -> None:
    clean, noisy = maps_of(box_cameras(320, 240), box_mesh()), maps_of(box_cameras(320, 240), box_mesh(), 0.006)
    coarse = maps_of(box_cameras(80, 60), box_mesh())
    assert choose_voxel(clean) < choose_voxel(noisy) and choose_voxel(clean) < choose_voxel(coarse)
    depth = noisy[0].read()
    assert depth_noise(depth) == pytest.approx(0.006 * float(np.median(depth[depth > 0])) ** 2, rel=0.4)


def test_memory_is_bounded_by_larger_voxels(monkeypatch: pytest.MonkeyPatch) -> None:
    maps = maps_of(box_cameras(), box_mesh())
    monkeypatch.setattr("iris_addon.capture.depth_fusion.MAX_BLOCKS", 1500)
    fused = fuse(maps, 0.01)
    assert fused.voxel > 0.03 and len(fused.mesh.faces) > 1000


def test_a_cancel_is_heard() -> None:
    def stop(share: float) -> None:
        if share > 0.4:
            raise Cancelled()

    with pytest.raises(Cancelled):
        fuse(maps_of(box_cameras(), box_mesh()), 0.05, stop)


# ---- Formats -------------------------------------------------------------------------------------------------------


def write_depth(path: Path, camera: Camera, mesh: Mesh, unit: float = 0.001) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((depth_of(camera, mesh) / unit).round().astype(np.uint16)).save(path)


def camera_of(room: DemoCapture, index: int, width: int, height: int) -> Camera:
    w, h, focal = room.meta["w"], room.meta["h"], room.meta["fl_x"]
    return pinhole(w, h, focal, room.poses[index]).resized(width, height)


def mesh_of(room: DemoCapture) -> Mesh:
    return Mesh(room.vertices, np.asarray(room.faces, np.int64))


def nerfstudio(root: Path) -> DemoCapture:
    """Depth of half the size of the photos, in steps of half a millimetre; one frame has none."""
    room = demo_capture(root, 12)
    room.save()
    (root / room.mesh_name).unlink()
    meta = json.loads((root / "transforms.json").read_text())
    meta["depth_unit_scale_factor"] = 0.0005
    for k, frame in enumerate(meta["frames"][:-1]):
        frame["depth_file_path"] = f"depth/{k:03d}.png"
        camera = camera_of(room, k, room.meta["w"] // 2, room.meta["h"] // 2)
        write_depth(root / frame["depth_file_path"], camera, mesh_of(room), 0.0005)
    (root / "transforms.json").write_text(json.dumps(meta))
    return room


def scannet(root: Path) -> DemoCapture:
    """The depth camera has another field of view than that of the photos."""
    room = demo_capture(root / "made", 12)
    for folder in ("color", "pose", "intrinsic"):
        (root / folder).mkdir()
    w, h, focal = room.meta["w"], room.meta["h"], room.meta["fl_x"]
    lens = replace(pinhole(160, 120, 130.0, np.eye(4)), cx=81.0, cy=59.0)
    for name, (fx, cx, cy) in {"color": (focal, w / 2, h / 2), "depth": (lens.fx, lens.cx, lens.cy)}.items():
        matrix = np.array([[fx, 0, cx, 0], [0, fx, cy, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        np.savetxt(root / "intrinsic" / f"intrinsic_{name}.txt", matrix)
    for k, name in enumerate(room.names):
        Image.open(root / "made" / "images" / name).save(root / "color" / f"{k}.jpg", quality=95)
        np.savetxt(root / "pose" / f"{k}.txt", room.poses[k] @ DOWN_FORWARD)
        write_depth(root / "depth" / f"{k}.png", replace(lens, c2w=room.poses[k]), mesh_of(room))
    return room


def seven_scenes(root: Path) -> DemoCapture:
    room = demo_capture(root / "made", 12)
    for k, name in enumerate(room.names):
        image = Image.open(root / "made" / "images" / name).resize((640, 480))
        image.save(root / f"frame-{k:06d}.color.png")
        np.savetxt(root / f"frame-{k:06d}.pose.txt", room.poses[k] @ DOWN_FORWARD)
        camera = pinhole(640, 480, 585.0, room.poses[k])
        depth = (depth_of(camera, mesh_of(room)) * 1000).round().astype(np.uint16)
        depth[:20] = 65535  # as the data set marks what was not measured
        Image.fromarray(depth).save(root / f"frame-{k:06d}.depth.png")
    return room


def tum(root: Path) -> DemoCapture:
    """Depth is taken a little later than the photos; one map is missing."""
    room = demo_capture(root / "made", 12)
    (root / "rgb").mkdir()
    w, h, focal = room.meta["w"], room.meta["h"], room.meta["fl_x"]
    (root / "calibration.txt").write_text(f"{focal} {focal} {w / 2} {h / 2}")
    photos, depths, poses = [], [], []
    for k, name in enumerate(room.names):
        time = 1000.0 + 0.05 * k
        Image.open(root / "made" / "images" / name).save(root / "rgb" / f"{time:.6f}.png")
        photos.append(f"{time:.6f} rgb/{time:.6f}.png")
        pose = room.poses[k] @ DOWN_FORWARD
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat()
        poses.append(f"{time:.6f} " + " ".join(f"{x:.8f}" for x in (*pose[:3, 3], *turn)))
        if k:
            write_depth(root / "depth" / f"{time + 0.006:.6f}.png", camera_of(room, k, w, h), mesh_of(room), 1 / 5000)
            depths.append(f"{time + 0.006:.6f} depth/{time + 0.006:.6f}.png")
    for name, lines in {"rgb": photos, "depth": depths, "groundtruth": poses}.items():
        (root / f"{name}.txt").write_text("# made for a test\n" + "\n".join(lines) + "\n")
    return room


def as_written(root: Path, write: Writer) -> tuple[DemoCapture, list[View]]:
    """The room as a program writes it, without its mesh, and its views."""
    room = demo_capture(root, 12)
    write(root, read_capture(room.save()))
    (root / "transforms.json").unlink()
    (root / room.mesh_name).unlink()
    return room, list(read_views(root))


def polycam(root: Path) -> DemoCapture:
    """A quarter of each map is wrong, and said to be little sure."""
    room, views = as_written(root, write_polycam)
    for folder in ("depth", "confidence"):
        (root / "keyframes" / folder).mkdir()
    for view in views:
        camera = view.camera.resized(room.meta["w"] // 2, room.meta["h"] // 2)
        depth = (depth_of(camera, mesh_of(room)) * 1000).round().astype(np.uint16)
        sure = np.full(depth.shape, 255, np.uint8)
        depth[: len(depth) // 4, : depth.shape[1] // 2], sure[: len(depth) // 4, : depth.shape[1] // 2] = 300, 0
        Image.fromarray(depth).save(root / "keyframes" / "depth" / f"{view.name}.png")
        Image.fromarray(sure).save(root / "keyframes" / "confidence" / f"{view.name}.png")
    return room


def record3d(root: Path) -> DemoCapture:
    room, views = as_written(root, write_record3d)
    (root / "depth").mkdir()
    for view in views:
        write_exr(root / "depth" / f"{view.name}.exr", depth_of(view.camera.resized(160, 120), mesh_of(room)))
    return room


def arkit_scenes(root: Path) -> DemoCapture:
    room, views = as_written(root, write_arkit_scenes)
    for view in views:
        write_depth(root / "lowres_depth" / f"{view.name}.png", view.camera.resized(160, 120), mesh_of(room))
    return room


@pytest.mark.parametrize(
    ("form", "count"),
    [
        (nerfstudio, 11),
        (scannet, 12),
        (seven_scenes, 12),
        (tum, 11),
        (polycam, 12),
        (record3d, 12),
        (arkit_scenes, 12),
    ],
)
def test_depth_of_every_format_is_that_of_the_room(form, count: int, tmp_path: Path) -> None:
    """Fused from the files, the room is within a voxel of the mesh that their depth was made of."""
    room = form(tmp_path)
    maps = posed_depth(tmp_path)
    assert len(maps) == count
    for one in maps[::4]:
        depth, truth = one.read(), depth_of(one.camera, mesh_of(room))
        known = (depth > 0) & (truth > 0)
        assert known.mean() > 0.8
        assert np.quantile(np.abs(depth - truth)[known], 0.9) < 0.002
    made = fuse_capture(tmp_path, tmp_path / "out" / "room.ply", 0.04, lambda share: None)
    assert made.voxel == 0.04 and made.maps == count
    mesh = trimesh.load(made.path, process=False)
    found = depth_of(maps[2].camera, Mesh(np.array(mesh.vertices), np.array(mesh.faces)))
    truth = depth_of(maps[2].camera, mesh_of(room))
    both = (found > 0) & (truth > 0)
    assert both.mean() > 0.85 and np.quantile(np.abs(found - truth)[both], 0.85) < made.voxel


# ---- Captures ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [nerfstudio, scannet])
def test_a_capture_with_depth_and_no_mesh_gets_one_once(form, tmp_path: Path) -> None:
    room = form(tmp_path)
    capture = read_capture(tmp_path)
    assert any(f"fused from its depth ({FUSED_MESH})" in text for text in capture.warnings)
    low, high = room.vertices.min(0), room.vertices.max(0)
    assert (capture.mesh.vertices > low - 0.1).all() and (capture.mesh.vertices < high + 0.1).all()
    written = (tmp_path / FUSED_MESH).stat().st_mtime_ns
    again = read_capture(tmp_path)
    assert (tmp_path / FUSED_MESH).stat().st_mtime_ns == written
    assert again.warnings == capture.warnings


def test_a_mesh_that_is_there_is_taken(tmp_path: Path) -> None:
    room = nerfstudio(tmp_path)
    trimesh.Trimesh(room.vertices, room.faces, process=False).export(tmp_path / "scan.ply")
    capture = read_capture(tmp_path)
    assert len(capture.mesh.faces) == len(room.faces) and not (tmp_path / FUSED_MESH).exists()


def test_what_cannot_be_fused_is_said(tmp_path: Path) -> None:
    room = demo_capture(tmp_path, 6)
    room.save()
    with pytest.raises(
        BadInput, match=r"has no posed depth .*Polycam, Record3D, ARKitScenes, ScanNet, 7-Scenes or TUM"
    ):
        fuse_capture(tmp_path, tmp_path / "a.ply", None, lambda share: None)
    with pytest.raises(BadInput, match="is no name of a PLY file"):
        fuse_capture(tmp_path, tmp_path / "a.obj", None, lambda share: None)
    meta = json.loads((tmp_path / "transforms.json").read_text())
    for frame in meta["frames"]:
        frame["depth_file_path"] = "depth.png"
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    Image.fromarray(np.zeros((room.meta["h"], room.meta["w"]), np.uint16)).save(tmp_path / "depth.png")
    with pytest.raises(BadInput, match=f"^{re.escape(str(tmp_path))}: the 6 depth maps of the capture show no surface"):
        fuse_capture(tmp_path, tmp_path / "a.ply", None, lambda share: None)
    with pytest.raises(BadInput, match="leave --voxel out"):
        fuse_capture(tmp_path, tmp_path / "a.ply", 1e-6, lambda share: None)
    Image.new("RGB", (room.meta["w"], room.meta["h"])).save(tmp_path / "depth.png")
    with pytest.raises(BadInput, match="is a picture and no depth map"):
        fuse_capture(tmp_path, tmp_path / "a.ply", None, lambda share: None)
    Image.fromarray(np.ones((50, 300), np.uint16)).save(tmp_path / "depth.png")
    with pytest.raises(BadInput, match="another shape"):
        fuse_capture(tmp_path, tmp_path / "a.ply", None, lambda share: None)
    assert not (tmp_path / "a.ply").exists()
