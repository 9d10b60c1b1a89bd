"""The box room with ground truth: a lamp on the ceiling, a metal and a glossy wall; and a result that is the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from iris_addon.base.images import write_exr, write_png
from iris_addon.brdf.ggx import directional_albedo
from iris_addon.capture.reader import read_views
from iris_addon.model.recovered import Emitter, Textures
from iris_addon.model.response import Response, gamma
from iris_addon.rays.tracer import Tracer
from iris_addon.results.folder import SCHEMA_VERSION
from iris_addon.results.result import Result
from tests.box_room import ROOM_MAX, WALL_COLORS, box_mesh, write_fipt_room

LAMP_FACES = np.array([10])  # half of the ceiling
LAMP_RADIANCE = np.array([8.0, 6.0, 4.0])
BASE_COLOR = (WALL_COLORS / 255.0).astype(np.float32)
ROUGHNESS = np.array([1, 1, 1, 0.3, 0.25, 1], np.float32)
METALLIC = np.array([0, 0, 0, 0, 1, 0], np.float32)
SIDE = 8


def true_result(response: Response | None = None) -> Result:
    """The room as it is: wall k has texel k of the atlas to itself."""
    mesh = box_mesh()
    wall = np.arange(12) // 2
    textures = Textures(*(np.zeros((SIDE, SIDE, *shape), np.float32) for shape in ((3,), (), (), ())))
    for k in range(6):
        textures.base_color[0, k], textures.roughness[0, k], textures.metallic[0, k] = (
            BASE_COLOR[k],
            ROUGHNESS[k],
            METALLIC[k],
        )
    center = np.stack([(wall + 0.5) / SIDE, np.full(12, 1 - 0.5 / SIDE)], -1)
    uv = np.repeat(center[:, None], 3, axis=1).astype(np.float32)
    area = float(ROOM_MAX[0] * ROOM_MAX[1] / 2)
    lamp = Emitter(id=0, faces=LAMP_FACES, radiance=LAMP_RADIANCE, area=area, confidence=1.0)
    exposures = {f"{k:03d}_0001": np.full(3, t) for k, t in enumerate([0.25, 0.5, 1, 2, 4, 1.0])}
    return Result(
        mesh=replace(mesh, uv=uv),
        regions=wall.astype(np.int32),
        textures=textures,
        emitters=(lamp,),
        outside=None,
        response=response or gamma(),
        exposures=exposures,
        report={"schema_version": SCHEMA_VERSION},
    )


def write_truth_room(root: Path, side_by_side: bool = False) -> Path:
    """The FIPT capture with maps under gt/, or beside the photos as in FIPT's release."""
    write_fipt_room(root)
    folder = root if side_by_side else root / "gt"
    mesh = box_mesh()
    tracer = Tracer(mesh)
    for index, view in enumerate(read_views(root / "train" / "transforms.json")):
        origins, directions = view.camera.rays()
        face = tracer.closest(origins, directions).face
        wall, lit = face // 2, np.isin(face, LAMP_FACES)
        cosine = np.abs((tracer.normals[face] * directions).sum(-1))
        base, rough, metal = (
            np.where(lit[:, None], 0, BASE_COLOR[wall]),
            np.where(lit, 1, ROUGHNESS[wall]),
            METALLIC[wall],
        )
        maps = {
            "BaseCol": base,
            "DiffCol": base * (1 - metal[:, None]),
            "Roughness": np.repeat(rough[:, None], 3, 1),
            "Metallic": np.repeat(metal[:, None], 3, 1),
            "Emit": lit[:, None] * LAMP_RADIANCE,
            "albedo": directional_albedo(base, rough, metal, cosine),
        }
        for kind, values in maps.items():
            name = f"{index:03d}.exr" if kind == "albedo" else f"{view.name}.exr"
            path = folder / "train" / kind / name
            write_exr(path, values.reshape(view.camera.height, view.camera.width, 3).astype(np.float32))
    (folder / "cam").mkdir(exist_ok=True)
    np.save(folder / "cam" / "crf_gt.npy", gamma().samples)
    return root


def write_references(root: Path, radiance: np.ndarray) -> None:
    """Held-out photos, relighting and insertion references that all show ``radiance`` (H, W, 3)."""
    names = [f"{k:03d}_0001" for k in range(2)]
    mask = np.zeros(radiance.shape[:2], np.uint8)
    mask[10:14, 12:18] = 1
    for name, exposure in zip(names, (0.5, 2.0), strict=True):
        z = gamma().apply(np.clip(radiance * exposure, 0, 1))
        write_png(root / "gt" / "val" / "Image" / f"{name}.png", np.floor(255 * z).astype(np.uint8))
        for kind in ("new_lights", "one_emitter"):
            write_exr(root / "gt" / "relight" / kind / f"{name}.exr", radiance)
    write_exr(root / "gt" / "insert" / "Image" / f"{names[1]}.exr", radiance)
    write_png(root / "gt" / "insert" / "mask" / f"{names[1]}.png", mask)
    (root / "relight").mkdir()
    (root / "insert").mkdir()
    quad = {"corners": [[1, 1, 2], [2, 1, 2], [2, 2, 2], [1, 2, 2]], "normal": [0, 0, -1], "radiance": [9, 9, 9]}
    lights = {
        "new_lights": {"original_emitters": "off", "lights": [quad]},
        "one_emitter": {"kept_faces_of_scene_ply": LAMP_FACES.tolist()},
    }
    (root / "relight" / "lights.json").write_text(json.dumps(lights))
    ball = {"shape": "sphere", "center": [2, 1.5, 1], "radius": 0.2}
    (root / "insert" / "objects.json").write_text(json.dumps({"views": [{"view": 1, "objects": [ball]}]}))
