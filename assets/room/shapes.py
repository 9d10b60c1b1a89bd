"""Meshes the room is made of. All lengths in metres, z up, UVs in metres unless said otherwise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

Vec = Sequence[float]


def _link(name: str, mesh: bpy.types.Mesh, material: bpy.types.Material, smooth: bool) -> bpy.types.Object:
    mesh.materials.append(material)
    mesh.shade_smooth() if smooth else mesh.shade_flat()
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def from_arrays(
    name: str, vertices: NDArray, faces: Sequence[Sequence[int]], material: bpy.types.Material, *, smooth: bool = False
) -> bpy.types.Object:
    """Object from (V, 3) vertices and polygons."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices, dtype=float).tolist(), [], [list(map(int, f)) for f in faces])
    return _link(name, mesh, material, smooth)


def box(
    name: str,
    low: Vec,
    high: Vec,
    material: bpy.types.Material,
    *,
    bevel: float = 0.004,
    segments: int = 2,
    turn: float = 0.0,
) -> bpy.types.Object:
    """Axis-aligned box with rounded edges, turned by ``turn`` radians about the vertical through its centre.

    UVs are a box projection whose u runs along the longest side, so that wood grain does.
    """
    size, centre = np.subtract(high, low), np.add(high, low) / 2
    bm = bmesh.new()
    bmesh.ops.create_cube(bm, size=1.0)
    bmesh.ops.scale(bm, vec=Vector(size), verts=bm.verts)
    if bevel > 0:
        width = min(bevel, 0.45 * float(size.min()))
        bmesh.ops.bevel(
            bm, geom=bm.edges[:], offset=width, segments=segments, profile=0.5, affect="EDGES", clamp_overlap=True
        )
    box_uv(bm, along=int(size.argmax()), origin=centre)
    mesh = bpy.data.meshes.new(name)
    bm.to_mesh(mesh)
    bm.free()
    thing = _link(name, mesh, material, smooth=False)
    thing.matrix_world = Matrix.Translation(centre) @ Matrix.Rotation(turn, 4, "Z")
    return thing


def box_uv(bm: bmesh.types.BMesh, along: int, origin: Vec) -> None:
    """Project each face along its dominant axis; ``along`` (0, 1, 2) becomes u wherever the face contains it."""
    layer = bm.loops.layers.uv.verify()
    for face in bm.faces:
        axis = max(range(3), key=lambda k: abs(face.normal[k]))
        u = along if along != axis else (axis + 1) % 3
        v = 3 - axis - u
        for loop in face.loops:
            loop[layer].uv = (loop.vert.co[u] + origin[u], loop.vert.co[v] + origin[v])


def panel(
    name: str, corners: Sequence[Vec], material: bpy.types.Material, size: tuple[float, float] | None = None
) -> bpy.types.Object:
    """Flat quad; UVs span [0, 1]², or metres when ``size`` is given. Corners counter-clockwise from bottom left."""
    thing = from_arrays(name, np.array(corners), [(0, 1, 2, 3)], material)
    u, v = size or (1.0, 1.0)
    layer = thing.data.uv_layers.new(name="UVMap")
    for loop, uv in zip(layer.data, [(0, 0), (u, 0), (u, v), (0, v)], strict=True):
        loop.uv = uv
    return thing


def lathe(
    name: str, profile: Sequence[tuple[float, float]], at: Vec, material: bpy.types.Material, *, segments: int = 40
) -> bpy.types.Object:
    """Surface of revolution of (radius, height) points about the vertical through ``at``; a radius of 0 closes it."""
    angles = np.linspace(0, 2 * math.pi, segments, endpoint=False)
    vertices: list[tuple[float, float, float]] = []
    rings: list[list[int]] = []
    for radius, height in profile:
        start = len(vertices)
        ring = (
            [(0.0, 0.0, height)]
            if radius == 0
            else [(radius * math.cos(a), radius * math.sin(a), height) for a in angles]
        )
        vertices += ring
        rings.append(list(range(start, start + len(ring))) * (segments if len(ring) == 1 else 1))
    faces = []
    for lower, upper in itertools.pairwise(rings):
        for k in range(segments):
            n = (k + 1) % segments
            corners = [lower[k], lower[n], upper[n], upper[k]]
            faces.append(list(dict.fromkeys(corners)))
    thing = from_arrays(name, np.array(vertices) + np.array(at), faces, material, smooth=True)
    thing.data.set_sharp_from_angle(angle=math.radians(40))
    return thing


def cylinder(
    name: str,
    start: Vec,
    end: Vec,
    radius: float,
    material: bpy.types.Material,
    *,
    segments: int = 16,
    top: float | None = None,
) -> bpy.types.Object:
    """Closed cylinder (or cone, with another radius at its end) between two points."""
    axis = Vector(np.subtract(end, start))
    length, tip = axis.length, radius if top is None else top
    profile = [(0, 0), (radius, 0), (tip, length), (0, length)]
    thing = lathe(name, profile, (0, 0, 0), material, segments=segments)
    thing.matrix_world = Matrix.Translation(Vector(start)) @ axis.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return thing


def tube(
    name: str, path: NDArray, radius: float, material: bpy.types.Material, *, segments: int = 10
) -> bpy.types.Object:
    """Round tube along (n, 3) points, ends closed."""
    path = np.asarray(path, dtype=float)
    tangent = np.gradient(path, axis=0)
    vertices, faces = [], []
    for point, direction in zip(path, tangent, strict=True):
        frame = Vector(direction).to_track_quat("Z", "Y").to_matrix()
        for a in np.linspace(0, 2 * math.pi, segments, endpoint=False):
            vertices.append(Vector(point) + frame @ Vector((radius * math.cos(a), radius * math.sin(a), 0)))
    for i in range(len(path) - 1):
        for k in range(segments):
            n = (k + 1) % segments
            faces.append((i * segments + k, i * segments + n, (i + 1) * segments + n, (i + 1) * segments + k))
    faces.append(range(segments - 1, -1, -1))
    faces.append(range((len(path) - 1) * segments, len(path) * segments))
    return from_arrays(name, np.array(vertices), faces, material, smooth=True)


def ball(
    name: str, centre: Vec, radius: float, material: bpy.types.Material, *, subdivisions: int = 3
) -> bpy.types.Object:
    """Icosphere."""
    bm = bmesh.new()
    bmesh.ops.create_icosphere(bm, subdivisions=subdivisions, radius=radius)
    mesh = bpy.data.meshes.new(name)
    bm.to_mesh(mesh)
    bm.free()
    thing = _link(name, mesh, material, smooth=True)
    thing.location = centre
    return thing


def cushion(
    name: str,
    centre: Vec,
    size: Vec,
    material: bpy.types.Material,
    *,
    turn: float = 0.0,
    tilt: float = 0.0,
    square: float = 0.45,
) -> bpy.types.Object:
    """Soft pillow: a superellipsoid (``square`` → 0 is a box, 1 an ellipsoid), tilted about y, then turned about z."""
    n = 16
    theta = np.linspace(-math.pi / 2, math.pi / 2, n + 1)
    phi = np.linspace(-math.pi, math.pi, 2 * n, endpoint=False)

    def power(x: NDArray) -> NDArray:
        return np.sign(x) * np.abs(x) ** square

    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = np.stack([power(np.cos(t)) * power(np.cos(p)), power(np.cos(t)) * power(np.sin(p)), power(np.sin(t))], -1)
    points = points.reshape(-1, 3) * np.array(size) / 2
    faces = [
        (i * 2 * n + k, i * 2 * n + (k + 1) % (2 * n), (i + 1) * 2 * n + (k + 1) % (2 * n), (i + 1) * 2 * n + k)
        for i in range(n)
        for k in range(2 * n)
    ]
    thing = from_arrays(name, points, faces, material, smooth=True)
    bm = bmesh.new()
    bm.from_mesh(thing.data)
    bmesh.ops.remove_doubles(bm, verts=bm.verts, dist=1e-5)
    bmesh.ops.dissolve_degenerate(bm, edges=bm.edges, dist=1e-5)
    box_uv(bm, along=int(np.argmax(size)), origin=(0, 0, 0))
    bm.to_mesh(thing.data)
    bm.free()
    thing.matrix_world = (
        Matrix.Translation(Vector(centre)) @ Matrix.Rotation(turn, 4, "Z") @ Matrix.Rotation(tilt, 4, "Y")
    )
    return thing


def sheet(
    name: str,
    start: Vec,
    end: Vec,
    z: tuple[float, float],
    material: bpy.types.Material,
    *,
    waves: int,
    depth: float,
    side: Vec,
) -> bpy.types.Object:
    """Hanging curtain between two points of the plan: folds of ``depth`` towards ``side``, wider at the hem."""
    columns, rows = waves * 12 + 1, 8
    s, h = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    flat = np.asarray(start) + s[..., None] * np.subtract(end, start)
    swing = 0.5 - 0.5 * np.cos(2 * math.pi * waves * s + 0.7 * np.sin(5 * s))
    offset = (swing * depth * (1.0 - 0.35 * h))[..., None] * np.asarray(side)
    points = np.concatenate([(flat + offset)[..., :2], (z[0] + h * (z[1] - z[0]))[..., None]], -1).reshape(-1, 3)
    faces = [
        (r * columns + c, r * columns + c + 1, (r + 1) * columns + c + 1, (r + 1) * columns + c)
        for r in range(rows - 1)
        for c in range(columns - 1)
    ]
    return from_arrays(name, points, faces, material, smooth=True)
