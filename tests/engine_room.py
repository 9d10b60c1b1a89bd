"""A furnished box room of known albedo and lamps, its radiosity, and its photos: what the engine has to find again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from iris_addon.base.images import write_png
from iris_addon.base.progress import Progress
from iris_addon.brdf.ggx import DIELECTRIC_F0, specular_integrals
from iris_addon.model.capture import Camera, Capture, Mesh, View
from iris_addon.model.response import Response
from iris_addon.rays.sampling import Origins
from iris_addon.rays.tracer import Tracer
from iris_addon.response.observations import Observations, observe
from iris_addon.surface.patches import Surface, build_surface
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from iris_addon.transport.form_factors import emitter_form_factors
from iris_addon.transport.gather import gather
from iris_addon.transport.transport import Transport, build_transport
from tests.box_room import look_at

SIZE = np.array([4.0, 3.0, 2.5])
WALLS = ("x-", "x+", "y-", "y+", "floor", "ceiling")
ALBEDO = np.array(
    [
        [0.60, 0.30, 0.25],
        [0.25, 0.45, 0.30],
        [0.80, 0.80, 0.78],
        [0.55, 0.55, 0.60],
        [0.35, 0.30, 0.25],
        [0.75, 0.75, 0.75],
        [0.20, 0.30, 0.55],
        [0.65, 0.60, 0.30],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
    ]
)
"""Six walls, two boxes, two lamps."""
MEAN_COSINES = np.sqrt((np.arange(64) + 0.5) / 64)
"""Equal steps of the cosine-weighted hemisphere."""
LAMP_REGIONS = (8, 9)
LAMP_RADIANCE = np.array([[9.0, 8.0, 6.0], [14.0, 15.0, 17.0]])


@dataclass(frozen=True)
class Room:
    """Regions of constant albedo (n, 3); ``emission`` (n, 3) is radiance, both sides."""

    mesh: Mesh
    albedo: np.ndarray
    emission: np.ndarray

    @property
    def regions(self) -> np.ndarray:
        assert self.mesh.regions is not None
        return self.mesh.regions

    def lamps(self) -> list[np.ndarray]:
        """Faces of each lamp."""
        return [np.flatnonzero(self.regions == region) for region in np.flatnonzero(self.emission.any(1))]


def quad(corner, u, v, cells: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a parallelogram in triangles with legs of at most ``cells`` metres."""
    corner, u, v = (np.asarray(x, float) for x in (corner, u, v))
    n, m = (max(1, int(np.ceil(np.linalg.norm(edge) / cells))) for edge in (u, v))
    s, t = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    vertices = corner + s.reshape(-1, 1) * u + t.reshape(-1, 1) * v
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a = (i * (m + 1) + j).ravel()
    b, c, d = a + m + 1, a + m + 2, a + 1
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def box(low, high, cells: float = np.inf) -> list[tuple[np.ndarray, np.ndarray]]:
    """The six sides of a box: x-, x+, y-, y+, z-, z+."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    sides = []
    for axis in range(3):
        u, v = (np.eye(3)[k] * (high - low) for k in range(3) if k != axis)
        far = low + np.eye(3)[axis] * (high - low)
        sides += [quad(low, u, v, cells), quad(far, u, v, cells)]
    return sides


def assemble(pieces: list[tuple[np.ndarray, np.ndarray]], regions: list[int]) -> Mesh:
    """One mesh with the region of each piece."""
    vertices, faces, labels, start = [], [], [], 0
    for (v, f), region in zip(pieces, regions, strict=True):
        vertices.append(v)
        faces.append(f + start)
        labels.append(np.full(len(f), region, np.int32))
        start += len(v)
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int64), None, np.concatenate(labels))


def furnished_room(cells: float = 0.25) -> Room:
    """The room of this module: two boxes on the floor, two lamps of different size hanging under the ceiling."""
    pieces = box(np.zeros(3), SIZE, cells)
    regions = list(range(6))
    for region, (low, high) in ((6, ([0.5, 0.4, 0], [1.1, 1.2, 0.7])), (7, ([2.7, 1.9, 0], [3.5, 2.6, 0.4]))):
        pieces += box(low, high, cells)
        regions += [region] * 6
    pieces += [
        quad([0.8, 1.1, 1.8], [0.6, 0, 0], [0, 0.6, 0], cells),
        quad([2.9, 0.8, 1.9], [0.3, 0, 0], [0, 0.4, 0], cells),
    ]
    emission = np.zeros_like(ALBEDO)
    emission[list(LAMP_REGIONS)] = LAMP_RADIANCE
    return Room(assemble(pieces, regions + list(LAMP_REGIONS)), ALBEDO, emission)


def room_origins(room: Room, tracer: Tracer, n: int, rng: np.random.Generator) -> Origins:
    """``n`` random points per face, normals into the room: walls are looked at from inside, boxes from outside."""
    u = rng.random((len(tracer.areas), n, 2))
    u = np.where(u.sum(-1, keepdims=True) > 1, 1 - u, u)
    c = tracer.corners[:, None]
    position = c[:, :, 0] + u[..., :1] * (c[:, :, 1] - c[:, :, 0]) + u[..., 1:] * (c[:, :, 2] - c[:, :, 0])
    normal = tracer.normals.copy()
    for region in range(len(room.albedo)):
        faces = np.flatnonzero(room.regions == region)
        middle = tracer.corners[faces].mean(1)
        away = middle - middle.mean(0) if region in (6, 7) else SIZE / 2 - middle
        normal[faces] *= np.where((away * normal[faces]).sum(1, keepdims=True) < 0, -1, 1)
    normal = np.broadcast_to(normal[:, None], position.shape)
    return Origins(position.astype(np.float32), normal.astype(np.float32))


def irradiance_at(
    room: Room, tracer: Tracer, radiosity: np.ndarray, origins: Origins, n_rays: int, seed: int
) -> np.ndarray:
    """(n, 3) irradiance / pi: lamps by area sampling, everything else by gathering face radiance (F, 3)."""
    rng = np.random.default_rng(seed)
    rays, _ = gather(tracer, origins, n_rays, rng, Progress())
    lamps = room.lamps()
    table = np.concatenate([radiosity, np.zeros((1, 3))])
    indirect = table[rays.face].mean(1)
    direct = emitter_form_factors(tracer, origins, rays, lamps, n_rays, rng, Progress())[..., 0]
    return indirect + direct @ np.array([room.emission[room.regions[faces[0]]] for faces in lamps])


def matte_specular(cosine: np.ndarray) -> np.ndarray:
    """Share of uniform light that the 4 % lobe of roughness 1 sends at angle ``cosine`` (n,) to the normal."""
    f0, f1 = specular_integrals(np.ones_like(cosine, np.float64), np.asarray(cosine, np.float64))
    return DIELECTRIC_F0 * f0 + f1


def radiosity(room: Room, tracer: Tracer, n_rays: int = 256) -> np.ndarray:
    """(F, 3) mean radiance that each face reflects into the room, lamps black."""
    rng = np.random.default_rng(5)
    origins = room_origins(room, tracer, 8, rng)
    rays, _ = gather(tracer, origins, n_rays, rng, Progress())
    lamps = room.lamps()
    direct = emitter_form_factors(tracer, origins, rays, lamps, n_rays, rng, Progress())[..., 0]
    source = direct @ np.array([room.emission[room.regions[faces[0]]] for faces in lamps])
    albedo = np.where(room.albedo > 0, room.albedo + matte_specular(MEAN_COSINES).mean(), 0)[room.regions]
    result = albedo * source
    for _ in range(30):
        result = albedo * (np.concatenate([result, np.zeros((1, 3))])[rays.face].mean(1) + source)
    return result


def cameras(count: int = 8, width: int = 40, height: int = 30) -> list[Camera]:
    """Cameras on an ellipse that look across the room, up and down in turn."""
    poses = []
    for k in range(count):
        angle = 2 * np.pi * k / count
        around = np.array([np.cos(angle), np.sin(angle), 0.0])
        eye = SIZE / 2 + around * [1.5, 1.1, 0] + [0, 0, 0.1]
        target = SIZE / 2 - around * [1.5, 1.1, 0] + [0, 0, (-0.9, 0.5, -0.3, 0.9)[k % 4]]
        poses.append(look_at(eye, target))
    return [
        Camera(width=width, height=height, fx=0.55 * width, fy=0.55 * width, cx=width / 2, cy=height / 2, c2w=pose)
        for pose in poses
    ]


@dataclass(frozen=True)
class Patched:
    """A room as the engine sees it: pixels of its cameras, patches under them and the rays between these."""

    tracer: Tracer
    samples: PixelSamples
    surface: Surface
    transport: Transport


def patched(room: Room, views: list[Camera], max_patches: int, n_rays: int, seed: int = 0) -> Patched:
    """The room in patches seen by ``views``, with ``n_rays`` gather rays from each."""
    tracer, rng = Tracer(room.mesh), np.random.default_rng(seed)
    samples = trace_pixels(tracer, views, Progress())
    surface = build_surface(room.mesh, samples, room.regions, max_patches, rng)
    return Patched(tracer, samples, surface, build_transport(tracer, surface, room.regions, n_rays, rng, Progress()))


def render(room: Room, tracer: Tracer, views: list[Camera], n_rays: int = 192) -> np.ndarray:
    """(V, H, W, 3) radiance at pixel centres of the room in rough plastic: kd Ld and a lobe that sees what Ld sees."""
    samples = trace_pixels(tracer, views, Progress())
    face_radiance = radiosity(room, tracer)
    origins = Origins(samples.position[:, None], samples.normal[:, None])
    irradiance = irradiance_at(room, tracer, face_radiance, origins, n_rays, 11)
    region = room.regions[samples.face]
    image = np.zeros((len(views), views[0].height * views[0].width, 3))
    reflectance = room.albedo[region] + matte_specular(samples.cosine)[:, None]
    lit = ~room.emission[region].any(1, keepdims=True)
    image[samples.view, samples.pixel] = reflectance * irradiance * lit + room.emission[region]
    return image.reshape(len(views), views[0].height, views[0].width, 3)


def photograph(
    room: Room, views: list[Camera], radiance: np.ndarray, exposures: np.ndarray, response: Response, folder: Path
) -> Capture:
    """8-bit photos in ``folder`` and the capture that names them; exposures are told."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for k, (camera, exposure) in enumerate(zip(views, exposures, strict=True)):
        photo = folder / f"{k:03d}.png"
        write_png(photo, np.floor(255 * response.apply(np.clip(radiance[k] * exposure, 0, 1))).astype(np.uint8))
        entries.append(View(f"{k:03d}", camera, photo, float(exposure)))
    return Capture(name="room", root=folder, views=tuple(entries), val_views=(), mesh=room.mesh)


# ---- on disk -------------------------------------------------------------------------------------------------------


def write_capture(capture: Capture) -> Path:
    """Make the folder of :func:`photograph` a nerfstudio capture with an OBJ of one group per region."""
    camera, mesh = capture.views[0].camera, capture.mesh
    assert mesh.regions is not None
    frames = [
        {"file_path": f"{view.name}.png", "transform_matrix": view.camera.c2w.tolist(), "exposure": view.exposure}
        for view in capture.views
    ]
    lens = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
    (capture.root / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    for region in np.unique(mesh.regions):
        lines += [f"g region{region}", *(f"f {a} {b} {c}" for a, b, c in mesh.faces[mesh.regions == region] + 1)]
    (capture.root / "mesh.obj").write_text("\n".join(lines) + "\n")
    return capture.root


VOLATILE = ("seconds", "peak_memory_bytes", "rays_traced")
"""What two runs of the same solve may differ in; a run that read its transport from disk traced fewer rays."""


def same_results(a: Path, b: Path) -> bool:
    reports = [json.loads((folder / "report.json").read_text()) for folder in (a, b)]
    for report in reports:
        for name in VOLATILE:
            report.pop(name, None)
    files = [sorted(path.name for path in (folder / "materials").iterdir()) for folder in (a, b)]
    equal = all((a / "materials" / n).read_bytes() == (b / "materials" / n).read_bytes() for n in files[0])
    lights = (a / "emitters.json").read_text() == (b / "emitters.json").read_text()
    curves = (a / "response.json").read_text() == (b / "response.json").read_text()
    return reports[0] == reports[1] and files[0] == files[1] and equal and lights and curves


def observe_off_edges(
    patch: np.ndarray,
    view: np.ndarray,
    z: np.ndarray,
    rng: np.random.Generator,
    pixel: np.ndarray | None = None,
    width: int = 1,
) -> Observations:
    """Observations of display values ``z`` (n, 3) at row-major pixels of photos of one width, none on an edge."""
    mixed, widths = np.zeros(len(z), bool), np.full(view.max() + 1, width)
    pixel = (np.zeros(len(z)) if pixel is None else pixel).astype(np.int32)
    shown = patch.astype(np.int32), view.astype(np.int16), pixel, widths, z.astype(np.float32)
    return observe(*shown, mixed, False, rng)


def repainted(
    capture: Capture, tracer: Tracer, shade: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], folder: Path
) -> Capture:
    """``capture`` with photos in ``folder`` of the display value (n,) that ``shade`` gives to points (n, 3), seen along
    unit directions (n, 3), of surfaces of normals (n, 3)."""
    views = []
    for view in capture.views:
        origin, direction = view.camera.rays()
        hits = tracer.closest(origin, direction)
        value = shade(origin + direction * hits.distance[:, None], direction, tracer.normals[hits.face])
        path = folder / f"{view.name}.png"
        picture = (255 * np.repeat(value.reshape(view.camera.height, view.camera.width, 1), 3, -1)).astype(np.uint8)
        write_png(path, picture)
        views.append(replace(view, photo=path))
    return replace(capture, views=tuple(views))
