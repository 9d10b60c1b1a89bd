"""The surface behind a scan: what a scanner measured, less its noise.

The mesh of a scan is a measurement. Its triangles tilt by ten degrees from their neighbours, so that a floor has no
mirror image, no two patches of a wall receive the same light, and rays that leave a surface meet its own bumps. Walls,
floors and tables are planes, and most else is smooth. Both are estimated here:

- normals by bilateral filtering on the faces, guided by smoothed normals (Zheng et al. 2011, "Bilateral Normal
  Filtering for Mesh Denoising"; Zhang et al. 2015, "Guided Mesh Normal Filtering"), with a range that follows the
  noise;
- planes by region growing on the filtered normals, each fitted to all its faces (:func:`grow_planes`);
- places of the vertices on planes, where the planes of their faces meet (Sun et al. 2007, "Fast and Effective
  Feature-Preserving Mesh Denoising"). Photos agree better on them there, and less on others that follow their normals.

Faces and vertices keep their numbers: whatever is found on this surface is written onto the user's own mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import kernel
from ..base.group_by import MAD, rank_in_group
from ..base.parallel import BLOCK, over_blocks
from ..base.progress import Progress
from ..cameras.registration import photo_disagreement
from ..decide import Decisions
from ..model.capture import DEGENERATE_AREA, Capture, Mesh
from ..rays.engines import RayEngine
from ..rays.tracer import Tracer
from .topology import component_labels, edge_adjacency, smooth_components, smooth_edges, weld

FLAT_COSINE = 0.9999
"""Cosine between normals from which on they are those of one plane."""
SCAN_MIN_FACES = 20_000
"""Faces from which on a component may be a scan, not a modelled object."""
SCAN_MIN_SHARE = 0.3
"""Share of the area of the mesh from which on a component may be a scan."""
SCAN_MAX_FLAT_EDGES = 0.5
"""Share of flat edges below which a component may be a scan: a modelled wall cut fine stays flat, a scanned one is
rough."""
FILTER_PASSES = 16
"""Passes of the filter; light of a face spreads over the square root of as many faces."""
GUIDE_PASSES = 2
"""Plain means over neighbours that make the guide of a pass."""
RANGE_PER_NOISE, MIN_RANGE, MAX_RANGE = 1.0, 0.15, 0.5
"""Standard deviation of the filter in the guide, in noise of a normal, and its limits; 1 is 57 degrees."""
PLANE_TURN = np.cos(np.radians(12.0))
"""Cosine between the normals of a face and of the plane that it may belong to."""
PLANE_FLATNESS = np.radians(4.0)
"""Root mean square angle between the filtered normals of faces and their plane, up to which it is one."""
FIRST_PLANE_OFF = 1.0
"""Distance from its plane that a face may have while the noise is not known, lengths of the mesh's edges."""
PLANE_OFF = 4.0
"""Distance from its plane that a face may have, in the noise of places."""
PLANE_MIN_FACES = 150
"""Faces of a plane, at least: fewer are as well described by their filtered normals."""
VERTEX_PASSES = 10
"""Passes in which vertices move to where the planes of their faces meet."""
MAX_SHIFT = 4.0
"""Shift of a vertex at most, in lengths of the mesh's median edge."""


@dataclass(frozen=True)
class ScanSurface:
    """The surface behind a mesh of F faces.

    Attributes:
        adjacency: pairs of faces that share an edge, two (k,).
        mesh: the mesh with its vertices where the surface is; the same arrays where nothing was scanned.
        normals: (F, 3) float32 unit normals of the surface; zero for degenerate faces.
        scanned: (F,) bool, faces of scans.
        plane: (F,) int32 plane of each face, -1 for none.
        noise: standard deviation of the scan's places, metres; 0 where nothing was scanned.
    """

    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]
    mesh: Mesh
    normals: NDArray[np.float32]
    scanned: NDArray[np.bool_]
    plane: NDArray[np.int32]
    noise: float

    @property
    def outline_error(self) -> float:
        """How far the outline of a scanned thing may be off, metres: a triangle's edge; 0 where nothing was scanned."""
        if not self.scanned.any():
            return 0.0
        return edge_length(face_normals(self.mesh.vertices, self.mesh.faces)[1][self.scanned])

    @property
    def pieces(self) -> NDArray[np.int32]:
        """(F,) smooth piece of the surface that each face lies on: a plane, or what lies between planes and creases."""
        return smooth_components(self.normals, self.adjacency, self.plane)


def face_normals(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> tuple[NDArray, NDArray]:
    """Unit normals (F, 3), zero for degenerate faces, and areas (F,)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-300)[:, None] * (length > 0)[:, None], 0.5 * length


def surface_behind(mesh: Mesh) -> ScanSurface:
    """The surface that ``mesh`` is a measurement of; a modelled mesh is that itself."""
    adjacency = edge_adjacency(mesh)
    normals, areas = face_normals(mesh.vertices, mesh.faces)
    scanned = scanned_faces(normals, areas, adjacency)
    none = np.full(len(mesh.faces), -1, np.int32)
    if not scanned.any():
        return ScanSurface(
            adjacency=adjacency,
            mesh=mesh,
            normals=normals.astype(np.float32),
            scanned=scanned,
            plane=none,
            noise=0.0,
        )
    near = neighbours_of(len(mesh.faces), adjacency, scanned)
    smooth = filter_normals(normals, areas, near, scanned)
    centre = mesh.vertices[mesh.faces].mean(1)
    plane, equation = grow_planes(centre, smooth, areas, near, FIRST_PLANE_OFF * edge_length(areas[scanned]))
    noise = place_noise(centre, plane, equation)
    plane, equation = grow_planes(centre, smooth, areas, near, PLANE_OFF * noise)
    on = plane >= 0
    smooth[on] = equation[plane[on], :3]
    offset = np.full(len(plane), np.nan)
    offset[on] = equation[plane[on], 3]
    vertices = moved_vertices(mesh, smooth, areas, offset, scanned)
    return ScanSurface(
        adjacency=adjacency,
        mesh=replace(mesh, vertices=vertices),
        normals=smooth.astype(np.float32),
        scanned=scanned,
        plane=plane,
        noise=noise,
    )


def choose_surface(
    capture: Capture, rng: np.random.Generator, progress: Progress, decisions: Decisions, engine: RayEngine
) -> tuple[ScanSurface, Tracer]:
    """The surface behind the mesh of ``capture`` and its tracer; the mesh itself if photos agree less on the former.

    Args:
        rng: picks the points on which photos are compared, the same for both.
        engine: what the rays of the tracer run on.

    Raises:
        BadInput: a photo cannot be read.
    """
    surface = surface_behind(capture.mesh)
    tracer = Tracer(surface.mesh, surface.normals, surface.noise, engine=engine)
    if not surface.scanned.any():
        return surface, tracer
    given = Tracer(capture.mesh, engine=engine)
    smaller, larger = photo_disagreement(capture, (given, tracer), rng, progress)
    told = smaller > 0 or larger > 0  # where no point lies in three photos of one light, photos do not decide
    if not told or decisions.accept("scan_surface", smaller, larger):
        return surface, tracer
    return replace(surface, mesh=capture.mesh, normals=given.normals, noise=0.0), given


def scanned_faces(
    normals: NDArray[np.floating], areas: NDArray[np.floating], adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> NDArray[np.bool_]:
    """(F,) faces of components that were scanned: many faces, a large share of the mesh, and hardly a flat edge.

    Args:
        normals: (F, 3) unit.
        areas: (F,) square metres.
    """
    component = component_labels(len(normals), *adjacency)
    size = np.bincount(component)
    share = np.bincount(component, areas) / max(areas.sum(), 1e-300)
    edges_of = component[adjacency[0]]
    flat = np.bincount(edges_of, smooth_edges(normals, adjacency, FLAT_COSINE), len(size))
    rough = flat < SCAN_MAX_FLAT_EDGES * np.bincount(edges_of, minlength=len(size))
    return ((size >= SCAN_MIN_FACES) & (share >= SCAN_MIN_SHARE) & rough)[component]


def neighbours_of(
    n_faces: int, adjacency: tuple[NDArray[np.int64], NDArray[np.int64]], among: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """(F, 3) faces across the edges of each face that are ``among`` (F,) the same ones, -1 where there is none."""
    inside = among[adjacency[0]] & among[adjacency[1]]
    one, other = (ends[inside] for ends in adjacency)
    own, across = np.concatenate([one, other]), np.concatenate([other, one])
    order = np.argsort(own, kind="stable")
    own, across = own[order], across[order]
    rank = rank_in_group(own)
    near = np.full((n_faces, 3), -1, np.int32)
    kept = rank < 3  # more only where an edge has more than two faces
    near[own[kept], rank[kept]] = across[kept]
    return near


# ---- Normals --------------------------------------------------------------------------------------------------------


def filter_normals(
    normals: NDArray[np.floating],
    areas: NDArray[np.floating],
    near: NDArray[np.int32],
    scanned: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """(F, 3) unit normals without the noise of a scan; those of other faces stay.

    Args:
        normals: (F, 3) unit.
        areas: (F,) square metres.
        near: (F, 3) of :func:`neighbours_of`.
    """
    guide = _passes(normals, normals, areas, near, np.inf, GUIDE_PASSES)
    turn = np.linalg.norm(guide - normals, axis=1)[scanned]
    noise = float(np.median(turn)) / 1.1774  # of a Rayleigh distribution
    width = float(np.clip(RANGE_PER_NOISE * noise, MIN_RANGE, MAX_RANGE))
    smooth = normals.astype(np.float64)
    for _ in range(FILTER_PASSES):
        guide = _passes(smooth, smooth, areas, near, np.inf, GUIDE_PASSES)
        smooth = _passes(smooth, guide, areas, near, width, 1)
    smooth[~scanned] = normals[~scanned]
    return smooth


def _passes(
    normals: NDArray[np.floating],
    guide: NDArray[np.floating],
    areas: NDArray[np.floating],
    near: NDArray[np.int32],
    width: float,
    passes: int,
) -> NDArray[np.float64]:
    """Normals (F, 3) averaged over neighbours ``passes`` times, by area and a Gaussian of ``width`` in the guide."""
    values = np.ascontiguousarray(normals, np.float64)
    for _ in range(passes):
        mean = np.empty_like(values)

        def work(rows: slice, values: NDArray[np.float64], mean: NDArray[np.float64]) -> None:
            _average(rows.start, values, guide, areas, near, 0.5 / width**2, mean[rows])

        source = values
        over_blocks(len(values), BLOCK, lambda rows, source=source, mean=mean: work(rows, source, mean))
        values = mean
    return values


@kernel
def _average(
    first: int,
    values: NDArray[np.float64],
    guide: NDArray[np.float64],
    areas: NDArray[np.float64],
    near: NDArray[np.int32],
    precision: float,
    mean: NDArray[np.float64],
) -> None:
    for k in range(len(mean)):
        f = first + k
        x, y, z = areas[f] * values[f, 0], areas[f] * values[f, 1], areas[f] * values[f, 2]
        for j in range(3):
            g = near[f, j]
            if g >= 0:
                turn = 0.0
                for c in range(3):
                    turn += (guide[f, c] - guide[g, c]) ** 2
                w = areas[g] * math.exp(-precision * turn)
                x += w * values[g, 0]
                y += w * values[g, 1]
                z += w * values[g, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if length > 0:
            mean[k, 0], mean[k, 1], mean[k, 2] = x / length, y / length, z / length
        else:
            mean[k, 0], mean[k, 1], mean[k, 2] = values[f, 0], values[f, 1], values[f, 2]


def place_noise(centre: NDArray[np.floating], plane: NDArray[np.int32], equation: NDArray[np.floating]) -> float:
    """Standard deviation of a scan's places in metres, from the distances of faces to their planes.

    Args:
        centre: (F, 3) metres.
        plane: (F,) plane of each face, -1 for none.
        equation: (n, 4) unit normal and offset of each plane.
    """
    on = np.flatnonzero(plane >= 0)
    if not len(on):
        return 0.0
    own = equation[plane[on]]
    return MAD * float(np.median(np.abs((centre[on] * own[:, :3]).sum(1) - own[:, 3])))


# ---- Planes ---------------------------------------------------------------------------------------------------------


def grow_planes(
    centre: NDArray[np.floating],
    normals: NDArray[np.floating],
    areas: NDArray[np.floating],
    near: NDArray[np.int32],
    reach: float,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Plane (F,) of each face, -1 for none, and of each plane its unit normal and offset (n, 4).

    A plane grows from a face whose neighbours turn least over connected faces whose normals and places are its own
    within the noise, is fitted to them, and grows once more from there.

    Args:
        centre: (F, 3) metres.
        normals: (F, 3) filtered.
        reach: distance from a plane up to which a face belongs to it, metres.
    """
    turn = np.zeros(len(normals))
    for j in range(3):
        turn += np.where(near[:, j] >= 0, 1 - (normals * normals[near[:, j]]).sum(1), 1.0)
    seeds = np.argsort(turn, kind="stable")
    seeds = seeds[turn[seeds] < 3 * (1 - PLANE_TURN)].astype(np.int32)
    plane = np.full(len(normals), -1, np.int32)
    equation = np.zeros((1 + len(normals) // PLANE_MIN_FACES, 4))
    queue, tried = np.empty(len(normals), np.int32), np.full(len(normals), -1, np.int32)
    limits = np.array([PLANE_TURN, reach, PLANE_FLATNESS**2, PLANE_MIN_FACES])
    n = _grow(seeds, centre, normals, areas, near, limits, queue, tried, plane, equation)
    return plane, equation[:n]


@kernel
def _grow(
    seeds: NDArray[np.int32],
    centre: NDArray[np.float64],
    normals: NDArray[np.float64],
    areas: NDArray[np.float64],
    near: NDArray[np.int32],
    limits: NDArray[np.float64],
    queue: NDArray[np.int32],
    tried: NDArray[np.int32],
    plane: NDArray[np.int32],
    equation: NDArray[np.float64],
) -> int:
    """Fill ``plane`` and ``equation``; returns the number of planes.

    Args:
        limits: cosine, distance, mean square angle and number of faces of a plane.
        queue, tried: (F,) memory; ``tried`` holds the last attempt that visited each face.
    """
    count = attempt = 0
    for seed in seeds:
        if plane[seed] >= 0 or tried[seed] >= 0:
            continue
        nx, ny, nz = normals[seed, 0], normals[seed, 1], normals[seed, 2]
        d = nx * centre[seed, 0] + ny * centre[seed, 1] + nz * centre[seed, 2]
        length, spread = 0, 0.0
        for round_ in range(3):
            attempt += 1
            queue[0], length, head = seed, 1, 0
            tried[seed] = attempt
            sx = sy = sz = px = py = pz = total = 0.0
            while head < length:
                f = queue[head]
                head += 1
                w = areas[f]
                total += w
                sx += w * normals[f, 0]
                sy += w * normals[f, 1]
                sz += w * normals[f, 2]
                px += w * centre[f, 0]
                py += w * centre[f, 1]
                pz += w * centre[f, 2]
                if round_ == 0 and head % 32 == 0:  # the seed's own normal has too much noise for a whole wall
                    size = math.sqrt(sx * sx + sy * sy + sz * sz)
                    nx, ny, nz = sx / size, sy / size, sz / size
                    d = (nx * px + ny * py + nz * pz) / total
                for j in range(3):
                    g = near[f, j]
                    if g < 0 or plane[g] >= 0 or tried[g] == attempt:
                        continue
                    if normals[g, 0] * nx + normals[g, 1] * ny + normals[g, 2] * nz < limits[0]:
                        continue
                    off = centre[g, 0] * nx + centre[g, 1] * ny + centre[g, 2] * nz - d
                    if abs(off) > limits[1]:
                        continue
                    tried[g] = attempt
                    queue[length] = g
                    length += 1
            size = math.sqrt(sx * sx + sy * sy + sz * sz)
            if size <= 0 or total <= 0:
                break
            nx, ny, nz = sx / size, sy / size, sz / size
            d = (nx * px + ny * py + nz * pz) / total
            spread = 2 * (1 - size / total)  # mean square angle of the normals about their mean
            if length < limits[3]:
                break
        if length < limits[3] or spread > limits[2]:
            continue
        for k in range(length):
            plane[queue[k]] = count
        equation[count, 0], equation[count, 1], equation[count, 2], equation[count, 3] = nx, ny, nz, d
        count += 1
    return count


# ---- Places ---------------------------------------------------------------------------------------------------------


def moved_vertices(
    mesh: Mesh,
    normals: NDArray[np.floating],
    areas: NDArray[np.floating],
    offset: NDArray[np.floating],
    scanned: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """(V, 3) vertices, those that have only faces on planes moved to where these meet.

    Args:
        normals: (F, 3) unit normals of the planes.
        areas: (F,) square metres.
        offset: (F,) of the plane of each face, NaN for a face of none.
        scanned: (F,) faces whose vertices may move.
    """
    label = weld(mesh)
    n = int(label.max()) + 1
    start = np.empty((n, 3))
    start[label] = mesh.vertices
    rows = np.flatnonzero(scanned)
    corner, weight = label[mesh.faces[rows]], np.maximum(areas[rows], DEGENERATE_AREA)
    place, normal, plane = start.copy(), np.ascontiguousarray(normals[rows], np.float64), offset[rows]
    for _ in range(VERTEX_PASSES):
        push, norm = np.zeros((n, 3)), np.zeros(n)
        _push(corner, normal, weight, plane, place, push, norm)
        place += push / np.maximum(norm, 1e-300)[:, None]
    shift = place - start
    far = np.linalg.norm(shift, axis=1, keepdims=True)
    shift[corner[np.isnan(plane)]] = 0
    shift *= np.minimum(1.0, MAX_SHIFT * edge_length(weight) / np.maximum(far, 1e-12))
    return np.asarray(mesh.vertices + shift[label], np.float64)


def edge_length(areas: NDArray[np.floating]) -> float:
    """Length in metres of the edge of an equilateral triangle of the median of ``areas`` (F,)."""
    return 1.52 * float(np.sqrt(np.median(areas)))


@kernel
def _push(
    corner: NDArray[np.int64],
    normals: NDArray[np.float64],
    weight: NDArray[np.float64],
    offset: NDArray[np.float64],
    place: NDArray[np.float64],
    push: NDArray[np.float64],
    norm: NDArray[np.float64],
) -> None:
    """Add to ``push`` (n, 3) and ``norm`` (n,) how far the plane of each face is from its vertices, by area."""
    for f in range(len(corner)):
        nx, ny, nz, w, d = normals[f, 0], normals[f, 1], normals[f, 2], weight[f], offset[f]
        if math.isnan(d):
            continue
        for k in range(3):
            v = corner[f, k]
            off = w * (d - nx * place[v, 0] - ny * place[v, 1] - nz * place[v, 2])
            push[v, 0] += off * nx
            push[v, 1] += off * ny
            push[v, 2] += off * nz
            norm[v] += w
