"""A perturbation of the mesh: the one that a depth camera would have given, fused from noisy depth maps.

Depth is traced through the training cameras and through others around them, as one moves a scanner; each map has noise
and slow errors of its own in proportion to the distance, of which fusing averages a part out. The fused mesh is one
welded, noisy surface without parts; what no depth map sees is a hole, which the true albedo maps show all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
"""Pixels from one independent slow error to the next, about."""
MATCHED, MATCHED_STEPS = 0.02, 600
"""Metres: faces of the exact mesh are cut to this before each face of the scan takes the nearest; of a mesh larger than
so many steps, to that share of its extent."""
FAR = 0.5
"""Metres around the scan beyond which no face is the nearest."""


def scan_mesh(root: Path, _truth: Path, centimetres: float, rng: np.random.Generator) -> str:
    """The mesh fused from noisy depth in voxels of ``centimetres``; lamps are the faces nearest to theirs."""
    exact = read_mesh(read_fipt(root).mesh_file)[0]
    tracer = Tracer(exact)
    cameras = _scanner(root, tracer, rng)
    seeds = rng.integers(0, 2**63, len(cameras))
    noise = NOISE_PER_CENTIMETRE * centimetres
    maps = [
        DepthMap(camera, partial(_noisy_depth, tracer, camera, noise, int(seed)))
        for camera, seed in zip(cameras, seeds, strict=True)
    ]
    fused = fuse(maps, centimetres / 100)
    scan = fused.mesh
    old = _nearest_faces(exact, scan)
    order = np.argsort(old, kind="stable")  # the faces of a lamp are a range
    replace_mesh(root, Mesh(scan.vertices, scan.faces[order]), old[order])
    return f"{len(scan.faces)} triangles in place of {len(exact.faces)}, voxels of {100 * fused.voxel:.2g} cm"


def _scanner(root: Path, tracer: Tracer, rng: np.random.Generator) -> Sequence[Camera]:
    """The cameras of the depth maps: those of the training photos, and some around each, in sight of it."""
    width, height = DEPTH_SIZE
    cameras = []
    for view in read_fipt_views(root, "train"):
        own = view.camera.resized(width, height)
        cameras.append(own)
        for _ in range(CAMERAS_AROUND):
            c2w = own.c2w.copy()
            turn = Rotation.from_rotvec(np.radians(AROUND_DEGREES) * rng.standard_normal(3)).as_matrix()
            c2w[:3, :3] = c2w[:3, :3] @ turn
            step = AROUND_METRES * rng.standard_normal(3)
            length = float(np.linalg.norm(step))
            free = float(tracer.closest(own.position[None], step[None] / length).distance[0])
            c2w[:3, 3] += step * min(1.0, 0.5 * free / length)  # not through a wall
            cameras.append(replace(own, c2w=c2w))
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
    slow /= slow.std()
    error = noise * (slow + 0.5 * rng.standard_normal(shape))
    return (depth.reshape(shape) * (1 + error)).astype(np.float32)


def _nearest_faces(exact: Mesh, scan: Mesh) -> FaceMap:
    """(F,) face of the ``exact`` mesh nearest to each of the ``scan``."""
    low, high = scan.vertices.min(0) - FAR, scan.vertices.max(0) + FAR
    corners = exact.vertices[exact.faces]
    near = np.flatnonzero(((corners.max(1) > low) & (corners.min(1) < high)).all(1))
    longest = max(MATCHED, float(np.ptp(corners[near].reshape(-1, 3), axis=0).max()) / MATCHED_STEPS)
    fine, of_near = subdivide_edges(Mesh(exact.vertices, exact.faces[near]), longest)
    old = near[of_near]
    tree = cKDTree(fine.vertices[fine.faces].mean(1))
    return old[tree.query(scan.vertices[scan.faces].mean(1), workers=-1)[1]]
