"""Files of a synthetic capture: poses, photos, ground truth, metadata."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base import images as imaging
from ...base.files import atomic_write, write_arrays, write_json
from ...brdf.ggx import DIELECTRIC_F0
from ...model.capture import Camera
from ...model.render_settings import RenderSettings
from ...model.response import Response
from ..version import can_denoise
from . import photos
from .renders import Maps
from .scene import SceneGeometry, surface_shader

FloatArray = NDArray[np.floating]

# FIPT's camera columns are x left, y up, z forward.
TO_FIPT = np.diag([-1.0, 1.0, -1.0, 1.0])
COMPACT_LEAVES_OUT = ("Image_const", "gt/train: Image, BaseCol, Depth, Normal", "gt/val: all but Image")


@dataclass(frozen=True)
class Shot:
    """A camera object of the scene, its pinhole camera, and the light state of its photo, "" where it names none."""

    thing: bpy.types.Object
    camera: Camera
    light_state: str = ""


def write_npy(path: Path, array: NDArray) -> None:
    """Write an array as .npy."""
    atomic_write(path, lambda temporary: np.save(temporary, array, allow_pickle=False))


@dataclass(frozen=True)
class CaptureWriter:
    """Files of the capture under ``root``."""

    root: Path
    compact: bool
    response: Response

    def split(self, split: str, shots: list[Shot], radiance: list[FloatArray], maps: list[Maps]) -> None:
        """Poses, radiance and maps of one split."""
        camera = shots[0].camera if shots else None
        if camera is None:
            return
        frames = [
            {
                "file_path": f"Image/{k:03d}_0001",
                "transform_matrix": (shot.camera.c2w @ TO_FIPT).tolist(),
                **({"light_state": shot.light_state} if shot.light_state else {}),
            }
            for k, shot in enumerate(shots)
        ]
        angle = 2 * float(np.arctan(camera.width / 2 / camera.fx))
        content = {"camera_angle_x": angle, "w": camera.width, "h": camera.height, "frames": frames}
        write_json(self.root / split / "transforms.json", content)
        for k, (image, m) in enumerate(zip(radiance, maps, strict=True)):
            folder = self.root / "gt" / split
            if split == "val" or not self.compact:
                self._exr(folder / "Image" / f"{k:03d}_0001.exr", image, lossy=True)
            if split == "train" or not self.compact:
                self._maps(folder, k, m)

    def _maps(self, folder: Path, k: int, m: Maps) -> None:
        stored = {
            "DiffCol": (m.diffuse_albedo, True),
            "Roughness": (m.roughness, False),
            "Metallic": (m.metallic, False),
            "Emit": (m.emission, False),
            "IndexMA": (m.material, False),
        }
        if not self.compact:
            stored |= {"BaseCol": (m.base_color, False), "Depth": (m.depth, False), "Normal": (m.normal, False)}
        for name, (values, lossy) in stored.items():
            self._exr(folder / name / f"{k:03d}_0001.exr", values, lossy=lossy)
        self._exr(folder / "albedo" / f"{k:03d}.exr", m.albedo, lossy=True)  # FIPT names these without the frame

    def _exr(self, path: Path, values: FloatArray, *, lossy: bool) -> None:
        if values.ndim == 2 and not self.compact:  # FIPT has three equal channels
            values = np.repeat(values[..., None], 3, axis=2)
        imaging.write_exr(path, values, half=True, lossy=lossy and self.compact)

    def photos(self, radiance: list[FloatArray], maps: list[Maps], n_train: int, levels: Sequence[float]) -> float:
        """Photos and exposures of both splits; returns the global exposure scale."""
        bright = [photos.brightness(image, m.emission) for image, m in zip(radiance, maps, strict=True)]
        train, val, scale = photos.exposures(bright[:n_train], bright[n_train:], levels)
        kinds = {"Image": ("exposure", train, val)}
        if not self.compact:
            kinds["Image_const"] = ("exposure_const", np.full(len(train), scale), np.full(len(val), scale))
        for folder, (name, of_train, of_val) in kinds.items():
            write_npy(self.root / "cam" / f"{name}.npy", of_train)
            write_npy(self.root / "cam" / f"{name}_val.npy", of_val)
            for k, exposure in enumerate([*of_train, *of_val]):
                # Photos are developed from the half floats that the ground truth stores.
                photo = photos.develop(radiance[k].astype(np.float16).astype(np.float64), exposure, self.response)
                base, number = (self.root / "train", k) if k < n_train else (self.root / "gt" / "val", k - n_train)
                imaging.write_png(base / folder / f"{number:03d}_0001.png", photo)
        write_npy(self.root / "gt" / "cam" / "crf_gt.npy", self.response.samples)
        return scale

    def scene(self, geometry: SceneGeometry) -> None:
        """Materials and emitters, of the scene and per face."""
        write_json(self.root / "gt" / "materials.json", [_describe(k + 1, m) for k, m in enumerate(geometry.materials)])
        areas, triangles = geometry.areas(), geometry.mesh.vertices[geometry.mesh.faces]
        emitters = []
        for k, emitter in enumerate(geometry.emitters):
            own = slice(emitter.first, emitter.last)
            centre = np.average(triangles[own].mean(1), axis=0, weights=areas[own])
            emitters.append(
                {
                    "emitter": k,
                    "name": emitter.name,
                    "radiance": emitter.radiance.tolist(),
                    "faces": [emitter.first, emitter.last],
                    "area": float(areas[own].sum()),
                    "center": centre.tolist(),
                }
            )
        write_json(self.root / "gt" / "emitters.json", emitters)
        per_face = {"material": geometry.material, "emitter": geometry.emitter}
        write_arrays(self.root / "gt" / "faces.npz", per_face, compressed=True)

    def meta(
        self,
        name: str,
        train: list[Shot],
        val: list[Shot],
        scene: bpy.types.Scene,
        scale: float,
        settings: RenderSettings,
    ) -> None:
        """meta.json for whoever reads the capture, gt/meta_gt.json for whoever scores."""
        camera = train[0].camera
        left_out = [*COMPACT_LEAVES_OUT] if self.compact else []
        content = {
            "name": name,
            "resolution": [camera.width, camera.height],
            "fov_x_degrees": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "up_axis": "+z",
            "units_per_metre": 1.0 / scene.unit_settings.scale_length,
            "camera": "c2w columns x=left, y=up, z=forward (FIPT/Mitsuba); d = R [-(i+.5-W/2)/f, -(j+.5-H/2)/f, 1]",
            "ldr": "PNG = floor(255*CRF(clip(radiance*exposure,0,1))), one CRF for R, G and B; exposure in cam/",
            "mesh": "scene.ply: world space, one mesh, no materials or normals; includes the light surfaces",
            "train": len(train),
            "val": len(val),
            "left_out": left_out,
        }
        write_json(self.root / "meta.json", content)
        response = {"family": self.response.family, "coefficients": list(self.response.coefficients)}
        others = [thing.name for thing in scene.objects if thing.type == "LIGHT" and not thing.hide_render]
        facts = {
            "renderer": f"Cycles, Blender {bpy.app.version_string}",
            "response": response,
            "global_scale": scale,
            "samples": settings.samples,
            "denoised": can_denoise(),
            "seed": settings.seed,
            "dielectric_f0": DIELECTRIC_F0,
            "maps": "one sample at the pixel centre; albedo by the formula of EVALUATION, emitters 0",
            "lights_without_mesh": others,
            "suns": [_sun(thing) for thing in scene.objects if thing.name in others and thing.data.type == "SUN"],
        }
        write_json(self.root / "gt" / "meta_gt.json", facts)


def _sun(thing: bpy.types.Object) -> dict[str, Any]:
    """Unit vector towards a sun, and its irradiance on a surface that faces it."""
    toward = np.array(thing.matrix_world)[:3, 2]
    irradiance = np.array(thing.data.color) * thing.data.energy
    return {"direction": (toward / np.linalg.norm(toward)).tolist(), "irradiance": irradiance.tolist()}


def _describe(index: int, material: bpy.types.Material) -> dict[str, Any]:
    """The entry of a material in materials.json; values that vary over the surface are None."""
    shader = surface_shader(material)

    def constant(name: str) -> Any:
        socket = shader.inputs.get(name) if shader is not None else None
        if socket is None or socket.is_linked:
            return None
        return list(socket.default_value[:3]) if socket.type == "RGBA" else socket.default_value

    textures = [n.image.name for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage" and n.image]
    return {
        "index": index,
        "name": material.name,
        "source": shader.bl_idname if shader is not None else None,
        "roughness": constant("Roughness"),
        "metallic": constant("Metallic"),
        "base_color": constant("Base Color"),
        "texture": textures[0] if textures else None,
    }
