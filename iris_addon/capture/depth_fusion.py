"""A mesh from posed depth: a truncated signed distance in blocks of voxels near the surface, and its zero level.

Curless and Levoy 1996 over the sparse blocks of Nießner et al. 2013; the surface is that of Gibson 1998 (surface nets):
one vertex per cell through which it goes. Places that no depth map sees have no surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..base.compiled import Real, kernel
from ..base.parallel import over_blocks
from ..model.capture import Camera, FloatArray, Mesh

BLOCK = 8
"""Voxels along a block."""
TRUNCATION = 4.0
"""Voxels to either side of a surface within which distances are kept."""
MAX_BLOCKS = 120_000
"""500 MB of distances and weights; voxels are larger where there would be more blocks."""
MAX_CELLS = 1 << 30
"""Of the table of blocks."""
MIN_DEPTH, MAX_DEPTH = 0.1, 10.0
"""Metres; depth cameras of rooms tell nothing beyond."""
MAX_JUMP = 1.0
"""Difference of the truncated distances of a cell beyond which it spans a silhouette, and no surface."""
MIN_FACES = 100
"""Faces of a piece of the surface, below which it is noise."""
NOISE_PIXELS, NOISE_STEP = 4, 7
"""Pixels from border and gaps, and of which one is taken, where noise is measured."""
NOISE_VOXELS, FOOTPRINT_VOXELS = 1.0, 2.0
"""Standard deviations of the noise, and pixels, to a voxel."""
VOXEL_RANGE = (0.01, 0.05)
"""Metres; textures carry the detail of rooms."""
BLOCKS_AT_ONCE = 256
GATHERED = 2000
"""Blocks whose surface is made at one time."""

Depth = Callable[[], NDArray[np.float32]]


@dataclass(frozen=True)
class DepthMap:
    """One posed depth map.

    Attributes:
        camera: pinhole, of the size of the map.
        read: (H, W) float32 metres along the view axis, 0 where nothing is known.
    """

    camera: Camera
    read: Depth


@dataclass(frozen=True)
class Fused:
    """The mesh, and the voxel in metres that it was made with."""

    mesh: Mesh
    voxel: float


def choose_voxel(maps: Sequence[DepthMap]) -> float:
    """Metres: a voxel is as wide as pixels see and noise allows, in the median of some of the maps."""
    sizes = []
    for one in [maps[k] for k in np.unique(np.linspace(0, len(maps) - 1, 12).round().astype(int))]:
        depth = one.read()
        known = _known(depth)
        if not known.any():
            continue
        footprint = float(np.median(depth[known])) / one.camera.fx
        sizes.append(max(FOOTPRINT_VOXELS * footprint, NOISE_VOXELS * depth_noise(depth)))
    return float(np.clip(np.median(sizes), *VOXEL_RANGE)) if sizes else VOXEL_RANGE[1]


def depth_noise(depth: NDArray[np.float32]) -> float:
    """Robust standard deviation of the noise of a depth map (H, W), metres.

    Inverse depth is linear along a plane, so that its second difference over some pixels is noise, in most places.
    """
    step = NOISE_STEP
    if depth.shape[1] <= 2 * step:
        return 0.0
    inverse = 1 / np.where(_known(depth), depth, np.nan).astype(np.float64)
    bend = inverse[:, : -2 * step] - 2 * inverse[:, step:-step] + inverse[:, 2 * step :]
    metres = np.abs(bend) * depth[:, step:-step].astype(np.float64) ** 2 / 6**0.5
    found = metres[np.isfinite(metres)]
    return 1.4826 * float(np.median(found)) if len(found) else 0.0


def fuse(
    maps: Sequence[DepthMap], voxel: float | None = None, update: Callable[[float], None] = lambda share: None
) -> Fused:
    """Fuse depth maps into one mesh.

    Args:
        voxel: metres, by default as noise and resolution of the maps allow. Larger ones are taken where the blocks
            would not fit into memory.
        update: called with the finished share, 0 to 1; may raise, as for a cancel.

    Returns:
        A mesh without faces where the maps show nothing.
    """
    size = choose_voxel(maps) if voxel is None else voxel
    for _ in range(20):
        blocks = _blocks(maps, size, lambda share: update(0.3 * share))
        if len(blocks) <= MAX_BLOCKS and _table_size(blocks) <= MAX_CELLS:
            break
        size *= max(1.1, (len(blocks) / MAX_BLOCKS) ** 0.5)
    if not len(blocks):
        return Fused(Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64)), size)
    distance = np.ones((len(blocks), BLOCK**3), np.float32)
    weight = np.zeros_like(distance)
    for k, one in enumerate(maps):
        _integrate(one, blocks, size, distance, weight)
        update(0.3 + 0.5 * (k + 1) / len(maps))
    mesh = _surface(blocks, distance, weight, size, lambda share: update(0.8 + 0.2 * share))
    return Fused(mesh, size)


def _known(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    return (depth > MIN_DEPTH) & (depth < MAX_DEPTH)


# ---- Where there are surfaces ---------------------------------------------------------------------------------------


def _blocks(maps: Sequence[DepthMap], voxel: float, update: Callable[[float], None]) -> NDArray[np.int64]:
    """(B, 3) blocks within the truncation of what any map shows, sorted; in steps of a block from the origin."""
    side = BLOCK * voxel
    found = np.empty((0, 3), np.int64)
    for k, one in enumerate(maps):
        depth, camera = one.read(), one.camera
        # Pixels that are closer together than a third of a block, at nearly all depths.
        far = float(np.quantile(depth[_known(depth)], 0.9)) if _known(depth).any() else MAX_DEPTH
        step = max(1, int(side / 3 / far * camera.fx))
        rows, columns = np.meshgrid(np.arange(0, camera.height, step), np.arange(0, camera.width, step), indexing="ij")
        pixel = (rows * camera.width + columns).ravel()
        z = depth.ravel()[pixel]
        pixel, z = pixel[_known(z)], z[_known(z)]
        origin, direction = camera.rays(pixel)
        along = z / (direction @ -camera.c2w[:3, 2])
        near = [origin + (along + offset)[:, None] * direction for offset in np.linspace(-1, 1, 5) * TRUNCATION * voxel]
        here = np.unique(np.floor(np.concatenate(near) / side).astype(np.int64), axis=0) if len(z) else found[:0]
        found = np.concatenate([found, here])
        if k % 16 == 15 or k == len(maps) - 1:
            found = np.unique(found, axis=0)
        update((k + 1) / len(maps))
    return found


def _table_size(blocks: NDArray[np.int64]) -> int:
    return int(np.prod(np.ptp(blocks, axis=0) + 3)) if len(blocks) else 0


def _integrate(
    one: DepthMap,
    blocks: NDArray[np.int64],
    voxel: float,
    distance: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    camera, depth = one.camera, one.read()
    depth = np.where(_known(depth), depth, 0).astype(np.float32)
    pose = np.ascontiguousarray(np.linalg.inv(camera.c2w)[:3])
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    farthest = float(depth.max()) + TRUNCATION * voxel

    def work(rows: slice) -> None:
        _see(blocks[rows], distance[rows], weight[rows], depth, pose, lens, voxel, farthest)

    over_blocks(len(blocks), BLOCKS_AT_ONCE, work)


@kernel
def _see(
    blocks: NDArray[np.int64],
    distance: NDArray[np.float32],
    weight: NDArray[np.float32],
    depth: NDArray[np.float32],
    pose: NDArray[np.float64],
    lens: NDArray[np.float64],
    voxel: Real,
    farthest: Real,
) -> None:
    """Take what ``depth`` (H, W) says into the mean ``distance`` (B, voxels) of the voxels of ``blocks`` (B, 3).

    Args:
        pose: (3, 4) world to camera, x right, y up, z backward.
        lens: fx, fy, cx, cy.
    """
    height, width = depth.shape
    reach = TRUNCATION * voxel
    radius = 0.9 * BLOCK * voxel
    for b in range(len(blocks)):
        x0, y0, z0 = (blocks[b, 0] * BLOCK) * voxel, (blocks[b, 1] * BLOCK) * voxel, (blocks[b, 2] * BLOCK) * voxel
        half = 0.5 * BLOCK * voxel
        x, y, z = x0 + half, y0 + half, z0 + half
        ahead = -(pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3])
        if ahead < -radius or ahead - radius > farthest:
            continue
        if ahead > radius:
            u = lens[2] + lens[0] * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / ahead
            v = lens[3] - lens[1] * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / ahead
            wide = 2 * lens[0] * radius / (ahead - 0.99 * radius)
            high = 2 * lens[1] * radius / (ahead - 0.99 * radius)
            if u < -wide or u > width + wide or v < -high or v > height + high:
                continue
        for k in range(BLOCK * BLOCK * BLOCK):
            x = x0 + (k // (BLOCK * BLOCK)) * voxel
            y = y0 + ((k // BLOCK) % BLOCK) * voxel
            z = z0 + (k % BLOCK) * voxel
            ahead = -(pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3])
            if ahead <= 1e-6:
                continue
            u = lens[2] + lens[0] * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / ahead
            v = lens[3] - lens[1] * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / ahead
            if not (u >= 0 and u < width and v >= 0 and v < height):
                continue
            seen = float(depth[int(v), int(u)])
            if seen <= 0:
                continue
            # Between four pixels of one surface depth is interpolated; a silhouette keeps its pixel.
            j, i = int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
            if j >= 0 and i >= 0 and j + 1 < width and i + 1 < height:
                a, c = float(depth[i, j]), float(depth[i, j + 1])
                e, f = float(depth[i + 1, j]), float(depth[i + 1, j + 1])
                low, high = min(min(a, c), min(e, f)), max(max(a, c), max(e, f))
                if low > 0 and high - low < reach:
                    s, t = u - 0.5 - j, v - 0.5 - i
                    seen = (1 - t) * ((1 - s) * a + s * c) + t * ((1 - s) * e + s * f)
            off = seen - ahead
            if off < -reach:
                continue
            says = 1.0 / max(seen * seen, 0.25)  # noise grows with the square of the depth
            total = weight[b, k] + says
            distance[b, k] = (weight[b, k] * distance[b, k] + says * min(1.0, off / reach)) / total
            weight[b, k] = total


# ---- The surface ----------------------------------------------------------------------------------------------------


def _surface(
    blocks: NDArray[np.int64],
    distance: NDArray[np.float32],
    weight: NDArray[np.float32],
    voxel: float,
    update: Callable[[float], None],
) -> Mesh:
    """The zero level of the distances, its faces turned to where they are positive."""
    low = blocks.min(0)
    table = np.full(tuple(np.ptp(blocks, axis=0) + 2), -1, np.int32)  # blocks beyond the last are none
    table[tuple((blocks - low).T)] = np.arange(len(blocks))
    size = (np.array(table.shape) * BLOCK).astype(np.int64)
    keys, places, edges = [], [], []
    for start in range(0, len(blocks), GATHERED):
        part = blocks[start : start + GATHERED] - low
        values, known = _padded(part, table, distance, weight)
        found = _cells(part, values, known, size)
        keys.append(found[0])
        places.append(found[1])
        edges.append(found[2])
        update(min(1.0, (start + GATHERED) / len(blocks)))
    key = np.concatenate(keys)
    order = np.argsort(key)
    key, vertices = key[order], np.concatenate(places)[order]
    faces = _faces(key, np.concatenate(edges), size)
    vertices = (vertices + low * BLOCK) * voxel
    return _large_pieces(Mesh(vertices, faces))


def _padded(
    part: NDArray[np.int64], table: NDArray[np.int32], distance: NDArray[np.float32], weight: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(n, 9, 9, 9) distances of blocks and of the first voxels of those behind, and whether they are known."""
    shape, side = (len(part), BLOCK + 1, BLOCK + 1, BLOCK + 1), (BLOCK, BLOCK, BLOCK)
    values, known = np.zeros(shape, np.float32), np.zeros(shape, bool)
    for offset in np.ndindex(2, 2, 2):
        other = table[tuple((part + offset).T)]
        there = other >= 0
        to = tuple(slice(BLOCK, None) if o else slice(0, BLOCK) for o in offset)
        of = tuple(slice(0, 1) if o else slice(0, BLOCK) for o in offset)
        inside = (np.flatnonzero(there), *to)
        values[inside] = distance[other[there]].reshape(-1, *side)[(slice(None), *of)]
        known[inside] = weight[other[there]].reshape(-1, *side)[(slice(None), *of)] > 0
    return values, known


def _cells(
    part: NDArray[np.int64], values: NDArray[np.float32], known: NDArray[np.bool_], size: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
    """Of the cells that the surface goes through: keys (m,), vertices (m, 3) in voxels, and the edges (e, 3) that it
    crosses: key of the cell whose first corner they begin in, axis, and whether the distance rises along them."""
    corners = {o: values[(slice(None), *(slice(k, BLOCK + k) for k in o))] for o in np.ndindex(2, 2, 2)}
    all_known = np.all([known[(slice(None), *(slice(k, BLOCK + k) for k in o))] for o in corners], axis=0)
    stacked = np.stack(list(corners.values()))
    lowest, highest = stacked.min(0), stacked.max(0)
    at = np.nonzero(all_known & (lowest < 0) & (highest >= 0) & (highest - lowest < MAX_JUMP))
    cell = part[at[0]] * BLOCK + np.stack(at[1:], 1)
    total, count = np.zeros((len(cell), 3)), np.zeros(len(cell))
    crossed = []
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    for axis in range(3):
        for begin in [o for o in corners if o[axis] == 0]:
            end = tuple(1 if k == axis else o for k, o in enumerate(begin))
            a, b = corners[begin][at].astype(np.float64), corners[end][at].astype(np.float64)
            cuts = (a < 0) != (b < 0)
            share = np.where(cuts, a / np.where(cuts, a - b, 1.0), 0.0)
            place = np.array(begin, np.float64) + share[:, None] * np.eye(3)[axis]
            total += np.where(cuts[:, None], place, 0.0)
            count += cuts
            if not any(begin):
                rises = (a < 0)[cuts].astype(np.int64)
                crossed.append(np.stack([key[cuts], np.full(int(cuts.sum()), axis), rises], 1))
    return key, cell + total / np.maximum(count, 1)[:, None], np.concatenate(crossed)


def _faces(key: NDArray[np.int64], edges: NDArray[np.int64], size: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3) two triangles between the four cells around each edge that all have a vertex."""
    steps = np.array([size[1] * size[2], size[2], 1])
    quads = []
    for axis in range(3):
        start, rises = edges[edges[:, 1] == axis, 0], edges[edges[:, 1] == axis, 2] == 1
        u, v = steps[(axis + 1) % 3], steps[(axis + 2) % 3]
        around = np.stack([start, start - u, start - u - v, start - v], 1)
        at = np.minimum(np.searchsorted(key, around), len(key) - 1)
        whole = (key[at] == around).all(1)
        quads.append(np.where(rises[whole, None], at[whole], at[whole][:, ::-1]))
    quad = np.concatenate(quads)
    return np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int64)


def _large_pieces(mesh: Mesh) -> Mesh:
    """The mesh without pieces of few faces, and without vertices that no face has."""
    faces, n = mesh.faces, len(mesh.vertices)
    links = coo_matrix((np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())), (n, n))
    label = connected_components(links, directed=False)[1]
    faces = faces[np.bincount(label[faces[:, 0]], minlength=n)[label[faces[:, 0]]] >= MIN_FACES]
    used = np.unique(faces)
    return Mesh(mesh.vertices[used], np.searchsorted(used, faces))
