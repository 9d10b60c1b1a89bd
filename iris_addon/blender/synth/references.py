"""Relighting and insertion references: new lights, the one lamp that stays on, and inserted balls.

They are chosen from the geometry alone: rays from the validation cameras give the visible points, and each candidate is
scored by how many of these it lights without occlusion.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from ...base.files import write_json
from ...base.images import write_exr, write_png
from ...base.progress import Progress
from ...edits.scene_edit import Quad, Sphere
from ...model.capture import Camera
from ...model.response import LUMINANCE
from .lamp_switches import LampSwitches
from .renders import Studio
from .scene import SceneEmitter, SceneGeometry
from .writer import Shot

FloatArray = NDArray[np.floating]

UP = np.array([0.0, 0.0, 1.0])
CEILING_GAP, CEILING_HALF = 0.03, 0.3
"""Distance of the new ceiling light from the ceiling, and half its side, metres."""
STANDING_HEIGHT, STANDING_HALF = 1.1, (0.25, 0.4)
"""Height of the centre of the new standing light, and half its sides, metres."""
CEILING_RADIANCE, STANDING_RADIANCE = (30.0, 25.8, 19.8), (15.0, 21.6, 30.0)
CANDIDATES = 40
VISIBILITY_PENALTY = 3.0
"""Share of lit points that a light may lose per share of the picture that it would cover."""
SPHERE_RADIUS, SPHERE_GAP = 0.11, 0.0003
OFFSET = 1e-3
INSERT_VIEWS = 4


class VisiblePoints:
    """A sample of the points that the validation views show.

    Attributes:
        points, normals: (n, 3) world space, normals towards the viewer.
    """

    def __init__(self, geometry: SceneGeometry, cameras: Sequence[Camera], seed: int, per_view: int = 120) -> None:
        self.random = np.random.default_rng(seed)
        self.cameras = cameras
        self.bvh = BVHTree.FromPolygons(geometry.mesh.vertices.tolist(), geometry.mesh.faces.tolist())
        found = []
        for camera in cameras:
            origins, directions = camera.rays()
            for k in self.random.choice(len(directions), min(per_view, len(directions)), replace=False):
                found.append(self.hit(origins[k], directions[k]))
        found = [hit for hit in found if hit is not None]
        self.points = np.array([hit[0] for hit in found]).reshape(-1, 3)
        self.normals = np.array([hit[1] for hit in found]).reshape(-1, 3)

    def hit(self, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Point and normal (towards the ray's origin) of the closest hit."""
        point, normal, _face, _distance = self.bvh.ray_cast(Vector(origin), Vector(direction))
        if point is None:
            return None
        normal = np.array(normal)
        return np.array(point), -normal if normal @ direction > 0 else normal

    def clearance(self, point: FloatArray) -> float:
        """Distance from ``point`` to the nearest surface."""
        return float(self.bvh.find_nearest(Vector(point))[3])

    def irradiance(self, at: FloatArray, normal: FloatArray | None, area: float) -> FloatArray:
        """(n,) unoccluded form factor cosθ cosθ' A / d² of a small light, per visible point.

        Without a normal it emits to both sides.
        """
        towards = at - self.points
        distance = np.linalg.norm(towards, axis=1)
        towards /= distance[:, None]
        outgoing = -towards @ normal if normal is not None else np.ones(len(towards))
        factor = np.maximum((self.normals * towards).sum(1), 0) * np.maximum(outgoing, 0) * area / distance**2
        for k in np.flatnonzero(factor > 0):
            start = self.points[k] + OFFSET * self.normals[k]
            if self.bvh.ray_cast(Vector(start), Vector(towards[k]), distance[k] - 20 * OFFSET)[0] is not None:
                factor[k] = 0
        return factor


# ---- lights ---------------------------------------------------------------------------------------------------------


def choose_lights(seen: VisiblePoints) -> list[tuple[str, Quad, float]]:
    """(kind, light, share of visible points it lights): one quad under the ceiling, one standing panel."""
    floor = seen.points[seen.normals @ UP > 0.9]
    best: dict[str, tuple[float, Quad, float]] = {}
    for point in floor[seen.random.permutation(len(floor))[:CANDIDATES]]:
        for kind, quad in (("ceiling", _ceiling_quad(seen, point)), ("standing", _standing_quad(seen, point))):
            if quad is None:
                continue
            lit = float((seen.irradiance(quad.corners.mean(0), quad.normal, 1.0) > 0).mean())
            score = lit - VISIBILITY_PENALTY * max(_covered(camera, quad) for camera in seen.cameras)
            if kind not in best or score > best[kind][0]:
                best[kind] = (score, quad, lit)
    return [(kind, quad, lit) for kind, (_score, quad, lit) in best.items()]


def _covered(camera: Camera, quad: Quad) -> float:
    """Share of the picture that ``quad`` covers if nothing occludes it, on a coarse grid of rays."""
    corner, across, along = quad.corners[0], quad.corners[1] - quad.corners[0], quad.corners[3] - quad.corners[0]
    origins, directions = (rays[::41] for rays in camera.rays())
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((corner - origins) @ quad.normal) / (directions @ quad.normal)
    local = origins + distance[:, None] * directions - corner
    u, v = local @ across / (across @ across), local @ along / (along @ along)
    return float(((distance > 0) & (u > 0) & (u < 1) & (v > 0) & (v < 1)).mean())


def _ceiling_quad(seen: VisiblePoints, floor: FloatArray) -> Quad | None:
    above = seen.hit(floor + 0.3 * UP, UP)
    if above is None or above[1] @ UP > -0.95:
        return None
    z = above[0][2] - CEILING_GAP
    offsets = CEILING_HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = np.column_stack([floor[:2] + offsets, np.full(4, z)])
    for corner in corners:  # the quad must not intersect anything
        below = seen.hit(corner - 0.4 * UP, UP)
        if below is None or abs(below[0][2] - above[0][2]) > 0.01:
            return None
    return Quad(corners, -UP, np.array(CEILING_RADIANCE))


def _standing_quad(seen: VisiblePoints, floor: FloatArray) -> Quad | None:
    centre = floor + STANDING_HEIGHT * UP
    normal = (seen.points.mean(0) - centre) * (1, 1, 0)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    side = np.cross(UP, normal)
    if seen.clearance(centre) < max(STANDING_HALF) + 0.05:
        return None
    if min(np.linalg.norm(camera.position - centre) for camera in seen.cameras) < 1.0:
        return None
    half_width, half_height = STANDING_HALF
    corners = np.array(
        [centre + a * half_width * side + b * half_height * UP for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )
    return Quad(corners, normal, np.array(STANDING_RADIANCE))


def choose_kept_emitter(seen: VisiblePoints, geometry: SceneGeometry, samples: int = 12) -> tuple[int, float]:
    """The emitter that sends most light to the visible points, and its share of that light."""
    area, light = geometry.areas(), []
    triangles = geometry.mesh.vertices[geometry.mesh.faces]
    for emitter in geometry.emitters:
        faces = np.arange(emitter.first, emitter.last)
        total, received = area[faces].sum(), 0.0
        for face in seen.random.choice(faces, samples, p=area[faces] / total):
            u, v = seen.random.random(2)
            u, v = (1 - u, 1 - v) if u + v > 1 else (u, v)
            a, b, c = triangles[face]
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            at = a + u * (b - a) + v * (c - a)
            # An emitter emits from both sides; the side that faces the point counts.
            for side in (normal, -normal):
                received += seen.irradiance(at, side, total / samples).sum()
        light.append(received * float(emitter.radiance @ LUMINANCE))
    best = int(np.argmax(light))
    return best, light[best] / max(sum(light), 1e-12)


# ---- balls ----------------------------------------------------------------------------------------------------------


def choose_spheres(seen: VisiblePoints, camera: Camera, radius: float = SPHERE_RADIUS) -> tuple[Sphere, ...]:
    """Two balls on surfaces that ``camera`` sees, a grey one and a mirror; fewer where there is no space."""
    origins, directions = camera.rays()
    centres: list[FloatArray] = []
    for k in seen.random.permutation(len(directions))[:3000]:
        hit = seen.hit(origins[k], directions[k])
        if hit is None or hit[1] @ UP < 0.98:
            continue
        centre = hit[0] + hit[1] * (radius + SPHERE_GAP)
        if _fits(seen, camera, centre, radius) and all(
            np.linalg.norm(centre - other) > 4 * radius for other in centres
        ):
            centres.append(centre)
        if len(centres) == 2:
            break
    looks = ((np.full(3, 0.5), 1.0, 0.0), (np.full(3, 0.9), 0.1, 1.0))
    return tuple(Sphere(c, radius, *look) for c, look in zip(centres, looks, strict=False))


def _fits(seen: VisiblePoints, camera: Camera, centre: FloatArray, radius: float) -> bool:
    """Whether a ball touches nothing but its support and is completely visible, neither tiny nor filling the view."""
    local = camera.local(centre)
    if -local[2] < 2 * radius:
        return False
    pixels = camera.fx * radius / -local[2]
    i, j = camera.project(local)
    inside = 1.5 * pixels < i < camera.width - 1.5 * pixels and 1.5 * pixels < j < camera.height - 1.5 * pixels
    if not inside or not camera.width / 40 < pixels < camera.width / 8:
        return False
    if seen.clearance(centre) < radius:
        return False
    right, up = camera.c2w[:3, 0], camera.c2w[:3, 1]
    for offset in (0 * right, right, -right, up):
        towards = centre + 0.9 * radius * offset - camera.position
        distance = float(np.linalg.norm(towards))
        if seen.bvh.ray_cast(Vector(camera.position), Vector(towards), distance - radius)[0] is not None:
            return False
    return True


# ---- writing --------------------------------------------------------------------------------------------------------


def write_references(
    root: Path,
    studio: Studio,
    geometry: SceneGeometry,
    train: Sequence[Shot],
    val: Sequence[Shot],
    switches: LampSwitches,
    *,
    lossy: bool,
    progress: Progress,
) -> None:
    """Write relighting and insertion jobs of the capture ``root``, and renders of its validation views under them.

    Where photos have several light states, balls are inserted in that of their view, and the lamp that is kept names
    one of the ``train`` photos in which it is on; new lights replace all others.
    """
    cameras = [shot.camera for shot in val]
    seen = VisiblePoints(geometry, cameras, studio.settings.seed)
    lights = choose_lights(seen)
    balls = {k: choose_spheres(seen, camera) for k, camera in enumerate(cameras)}
    balls = {k: spheres for k, spheres in balls.items() if spheres}
    balls = dict(list(balls.items())[:INSERT_VIEWS])
    references: dict[str, tuple[SceneEmitter | None, list[Quad]]] = {
        "new_lights": (None, [quad for _kind, quad, _lit in lights])
    }
    jobs = {"new_lights": _new_lights(lights)}
    if geometry.emitters:
        kept, share = choose_kept_emitter(seen, geometry)
        emitter = geometry.emitters[kept]
        facts = {"emitter": kept, "radiance": emitter.radiance.tolist(), "share_of_val_light": share}
        write_json(root / "gt" / "relight" / "one_emitter.json", facts)
        references["one_emitter"] = (emitter, [])
        on = next((shot.light_state for shot in train if switches.shines_in(emitter, shot.light_state)), "")
        jobs["one_emitter"] = _one_emitter(list(range(emitter.first, emitter.last)), on)
    write_json(root / "relight" / "lights.json", jobs)
    write_json(root / "insert" / "objects.json", _describe_spheres(balls, [shot.light_state for shot in val]))

    total, done = len(references) * len(cameras) + len(balls), 0

    def render(path: Path, camera: Camera) -> None:
        nonlocal done
        write_exr(path, studio.radiance(camera), half=True, lossy=lossy)
        done += 1
        progress.update(done / total)

    for name, (on, added) in references.items():
        with studio.only_lit_by(on, geometry.emitters, added):
            for k, camera in enumerate(cameras):
                render(root / "gt" / "relight" / name / f"{k:03d}_0001.exr", camera)
    for k, spheres in balls.items():
        with switches.in_state(val[k].light_state), studio.with_spheres(spheres):
            mask = studio.maps(cameras[k]).object_index
            write_png(root / "gt" / "insert" / "mask" / f"{k:03d}_0001.png", mask.astype(np.uint8))
            render(root / "gt" / "insert" / "Image" / f"{k:03d}_0001.exr", cameras[k])


def _new_lights(lights: Sequence[tuple[str, Quad, float]]) -> dict[str, Any]:
    return {
        "poses": "val/transforms.json",
        "original_emitters": "off, their surfaces stay as black (base colour 0, roughness 1)",
        "lights": [
            {
                "kind": kind,
                "corners": quad.corners.tolist(),
                "normal": quad.normal.tolist(),
                "radiance": quad.radiance.tolist(),
                "val_points_lit": lit,
                "id": k,
                "one_sided": "emits on the side of `normal`; surface base colour 0",
            }
            for k, (kind, quad, lit) in enumerate(lights)
        ],
    }


def _one_emitter(kept_faces: list[int], light_state: str) -> dict[str, Any]:
    return {
        **({"light_state": light_state} if light_state else {}),
        "poses": "val/transforms.json",
        "kept_faces_of_scene_ply": kept_faces,
        "what": "the faces listed keep their original (to be estimated) radiance; every other light is off",
    }


def _describe_spheres(balls: dict[int, tuple[Sphere, ...]], states: Sequence[str]) -> dict[str, Any]:
    views = [
        {
            "view": k,
            **({"light_state": states[k]} if states[k] else {}),
            "objects": [
                {
                    "id": n + 1,
                    "shape": "sphere",
                    "center": sphere.center.tolist(),
                    "radius": sphere.radius,
                    "base_color": sphere.base_color.tolist(),
                    "roughness": sphere.roughness,
                    "metallic": sphere.metallic,
                    "specular": sphere.specular,
                }
                for n, sphere in enumerate(spheres)
            ],
        }
        for k, spheres in balls.items()
    ]
    return {"poses": "val/transforms.json (index `view`)", "lighting": "original", "views": views}
