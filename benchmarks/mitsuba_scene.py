"""A capture as a Mitsuba 3 scene: one principled surface with texture atlases, an area light per side of a lamp."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.errors import BadInput, SolverEnvironmentMissing
from iris_addon.base.progress import Progress
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture
from iris_addon.evaluate.ground_truth import read_ground_truth
from iris_addon.model.capture import Camera, Capture
from iris_addon.model.response import Response
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from iris_addon.textures.charts import build_atlas
from iris_addon.textures.texel_density import texel_density_from_footprint

from .configurations import true_emitters

VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb")
ATLAS_SIZE = 1024
CLIPPED = 254 / 255
BOUNCES = 6
BASE_COLOR, ROUGHNESS = "room.bsdf.brdf_0.base_color.data", "room.bsdf.brdf_0.roughness.data"
TWO_SIDES = 2e-4
"""Metres between a lamp's front and back: Mitsuba's area lights shine to one side, the lamps of a capture to both."""
SIDES = {"front": 1.0, "back": -1.0}
MIN_SHARE, SIDE_RAYS, CLOSE = 0.01, 4096, 0.05
"""Sides of lamps that cast less than this share into the room are left out; what is closer (metres) does not count."""


@dataclass(frozen=True)
class Problem:
    """What Mitsuba is given.

    Attributes:
        uv: (F, 3, 2) of our atlas, v up.
        lamps: faces of each true lamp.
        lamp_bounds: (E, 3) radiance that a lamp has at least, because its pixels clip in a photo of that exposure.
        photos: (V, H, W, 3) display values; exposures (V,).
    """

    capture: Capture
    tracer: Tracer
    uv: NDArray[np.float32]
    lamps: list[NDArray[np.int64]]
    lamp_bounds: NDArray[np.float64]
    photos: NDArray[np.float32]
    exposures: NDArray[np.float64]
    response: Response

    @staticmethod
    def read(folder: Path) -> Problem:
        """The capture with the truths that this peer is given; raises BadInput where they are not recorded."""
        capture, truth = read_capture(folder), read_ground_truth(folder)
        if truth is None or truth.response is None or not capture.exposures_known:
            raise BadInput("records no response or no exposures", "this peer has to be given them", folder)
        tracer = Tracer(capture.mesh)
        samples = trace_pixels(tracer, [view.camera for view in capture.views], Progress())
        density = texel_density_from_footprint(samples.face, samples.footprint, len(capture.mesh.faces))
        lamps = [np.arange(first, last) for first, last in true_emitters(folder)]
        photos = np.stack([load_photo(view).values for view in capture.views])
        exposures = np.array([view.exposure for view in capture.views], np.float64)
        return Problem(
            capture=capture,
            tracer=tracer,
            uv=build_atlas(capture.mesh, density, ATLAS_SIZE),
            lamps=lamps,
            lamp_bounds=lamp_bounds(lamps, samples, photos, exposures),
            photos=photos,
            exposures=exposures,
            response=truth.response,
        )


def lamp_bounds(
    lamps: Sequence[NDArray[np.int64]],
    samples: PixelSamples,
    photos: NDArray[np.float32],
    exposures: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(E, 3) of each lamp: 1 / exposure of the shortest exposure in which most of its pixels clip."""
    clipped = photos.reshape(len(photos), -1, 3)[samples.view, samples.pixel] >= CLIPPED
    bounds = np.full((len(lamps), 3), 1.0 / exposures.max())
    for k, lamp in enumerate(lamps):
        on_lamp = np.isin(samples.face, lamp)
        for view in np.unique(samples.view[on_lamp]):
            share = clipped[on_lamp & (samples.view == view)].mean(0)
            bounds[k] = np.where(share > 0.5, np.maximum(bounds[k], 1.0 / exposures[view]), bounds[k])
    return bounds


def load_mitsuba() -> Any:
    """The module mitsuba with the fastest variant that runs here; raises SolverEnvironmentMissing."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = sorted(Path("/usr/lib").glob("*/libLLVM*.so.[12][0-9]*"), key=lambda p: p.name)
        if found:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(found[-1])
    try:
        import mitsuba as mi

        mi.set_variant(*VARIANTS)
    except (ImportError, AttributeError) as error:
        raise SolverEnvironmentMissing(
            f"Mitsuba 3 does not run here ({error})", "install mitsuba and libllvm19 as docs/benchmarks.md describes"
        ) from error
    return mi


# ---- the scene -----------------------------------------------------------------------------------------------------


def make_scene(mi: Any, problem: Problem) -> tuple[Any, list[Any]]:
    """Room and lamps as a Mitsuba scene, and a sensor per photo."""
    mesh, faces = problem.capture.mesh, problem.capture.mesh.faces
    room = problem.tracer.areas > 0
    grey = np.full((ATLAS_SIZE, ATLAS_SIZE, 3), 0.5, np.float32)
    surface = {
        "type": "twosided",
        "bsdf": {
            "type": "principled",
            "base_color": {"type": "bitmap", "bitmap": mi.Bitmap(grey), "raw": True, "wrap_mode": "clamp"},
            "roughness": {
                "type": "bitmap",
                "bitmap": mi.Bitmap(grey[..., :1].copy()),
                "raw": True,
                "wrap_mode": "clamp",
            },
        },
    }
    content = {"type": "scene", "integrator": {"type": "prb", "max_depth": BOUNCES, "rr_depth": BOUNCES}}
    room[np.concatenate(problem.lamps)] = False
    for k, lamp in enumerate(problem.lamps):
        for side, sign in SIDES.items():
            share = share_into_room(problem.tracer, lamp, sign, room)
            if share < MIN_SHARE:
                continue
            weight = share * float(problem.tracer.areas[lamp].sum())
            light = {
                "type": "area",
                "radiance": {"type": "rgb", "value": problem.lamp_bounds[k].tolist()},
                "sampling_weight": weight,
            }
            black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
            moved = mesh.vertices[faces[lamp]] + 0.5 * TWO_SIDES * sign * problem.tracer.normals[lamp][:, None]
            turned = moved[:, :: int(sign)]
            content[f"lamp{k}_{side}"] = _mesh(mi, turned, None, mi.load_dict(black), mi.load_dict(light))
    content["room"] = _mesh(mi, mesh.vertices[faces[room]], problem.uv[room], mi.load_dict(surface))
    sensors = [mi.load_dict(_sensor(mi, view.camera)) for view in problem.capture.views]
    return mi.load_dict(content), sensors


def share_into_room(tracer: Tracer, lamp: NDArray[np.int64], sign: float, room: NDArray[np.bool_]) -> float:
    """Share of the cosine-distributed rays from one side of a lamp that reach a surface of the room.

    The inside of a globe and the back of a ceiling lamp light nothing; sampling them would waste most shadow rays.
    """
    rng = np.random.default_rng(0)
    face = rng.choice(lamp, SIDE_RAYS, p=tracer.areas[lamp] / tracer.areas[lamp].sum())
    normal = sign * tracer.normals[face]
    direction = rng.standard_normal((SIDE_RAYS, 3))
    direction = normal + direction / np.linalg.norm(direction, axis=1, keepdims=True) * 0.999
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    hits = tracer.closest(tracer.corners[face].mean(1) + tracer.epsilon * normal, direction)
    return float((room[hits.face] & (hits.face >= 0) & (hits.distance > CLOSE)).mean())


def _mesh(mi: Any, corners: NDArray, uv: NDArray | None, bsdf: Any, emitter: Any = None) -> Any:
    """A mesh of separate triangles (n, 3, 3), so that every corner has a UV of its own."""
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if emitter is not None:
        properties["emitter"] = emitter
    n = len(corners)
    mesh = mi.Mesh("mesh", 3 * n, n, has_vertex_texcoords=uv is not None, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(corners, np.float32).ravel()
    parameters["faces"] = np.arange(3 * n, dtype=np.uint32)
    if uv is not None:
        flipped = np.stack([uv[..., 0], 1 - uv[..., 1]], -1)  # Mitsuba's row 0 is at v = 0
        parameters["vertex_texcoords"] = np.ascontiguousarray(flipped, np.float32).ravel()
    parameters.update()
    return mesh


def _sensor(mi: Any, camera: Camera) -> dict[str, Any]:
    pose = camera.c2w @ np.diag([-1.0, 1.0, -1.0, 1.0])  # x left, y up, z forward
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "fov_axis": "x",
        "principal_point_offset_x": 0.5 - camera.cx / camera.width,
        "principal_point_offset_y": 0.5 - camera.cy / camera.height,
        "near_clip": 1e-3,
        "to_world": mi.ScalarTransform4f(pose),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }
