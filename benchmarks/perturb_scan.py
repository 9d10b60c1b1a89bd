"""A perturbation of the mesh: the one that a depth camera would have given, fused from noisy depth maps.

Depth is traced through the training cameras and through others around them, as one moves a scanner; it has noise and
slow errors in proportion to the distance. The fused mesh is one welded, noisy surface without parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from iris_addon.capture.depth_fusion import DepthMap, fuse
from iris_addon.capture.fipt import read_fipt, read_fipt_views
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.model.capture import Camera, Mesh
from iris_addon.rays.tracer import Tracer

from .perturb_geometry import replace_mesh
from .remeshing import FaceMap, subdivide_edges

DEPTH_SIZE = (320, 240)
"""Pixels of the depth maps, as depth cameras have them."""
CAMERAS_AROUND = 4
"""Depth maps around each photo."""
AROUND_METRES, AROUND_DEGREES = 0.15, 12.0
"""Standard deviation of their places, per axis, and of their directions."""
NOISE_PER_CENTIMETRE = 0.0025
"""Standard deviation of the slow error of depth, relative, per centimetre of the voxel; that from pixel to pixel is
half of it. A depth camera of 0.5 % is fused at 2 cm."""
SLOW_PIXELS = 16
"""Pixels from one independent slow error to the next."""
MATCHED = 0.02
"""Metres: faces of the exact mesh are cut to this before each face of the scan takes the nearest."""


def scan_mesh(root: Path, _truth: Path, centimetres: float, rng: np.random.Generator) -> str:
    """The mesh fused from noisy depth in voxels of ``centimetres``; lamps are the faces nearest to theirs."""
    exact = read_mesh(read_fipt(root).mesh_file)[0]
    tracer = Tracer(exact)
    cameras = _scanner(root, rng)
    seeds = rng.integers(0, 2**63, len(cameras))
    noise = NOISE_PER_CENTIMETRE * centimetres
    maps = [
        DepthMap(camera, partial(_noisy_depth, tracer, camera, noise, int(seed)))
        for camera, seed in zip(cameras, seeds, strict=True)
    ]
    scan = fuse(maps, centimetres / 100).mesh
    old = _nearest_faces(exact, scan)
    order = np.argsort(old, kind="stable")  # the faces of a lamp are a range
    replace_mesh(root, Mesh(scan.vertices, scan.faces[order]), old[order])
    return f"{len(scan.faces)} triangles in place of {len(exact.faces)}"


def _scanner(root: Path, rng: np.random.Generator) -> Sequence[Camera]:
    """The cameras of the depth maps: those of the training photos, and some around each."""
    width, height = DEPTH_SIZE
    cameras = []
    for view in read_fipt_views(root, "train"):
        own = view.camera.resized(width, height)
        cameras.append(own)
        for _ in range(CAMERAS_AROUND):
            c2w = own.c2w.copy()
            turn = Rotation.from_rotvec(np.radians(AROUND_DEGREES) * rng.standard_normal(3)).as_matrix()
            c2w[:3, :3] = c2w[:3, :3] @ turn
            c2w[:3, 3] += AROUND_METRES * rng.standard_normal(3)
            cameras.append(Camera(width, height, own.fx, own.fy, own.cx, own.cy, c2w))
    return cameras


def _noisy_depth(tracer: Tracer, camera: Camera, noise: float, seed: int) -> NDArray[np.float32]:
    """(H, W) metres along the view axis, 0 where nothing is hit; the same whenever it is read."""
    rng = np.random.default_rng(seed)
    origin, direction = camera.rays()
    distance = tracer.closest(origin, direction).distance.astype(np.float64)
    depth = np.where(np.isfinite(distance), distance, 0) * (direction @ -camera.c2w[:3, 2])
    shape = camera.height, camera.width
    coarse = rng.standard_normal([side // SLOW_PIXELS + 1 for side in shape])
    slow = np.asarray(zoom(coarse, SLOW_PIXELS, order=3))[: shape[0], : shape[1]]
    error = noise * (slow + 0.5 * rng.standard_normal(shape))
    return (depth.reshape(shape) * (1 + error)).astype(np.float32)


def _nearest_faces(exact: Mesh, scan: Mesh) -> FaceMap:
    """(F,) face of the ``exact`` mesh nearest to each of the ``scan``."""
    fine, old = subdivide_edges(exact, MATCHED)
    tree = cKDTree(fine.vertices[fine.faces].mean(1))
    return old[tree.query(scan.vertices[scan.faces].mean(1), workers=-1)[1]]
