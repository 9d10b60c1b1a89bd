"""A box room on disk: the smallest capture whose photos show what its rays meet."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from iris_addon.base.images import write_png
from iris_addon.model.capture import Camera, Mesh
from iris_addon.rays.tracer import Tracer

WIDTH, HEIGHT, FOCAL = 32, 24, 20.0
# Box room of 4 x 3 x 2.5 metres, z up; two triangles per wall.
ROOM_MIN, ROOM_MAX = np.zeros(3), np.array([4.0, 3.0, 2.5])
WALL_COLORS = np.array(
    [[200, 60, 60], [60, 200, 60], [60, 60, 200], [200, 200, 60], [60, 200, 200], [180, 180, 180]], np.uint8
)


def box_mesh() -> Mesh:
    """Room as 12 triangles; faces 2k and 2k+1 are wall k: x-, x+, y-, y+, z-, z+."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * ROOM_MAX
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return Mesh(vertices, np.array([[q[0], q[k], q[k + 1]] for q in quads for k in (1, 2)], np.int64))


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) camera to world, columns x right, y up, z backward; z is up in the world."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(back, right), back, eye])
    return pose


def room_poses(count: int = 6) -> list[np.ndarray]:
    """Cameras on an ellipse in the middle of the room, each looking across it."""
    angles = np.arange(count) * 2 * math.pi / count
    center = (ROOM_MIN + ROOM_MAX) / 2
    return [
        look_at(
            center + 0.8 * np.array([math.cos(a), math.sin(a), 0.1]), center - np.array([math.cos(a), math.sin(a), 0])
        )
        for a in angles
    ]


def render_walls(camera: Camera, mesh: Mesh) -> np.ndarray:
    """(H, W, 3) uint8, the colour of the wall each pixel sees."""
    hits = Tracer(mesh).closest(*camera.rays())
    return WALL_COLORS[hits.face // 2].reshape(camera.height, camera.width, 3)


def write_obj(path: Path, mesh: Mesh, groups: bool = False) -> None:
    """Plain OBJ of ``mesh``, with one group per wall if asked."""
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    for number, face in enumerate(mesh.faces + 1):
        if groups and number % 2 == 0:
            lines.append(f"g wall{number // 2}")
        lines.append(f"f {face[0]} {face[1]} {face[2]}")
    path.write_text("\n".join(lines) + "\n")


def write_mesh(path: Path, mesh: Mesh) -> None:
    """PLY or GLB of ``mesh`` with vertices as they are."""
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)


@dataclass
class RoomCapture:
    """A capture on disk that a test may damage. ``meta`` is what its transforms file holds; call :meth:`save`."""

    root: Path
    transforms: Path
    meta: dict[str, Any]
    photos: list[Path]
    mesh: Mesh = field(default_factory=box_mesh)

    def save(self) -> Path:
        self.transforms.write_text(json.dumps(self.meta))
        return self.root


def write_nerfstudio_room(root: Path) -> RoomCapture:
    """Six photos of the box room with a nerfstudio transforms.json and a PLY mesh."""
    (root / "images").mkdir(parents=True)
    mesh, frames, photos = box_mesh(), [], []
    for number, pose in enumerate(room_poses()):
        camera = Camera(width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=WIDTH / 2, cy=HEIGHT / 2, c2w=pose)
        photo = root / "images" / f"{number:03d}.png"
        write_png(photo, render_walls(camera, mesh))
        photos.append(photo)
        frames.append({"file_path": f"images/{photo.name}", "transform_matrix": pose.tolist()})
    write_mesh(root / "mesh.ply", mesh)
    meta = {"camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "frames": frames}
    capture = RoomCapture(root=root, transforms=root / "transforms.json", meta=meta, photos=photos, mesh=mesh)
    capture.save()
    return capture


def write_fipt_room(root: Path) -> RoomCapture:
    """The same photos in FIPT layout: columns left, up, forward; exposures in cam/; two held-out poses, no photos."""
    mesh, frames, photos = box_mesh(), [], []
    for folder in ("train/Image", "train/Image_const", "val", "cam"):
        (root / folder).mkdir(parents=True)
    for number, pose in enumerate(room_poses()):
        camera = Camera(width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=WIDTH / 2, cy=HEIGHT / 2, c2w=pose)
        name = f"{number:03d}_0001"
        frames.append({"file_path": f"Image/{name}", "transform_matrix": (pose @ np.diag([-1, 1, -1, 1])).tolist()})
        for photo_set in ("Image", "Image_const"):
            write_png(root / "train" / photo_set / f"{name}.png", render_walls(camera, mesh))
        photos.append(root / "train" / "Image" / f"{name}.png")
    angle = 2 * math.atan(0.5 * WIDTH / FOCAL)
    meta = {"camera_angle_x": angle, "frames": frames}
    (root / "val" / "transforms.json").write_text(
        json.dumps({"camera_angle_x": angle, "w": WIDTH, "h": HEIGHT, "frames": frames[:2]})
    )
    for kind, values in {
        "exposure": [0.25, 0.5, 1, 2, 4, 1],
        "exposure_const": [1.5] * 6,
        "exposure_val": [0.5, 2],
    }.items():
        np.save(root / "cam" / f"{kind}.npy", np.array(values))
    write_obj(root / "scene.obj", mesh, groups=True)
    capture = RoomCapture(root=root, transforms=root / "train" / "transforms.json", meta=meta, photos=photos, mesh=mesh)
    capture.save()
    return capture
