"""The bundled demo room as a nerfstudio capture whose parts a test may change."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

ROOM = Path(__file__).resolve().parents[1] / "assets" / "demo_room"
LEFT_FORWARD = np.diag([-1.0, 1.0, -1.0, 1.0])
Save = Callable[[Image.Image, Path, int], object]


def save_as_is(image: Image.Image, path: Path, index: int) -> None:
    image.save(path)


@dataclass
class DemoCapture:
    """Photos are written at once; poses, keys and mesh with :meth:`save`."""

    root: Path
    poses: np.ndarray
    names: list[str]
    exposures: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    meta: dict[str, Any] = field(default_factory=dict)
    mesh_name: str = "mesh.ply"

    def save(self) -> Path:
        frames = [
            {"file_path": f"images/{name}", "transform_matrix": pose.tolist(), "exposure": float(exposure)}
            for name, pose, exposure in zip(self.names, self.poses, self.exposures, strict=True)
        ]
        (self.root / "transforms.json").write_text(json.dumps({**self.meta, "frames": frames}))
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        mesh.export(self.root / self.mesh_name)
        return self.root


def demo_capture(root: Path, count: int = 6, suffix: str = ".png", save: Save = save_as_is) -> DemoCapture:
    """``count`` photos of the demo room, spread over it; ``save`` writes each its own way."""
    meta = json.loads((ROOM / "train" / "transforms.json").read_text())
    exposures = np.load(ROOM / "cam" / "exposure.npy")
    chosen = np.linspace(0, len(meta["frames"]) - 1, count).round().astype(int)
    (root / "images").mkdir(parents=True)
    names, poses = [], []
    for index, k in enumerate(chosen):
        frame = meta["frames"][k]
        stem = Path(frame["file_path"]).name
        names.append(stem + suffix)
        poses.append(np.array(frame["transform_matrix"]) @ LEFT_FORWARD)
        with Image.open(ROOM / "train" / "Image" / f"{stem}.png") as image:
            save(image.convert("RGB"), root / "images" / names[-1], index)
    mesh = trimesh.load(ROOM / "scene.ply", process=False, maintain_order=True)
    focal = 0.5 * meta["w"] / np.tan(0.5 * meta["camera_angle_x"])
    return DemoCapture(
        root=root,
        poses=np.array(poses),
        names=names,
        exposures=exposures[chosen],
        vertices=np.array(mesh.vertices),
        faces=np.array(mesh.faces),
        meta={"w": meta["w"], "h": meta["h"], "fl_x": focal, "fl_y": focal},
    )
