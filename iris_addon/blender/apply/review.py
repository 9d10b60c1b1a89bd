"""Pictures of a result inside Blender: photo, re-render and error, the response curve, the confidence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ..images import image_from_array
from ..scene_out.materials import CONFIDENCE

KINDS = ("photo", "render", "error")
CURVE_SIDE = 256
SPARKS = 16
BLOCKS = "▁▂▃▄▅▆▇█"
CHANNEL_COLORS = ((0.9, 0.25, 0.2), (0.2, 0.7, 0.25), (0.25, 0.45, 0.95))


def reviewed_views(folder: Path) -> list[str]:
    """Names of the photos that the report of the result in ``folder`` compares with their re-renders."""
    return sorted(path.name.removesuffix("-render.png") for path in (folder / "report").glob("*-render.png"))


def review_image(folder: Path, view: str, kind: str) -> bpy.types.Image:
    """The picture ``kind`` ("photo", "render", "error") of a photo; raises BadInput."""
    path = folder / "report" / f"{view}-{kind}.png"
    if not path.is_file():
        raise BadInput("is not there", "solve again, or choose a photo that the report shows", path)
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()  # an earlier result may have had this name
    return image


def curve_image(samples: NDArray[np.floating], name: str = "IRIS Response") -> bpy.types.Image:
    """A plot of the response: display value over radiance times exposure, both 0 to 1, a line per channel (3, n)."""
    old = bpy.data.images.get(name)
    if old is not None:
        bpy.data.images.remove(old)
    image = image_from_array(name, curve_plot(samples), colorspace="sRGB")
    image.pack()  # unpacked images are black after undo
    return image


def curve_plot(samples: NDArray[np.floating]) -> NDArray[np.float32]:
    """(256, 256, 3) picture of curves ``samples`` (3, n); equal curves are drawn as one white line."""
    side = CURVE_SIDE
    picture = np.full((side, side, 3), 0.12, np.float32)
    for k in range(1, 4):
        picture[:, k * side // 4] = picture[k * side // 4] = 0.2
    picture[np.arange(side)[::-1], np.arange(side)] = 0.3  # linear, for comparison
    same = np.ptp(samples, axis=0).max() < 1e-3
    lines = [(samples[0], (1.0, 1.0, 1.0))] if same else list(zip(samples, CHANNEL_COLORS, strict=True))
    x = np.linspace(0, 1, 8 * side)  # dense, so that a steep curve has no gaps
    column = np.minimum((x * side).astype(int), side - 1)
    for curve, color in lines:
        y = np.interp(x, np.linspace(0, 1, len(curve)), curve)
        row = side - 1 - np.clip((y * side).astype(int), 0, side - 1)
        for offset in (0, 1):
            picture[np.minimum(row + offset, side - 1), column] = color
    return picture


def sparkline(histogram: Sequence[float]) -> str:
    """``histogram`` as at most 16 block characters, for labels; heights are square roots because most are small."""
    counts = np.asarray(histogram, float)
    if len(counts) > SPARKS:  # the sidebar abbreviates longer text in its middle
        counts = np.add.reduceat(counts, np.arange(0, len(counts), -(-len(counts) // SPARKS)))
    heights = np.sqrt(counts)
    levels = np.ceil(heights / max(float(heights.max(initial=0.0)), 1e-9) * (len(BLOCKS) - 1)).astype(int)
    return "".join(BLOCKS[level] for level in levels)


def model_lines(report: dict[str, Any]) -> list[tuple[str, str]]:
    """The refinements of the model, as (label, value) for the panel."""
    model = report.get("model")
    lines = []
    for name, value in model.items() if isinstance(model, dict) else ():
        label = str(name).replace("_", " ").capitalize()
        if isinstance(value, dict):
            lines += [(f"{label}: {str(key).replace('_', ' ')}", _short(item)) for key, item in value.items()]
        else:
            lines.append((label, _short(value)))
    return [(label, text) for label, text in lines if text]


def _short(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}"
    return str(value) if isinstance(value, int | str) else ""


def show_confidence(objects: list[bpy.types.Object], on: bool) -> bool:
    """Make the map of what was seen, or base color again, what the solid view shows; False if nothing is applied."""
    found = False
    for material in {slot.material for thing in objects for slot in thing.material_slots if slot.material}:
        nodes = material.node_tree.nodes if material.node_tree else ()
        confidence = next((node for node in nodes if node.name == CONFIDENCE), None)
        if confidence is None:
            continue
        base = next(node for node in nodes if node.bl_idname == "ShaderNodeTexImage" and node.name != CONFIDENCE)
        material.node_tree.nodes.active = confidence if on else base
        found = True
    return found


def shows_confidence() -> bool:
    """Whether the solid view shows the map of what was seen."""
    trees = (material.node_tree for material in bpy.data.materials)
    active = (tree.nodes.active for tree in trees if tree is not None)
    return any(node is not None and node.name == CONFIDENCE for node in active)
