"""Perturbations of the bundled room itself: glossier, darker, in other light. Rendered anew, once per level.

Renders are kept in ``out/benchmark_scenes``, because all seeds and configurations share them.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.capture.fipt import read_fipt_views

from .halved_capture import KEPT
from .machine import ROOT
from .runs import SWEPT_VIEWS

SAMPLES = 16
WALLS = ("plaster", "sage paint", "ceiling paint")
DOMINANT = "ceiling lamp"
BUNDLED = ROOT / "assets" / "demo_room"


def glossier(root: Path, _truth: Path, factor: float, _rng: np.random.Generator) -> str:
    """Roughness of everything that does not emit, times ``factor``."""
    return _swap(root, "gloss", factor)


def darker_walls(root: Path, _truth: Path, factor: float, _rng: np.random.Generator) -> str:
    """Albedo of walls and ceiling, times ``factor``."""
    return _swap(root, "dark_walls", factor)


def coloured_lamps(root: Path, _truth: Path, power: float, _rng: np.random.Generator) -> str:
    """The colour of every lamp to a power, at its old mean over the channels."""
    return _swap(root, "lamp_colour", power)


def dominant_lamp(root: Path, _truth: Path, stops: float, _rng: np.random.Generator) -> str:
    """The ceiling lamp brighter by ``stops``."""
    return _swap(root, "dominant_lamp", stops)


def _swap(root: Path, change: str, level: float) -> str:
    """Put the capture of the changed room in the place of ``root``."""
    kept = rendered(change, level, root)
    shutil.rmtree(root)
    shutil.copytree(kept, root)
    return "the room rendered anew"


def rendered(change: str, level: float, like: Path) -> Path:
    """The capture of the changed room with photos of the size of those in ``like``, rendered if it was not before.

    Call it once before several runs need it at the same time.

    Raises:
        IrisError: Blender failed.
    """
    camera = read_fipt_views(like, "train")[0].camera
    kept = KEPT / f"{change}-{level:g}-{camera.width}x{camera.height}"
    if not (kept / "train").is_dir():
        # In a process of its own: Blender's state must not leak into the solve that is measured.
        command = [sys.executable, "-m", "benchmarks.perturb_scene", change, str(level), str(kept)]
        command += [str(camera.width), str(camera.height)]
        process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if process.returncode:
            lines = process.stderr.strip().splitlines() or ["no message"]
            raise IrisError(f"the changed room was not rendered: {lines[-1]}", "run make stability again", kept)
    return kept


def render(change: str, level: float, out: Path, resolution: tuple[int, int]) -> None:
    """Build the room, change it, and render its capture into ``out``, photos of ``resolution``; needs bpy."""
    sys.path.insert(0, str(ROOT / "assets"))
    import bpy
    from make_demo_room import build_room

    from iris_addon.blender.synth.run import TRUTH_RENDER, SynthConfig, synth

    with tempfile.TemporaryDirectory() as folder:
        blend = Path(folder) / "room.blend"
        build_room(blend)
        for material in bpy.data.materials:
            if material.node_tree is not None and "Principled BSDF" in material.node_tree.nodes:
                CHANGES[change](material.name, material.node_tree.nodes["Principled BSDF"].inputs, level)
        names = sorted(thing.name for thing in bpy.data.objects if thing.type == "CAMERA")
        held_out = [name for name in names if name.startswith("val")]
        bpy.ops.wm.save_as_mainfile(filepath=str(blend), compress=True)
        # References cost as much as photos: those of views that no sweep relights are left out.
        cameras = [name for name in names if name not in held_out[SWEPT_VIEWS:]]
        render = replace(TRUTH_RENDER, samples=SAMPLES)
        synth(blend, out, SynthConfig(cameras, resolution, compact=True, render=render))


# ---- changes: name of the material, inputs of its shader, level ----------------------------------------------------


def _change_gloss(_name: str, inputs: object, factor: float) -> None:
    if inputs["Emission Strength"].default_value == 0:  # type: ignore[index]
        inputs["Roughness"].default_value *= factor  # type: ignore[index]


def _change_walls(name: str, inputs: object, factor: float) -> None:
    if name in WALLS:
        color = np.array(inputs["Base Color"].default_value)  # type: ignore[index]
        inputs["Base Color"].default_value = (*(color[:3] * factor), 1.0)  # type: ignore[index]


def _change_colour(_name: str, inputs: object, power: float) -> None:
    color = np.array(inputs["Emission Color"].default_value)[:3]  # type: ignore[index]
    saturated = color**power
    inputs["Emission Color"].default_value = (*(saturated * color.mean() / saturated.mean()), 1.0)  # type: ignore[index]


def _change_dominant(name: str, inputs: object, stops: float) -> None:
    if name == DOMINANT:
        inputs["Emission Strength"].default_value *= 2.0**stops  # type: ignore[index]


CHANGES: dict[str, Callable[[str, object, float], None]] = {
    "gloss": _change_gloss,
    "dark_walls": _change_walls,
    "lamp_colour": _change_colour,
    "dominant_lamp": _change_dominant,
}


def check_is_bundled(capture: Path) -> None:
    """Raise BadInput for any capture but the bundled one and its half, the only one that can be built anew."""
    if capture.resolve() not in (BUNDLED, KEPT / f"{BUNDLED.name}-half"):
        raise BadInput("only the bundled room can be rendered anew", "leave this axis out", capture)


if __name__ == "__main__":
    render(sys.argv[1], float(sys.argv[2]), Path(sys.argv[3]), (int(sys.argv[4]), int(sys.argv[5])))
