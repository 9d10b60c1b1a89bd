"""Export a farm job: the solve of the current capture and the frames of the scene, as a bundle that farms run."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path

import bpy
import numpy as np

from ..iris_addon.base.errors import BadInput, IrisError
from ..iris_addon.base.files import atomic_write, digest_of, require_own_folder, write_json
from ..iris_addon.blender.apply.applied_states import light_state_of
from ..iris_addon.blender.apply.farm_frames import relit_frames
from ..iris_addon.blender.apply.on_objects import APPLIED
from ..iris_addon.blender.insert.linked_files import write_portable
from ..iris_addon.blender.insert.photo_composite import has_additions
from ..iris_addon.blender.insert.plate import shows_plate
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import farm_command
from .folders import capture_path, folder, metres_per_unit, unit_option
from .import_capture import write_scene
from .polls import NeedsCapture
from .run_job import run
from .ui import steps

MAX_NAME = 30
"""Characters of the name of the job, which steps of the farm repeat."""
KEY_LENGTH = 8
"""Characters of the key in the name of a folder of frames."""


class IRIS_OT_export_farm(NeedsCapture, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Write the solve of this capture, and the frames of the scene's camera with what was placed in the room, as a job
    that render farms run: Open Job Description (Deadline Cloud and others) and Flamenco. Behind the camera a plate is
    the background"""

    bl_idname = "iris.export_farm"
    bl_label = "Export Farm Job"

    directory: bpy.props.StringProperty(subtype="DIR_PATH")
    frames: bpy.props.BoolProperty(
        name="Frames", description="Also render the frames of this scene, where a result is applied", default=True
    )
    samples: bpy.props.IntProperty(name="Samples", description="Paths per pixel", default=64, min=2, soft_max=1024)
    chunk: bpy.props.IntProperty(name="Chunk", description="Frames of one task", default=10, min=1, max=1000)
    gpu: bpy.props.BoolProperty(name="GPU", description="Ask for hosts with a GPU, and render on it")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is a capture, and no export runs."""
        return super().poll(context) and jobs.running("farm", folder(context.scene)) is None

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask for a folder."""
        self.directory = str(folder(context.scene).parent)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the job file and what it names, and let the command line make the bundle of it."""
        if not self.directory:
            self.report({"ERROR"}, "no folder is named — give the folder of the bundle")
            return {"CANCELLED"}
        scene, bundle = context.scene, Path(bpy.path.abspath(self.directory)).absolute()
        name = bpy.path.clean_name(scene.name)[:MAX_NAME]
        job_file = bundle / f"{name}.toml"
        if not write_scene(self, context):
            return {"CANCELLED"}
        try:
            require_own_folder(bundle)
            text = self._job(scene, name)
            if self.frames and APPLIED in scene:
                text += self._frames(scene, bundle, name, text)
            atomic_write(job_file, lambda part: part.write_text(text, encoding="utf-8"))
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return run(self, "farm", folder(scene), farm_command(job_file, bundle))

    def _job(self, scene: bpy.types.Scene, name: str) -> str:
        settings, capture = scene.iris, capture_path(scene)
        job: dict[str, str | int | float | bool | list[str]] = {
            "name": name,
            "capture": str(capture),
            "out": str(folder(scene).absolute()),
            **{"preset": settings.preset, "device": settings.device, "seed": settings.seed},
            "exclude": steps.left_out(scene),
            **steps.texture_options(settings),
            **unit_option(scene),
        }
        return _table("[[job]]", job)

    def _frames(self, scene: bpy.types.Scene, bundle: Path, name: str, job: str) -> str:
        """The table of the frames, whose folder has a key of all that they are made of: those of another export, and
        of the ``job`` with other settings, are not taken for them."""
        if shows_plate(scene):
            own, made_of = self._own_scene(scene, bundle, name)
            table = {"name": "plate", **own, **_light_state_of_plate(scene)}
        elif has_additions(scene):
            own, made_of = self._own_scene(scene, bundle, name)
            table = {"name": "scene", "exposure": "auto", **own}
        else:
            own, made_of = self._relit(scene, bundle, name)
            table = {"name": "frames", **own}
        table |= {"chunk": self.chunk, "samples": self.samples, "gpu": self.gpu}
        out = folder(scene).absolute() / f"{table['name']}-{_key(job, table, made_of)}"
        return _table("[[job.frames]]", {**table, "out": str(out)})

    def _own_scene(
        self, scene: bpy.types.Scene, bundle: Path, name: str
    ) -> tuple[dict[str, str | int | bool], tuple[Path, ...]]:
        """Frames of a copy of the scene, which has all that Blender renders: numbered as Blender does; and the files
        that they are made of."""
        if scene.camera is None:
            raise BadInput("this scene has no camera", "add the camera of the animation")
        copy = write_portable(scene, bundle / f"{name}.blend")
        for warning in copy.warnings:
            self.report({"WARNING"}, warning)
        frames = f"{scene.frame_start}-{scene.frame_end}"
        return {"command": "composite", "scene": f"{name}.blend", "frames": frames}, (copy.blend, *copy.files)

    def _relit(
        self, scene: bpy.types.Scene, bundle: Path, name: str
    ) -> tuple[dict[str, str | int | bool], tuple[Path, ...]]:
        """Frames of the room as the farm solves it, numbered from 1, and the files that they are made of."""
        room = scene.iris.room
        if room is None or scene.iris.source == "SCENE":  # it is its own capture, written in metres
            to_capture = np.diag([*[scene.unit_settings.scale_length] * 3, 1.0])
        else:
            to_capture = np.linalg.inv(np.array(room.matrix_world))
        views, lights, count = relit_frames(scene, to_capture)
        for frame in views["frames"]:  # in the unit of the capture's files, as all views that a job names
            for row in frame["transform_matrix"][:3]:
                row[3] /= metres_per_unit(scene) or 1.0
        made_of = bundle / f"{name}-views.json", bundle / f"{name}-lights.json"
        for path, content in zip(made_of, (views, lights), strict=True):
            write_json(path, content)
        table: dict[str, str | int | bool] = {
            "command": "relight",
            "lights": f"{name}-lights.json",
            "views": f"{name}-views.json",
            "frames": f"1-{count}",
            "fps": max(1, round(scene.render.fps / scene.render.fps_base)),
        }
        return table, made_of


def _light_state_of_plate(scene: bpy.types.Scene) -> dict[str, str]:
    """The light state that the camera of ``scene`` names, in a room that was photographed in several."""
    name = light_state_of(scene.camera, scene)
    return {"light_state": name} if name else {}


def _key(job: str, table: Mapping[str, str | int | bool], made_of: Iterable[Path]) -> str:
    """What tells frames of a table of a ``job`` from others: the settings of both, written files by their content, and
    those that a copied scene links to, which may be films, by size and time."""
    digest = sha256(json.dumps([job, table], sort_keys=True).encode())
    for path in made_of:
        if path.suffix in (".json", ".blend"):
            content = digest_of(path)
        else:
            state = path.stat()
            content = f"{state.st_size} {state.st_mtime_ns}"
        digest.update(f"{path.name} {content}\n".encode())
    return digest.hexdigest()[:KEY_LENGTH]


def _table(head: str, values: Mapping[str, str | int | float | bool | list[str]]) -> str:
    """A table of TOML, whose numbers, words and truth values are written like those of JSON."""
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())
    return f"{head}\n{''.join(lines)}\n"
