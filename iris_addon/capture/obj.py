"""Wavefront OBJ, read by hand: general readers sort faces by material, and the order of the file must not change."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .types import Mesh


@dataclass
class _Lines:
    """Tables of an OBJ file as they grow line by line; ``faces`` and ``face_uv`` are triangles of table indices."""

    vertices: list[tuple[float, float, float]] = field(default_factory=list)
    uv: list[tuple[float, float]] = field(default_factory=list)
    faces: list[tuple[int, int, int]] = field(default_factory=list)
    face_uv: list[tuple[int, int, int]] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)

    def add_face(self, corners: list[str], group: str, material: str) -> None:
        """Add a polygon as a fan; an absent texture index is -1."""
        points, texels = [], []
        for corner in corners:
            indices = corner.split("/")
            points.append(_index(indices[0], len(self.vertices)))
            texels.append(_index(indices[1], len(self.uv)) if len(indices) > 1 and indices[1] else -1)
        for k in range(1, len(points) - 1):
            self.faces.append((points[0], points[k], points[k + 1]))
            self.face_uv.append((texels[0], texels[k], texels[k + 1]))
            self.groups.append(group)
            self.materials.append(material)


def _index(text: str, count: int) -> int:
    """Zero-based index; OBJ counts from 1, and negative numbers count back from the last line read."""
    index = int(text)
    return index - 1 if index > 0 else count + index


def read_obj(path: Path) -> Mesh:
    """Triangles of an OBJ file in file order; parts are its materials, or its groups when it has one material.

    Raises:
        ValueError, IndexError: the file is malformed.
    """
    lines, group, material = _Lines(), "", ""
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            keyword, _, rest = line.strip().partition(" ")
            if keyword == "v":
                x, y, z = rest.split()[:3]
                lines.vertices.append((float(x), float(y), float(z)))
            elif keyword == "vt":
                u, v = rest.split()[:2]
                lines.uv.append((float(u), float(v)))
            elif keyword == "f":
                lines.add_face(rest.split(), group, material)
            elif keyword in ("o", "g"):
                group = rest.strip()
            elif keyword == "usemtl":
                material = rest.strip()

    corners = np.array(lines.face_uv, np.int64).reshape(-1, 3)
    uv = None
    if len(corners) and lines.uv and corners.min() >= 0:
        uv = np.array(lines.uv, np.float32)[corners]
    labels = lines.materials if len(set(lines.materials)) > 1 else lines.groups
    return Mesh(
        np.array(lines.vertices, np.float64).reshape(-1, 3),
        np.array(lines.faces, np.int64).reshape(-1, 3),
        uv,
        part_labels(labels),
    )


def part_labels(names: list[str]) -> np.ndarray | None:
    """(F,) int32 labels in order of first appearance, or None when all names are one."""
    order = {name: label for label, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], np.int32) if len(order) > 1 else None
