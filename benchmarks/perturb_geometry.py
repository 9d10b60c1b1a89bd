"""Perturbations of the mesh: noise, holes, too few or too many triangles, regions merged.

The ground truth that names faces (lamps, relighting) follows the mesh; its images do not change.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from iris_addon.base.errors import BadInput
from iris_addon.base.files import atomic_write, write_json
from iris_addon.base.images import write_exr
from iris_addon.capture.fipt import read_fipt, read_fipt_views
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.evaluate.ground_truth import read_ground_truth, read_rgb
from iris_addon.model.capture import Mesh, View
from iris_addon.rays.tracer import Hits, Tracer, points_on_faces
from iris_addon.surface.topology import initial_regions, weld

from .perturb_masks import true_lamp_faces
from .remeshing import FaceMap, cluster, select, subdivide_edges
from .runs import SWEPT_VIEWS

HOLE_EDGE = 0.15
"""Metres: faces are cut to this before holes are, so that a wall of two triangles can have a hole."""
HOLE_SIZE = 0.8
"""Metres: wavelength of the random field whose peaks become holes."""
HOLE_RAYS = 20_000
LOOKED_AT = 0.15
"""Metres around what a pixel of a scored view hits that count as looked at."""


def shake_mesh(root: Path, _truth: Path, millimetres: float, rng: np.random.Generator) -> str:
    """Every vertex off by a normal error of ``millimetres`` per axis; vertices at one place move together."""
    mesh = _mesh(root)
    place = weld(mesh)
    move = rng.standard_normal((int(place.max()) + 1, 3)) * millimetres / 1000
    replace_mesh(root, Mesh(mesh.vertices + move[place], mesh.faces, None, mesh.regions), np.arange(len(mesh.faces)))
    return f"{millimetres:g} mm"


def cut_holes(root: Path, _truth: Path, share: float, rng: np.random.Generator) -> str:
    """Holes where a smooth random field peaks, as many as let ``share`` of the light-gathering rays escape.

    What the scored views look at goes last, and lamps stay: what is tested is light lost, not things lost.
    What lies behind a hole becomes zero in the true albedo maps, which is what a result shows there.
    """
    whole = _mesh(root)
    mesh, old = subdivide_edges(whole, HOLE_EDGE)
    tracer = Tracer(mesh)
    lamp = _lamp_mask(root, len(whole.faces))[old]
    cameras = [view.camera for view in _scored_views(root)]
    seen = [(tracer.closest(*camera.rays()), camera.rays()[1]) for camera in cameras]
    center = mesh.vertices[mesh.faces].mean(1)
    looked_at = np.unique(np.concatenate([hits.face[hits.face >= 0] for hits, _ in seen]))
    # Triangles may be smaller than pixels: what lies between those that were hit is looked at as well.
    last = cKDTree(center[looked_at]).query(center, distance_upper_bound=LOOKED_AT)[0] < LOOKED_AT
    field = _smooth_field(center, rng)
    field = np.where(lamp, -np.inf, field - np.ptp(field) * last)

    start, direction = _gather_rays(tracer, seen, rng)
    low, high = float(field[~lamp].min()), float(field.max())
    threshold, escaped = high, 0.0
    for _ in range(12):
        threshold = 0.5 * (low + high)
        escaped = float((Tracer(select(mesh, field <= threshold)[0]).hit_faces(start, direction) < 0).mean())
        low, high = (low, threshold) if escaped < share else (threshold, high)
    cut, old_of_cut = select(mesh, field <= threshold)
    replace_mesh(root, cut, old[old_of_cut])
    _hide_behind_holes(root, Tracer(cut))
    return f"{escaped:.1%} of the gather rays escape, {len(cut.faces) / len(mesh.faces):.0%} of the mesh is left"


def _scored_views(root: Path) -> tuple[View, ...]:
    """The views that sweeps render, else some training views."""
    val = read_fipt_views(root, "val") if (root / "val" / "transforms.json").is_file() else ()
    return (val or read_fipt_views(root, "train"))[:SWEPT_VIEWS]


def _gather_rays(
    tracer: Tracer, seen: list[tuple[Hits, NDArray[np.floating]]], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cosine-distributed rays from random points that views see: origins and directions, (HOLE_RAYS, 3)."""
    face = np.concatenate([hits.face[hits.face >= 0] for hits, _ in seen])
    weights = np.concatenate([hits.barycentric[hits.face >= 0] for hits, _ in seen])
    towards = np.concatenate([direction[hits.face >= 0] for hits, direction in seen])
    pick = rng.integers(0, len(face), HOLE_RAYS)
    normal = tracer.normals[face[pick]]
    normal = normal * -np.sign((normal * towards[pick]).sum(1, keepdims=True))
    sphere = rng.standard_normal((HOLE_RAYS, 3))
    direction = normal + 0.999 * sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return points_on_faces(tracer.corners, face[pick], weights[pick]) + tracer.epsilon * normal, direction


def _hide_behind_holes(root: Path, tracer: Tracer) -> None:
    """Zero in the true albedo maps where rays of the training views now escape."""
    truth = read_ground_truth(root)
    for index, view in enumerate(truth.views if truth else ()):
        assert truth is not None
        gone = tracer.hit_faces(*view.camera.rays()) < 0
        for kind in ("DiffCol", "BaseCol", "albedo"):
            path = truth.path(f"train/{kind}", index)
            if path is not None:
                values = read_rgb(path)
                write_exr(path, np.where(gone.reshape(values.shape[:2])[..., None], 0, values))


def _smooth_field(points: NDArray[np.float64], rng: np.random.Generator, waves: int = 48) -> NDArray[np.float64]:
    """(n,) sum of random plane waves with the wavelength of the holes, at ``points`` (n, 3)."""
    direction = rng.standard_normal((waves, 3))
    direction *= 2 * np.pi / HOLE_SIZE / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.cos(points @ direction.T + rng.uniform(0, 2 * np.pi, waves)).sum(1) / np.sqrt(waves / 2)


def cluster_vertices(root: Path, _truth: Path, centimetres: float, _rng: np.random.Generator) -> str:
    """A coarse scan: vertices merged within cells of ``centimetres``; lamps keep their triangles."""
    mesh = _mesh(root)
    coarse, old = cluster(mesh, centimetres / 100, _lamp_mask(root, len(mesh.faces)))
    replace_mesh(root, coarse, old)
    return f"{len(coarse.faces)} of {len(mesh.faces)} triangles"


def subdivide(root: Path, _truth: Path, centimetres: float, _rng: np.random.Generator) -> str:
    """An over-dense mesh of the same shape: no edge longer than ``centimetres``."""
    mesh, old = subdivide_edges(_mesh(root), centimetres / 100)
    replace_mesh(root, mesh, old)
    return f"{len(mesh.faces)} triangles"


def merge_regions(root: Path, _truth: Path, share: float, rng: np.random.Generator) -> str:
    """A random ``share`` of the regions are one region, as in a scan that fuses what touches."""
    mesh = _mesh(root)
    regions = initial_regions(mesh)
    ids = rng.permutation(np.unique(regions))
    merged = ids[: int(np.ceil(share * len(ids)))]
    regions = np.where(np.isin(regions, merged), merged[0], regions)
    if len(np.unique(regions)) == 1:
        # A file with one region counts as a file without; a single face elsewhere makes it one with regions.
        regions[0] = regions.max() + 1
    replace_mesh(root, Mesh(mesh.vertices, mesh.faces, None, regions), np.arange(len(mesh.faces)))
    return f"{len(merged)} of {len(ids)} regions are one"


# ---- files ---------------------------------------------------------------------------------------------------------


def _mesh(root: Path) -> Mesh:
    return read_mesh(read_fipt(root).mesh_file)[0]


def _lamp_mask(root: Path, n_faces: int) -> NDArray[np.bool_]:
    mask = np.zeros(n_faces, bool)
    mask[np.concatenate(true_lamp_faces(root))] = True
    return mask


def replace_mesh(root: Path, mesh: Mesh, old: FaceMap) -> None:
    """Put ``mesh`` in the place of the capture's, and let what names faces name those that come from them."""
    read_fipt(root).mesh_file.unlink()
    write_obj(root / "scene.obj", mesh)
    emitters = root / "gt" / "emitters.json"
    if emitters.is_file():
        listed = json.loads(emitters.read_text(encoding="utf-8"))
        for entry in listed:
            entry["faces"] = np.searchsorted(old, entry["faces"]).tolist()
        write_json(emitters, listed)
    lights = root / "relight" / "lights.json"
    if lights.is_file():
        content = json.loads(lights.read_text(encoding="utf-8"))
        region = content.get("one_emitter", {})
        if "kept_faces_of_scene_ply" in region:
            region["kept_faces_of_scene_ply"] = np.flatnonzero(np.isin(old, region["kept_faces_of_scene_ply"])).tolist()
        write_json(lights, content)


def write_obj(path: Path, mesh: Mesh) -> None:
    """A plain OBJ of ``mesh``, faces in their order, a group line wherever the region changes."""
    if not np.isfinite(mesh.vertices).all():
        raise BadInput("has vertices that are not finite", "restore the mesh", path)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    regions = [None] * len(mesh.faces) if mesh.regions is None else mesh.regions.tolist()
    before = None
    for (a, b, c), region in zip((mesh.faces + 1).tolist(), regions, strict=True):
        if region != before:
            lines.append(f"g region{region}")
            before = region
        lines.append(f"f {a} {b} {c}")
    text = "\n".join(lines) + "\n"
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
