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

KIND = "iris_kind"
"""Custom property of a picture of :func:`review_image`: which it is."""
CURVE_NAME = "IRIS Response"
CURVE_SIDE = 256
SPARKS = 16
BLOCKS = "▁▂▃▄▅▆▇█"
CHANNEL_COLORS = ((0.9, 0.25, 0.2), (0.2, 0.7, 0.25), (0.25, 0.45, 0.95))


LOBES = {
    "lambert": "Matte surfaces look equally bright from all sides.",
    "layered": "Matte surfaces look duller at grazing angles, as under a coat of varnish.",
    "burley": "Matte surfaces look brighter at grazing angles, as plaster and cloth do.",
}
EXPOSURES = {
    "known": "Exposures are as recorded.",
    "corrected": "Recorded exposures were corrected.",
    "estimated": "Exposures were estimated from the photos.",
}


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
    image[KIND] = kind
    return image


def curve_image(samples: NDArray[np.floating], name: str = CURVE_NAME) -> bpy.types.Image:
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


def model_sentences(report: dict[str, Any]) -> list[str]:
    """What a result is, in words for the panel: its light, its materials, how well it predicts, what was left out.

    Args:
        report: content of report.json; what it lacks, as those of earlier versions do, is passed over.
    """
    model = _part(report, "model")
    found = [_light(model), _materials(model), _diffuse(model), _exposures(model), _quality(report), _photos(report)]
    return [text for text in found if text]


def _light(model: dict[str, Any]) -> str:
    count, unseen, states = _count(model, "lamps"), _count(model, "unseen_lamps"), _part(model, "light_states")
    if count is None:
        return ""
    text = f"{_several(count, 'lamp')} found" if count else "No lamp was found"
    if count and unseen:
        text += ", in no photo" if count == 1 else f", {unseen} of them in no photo"
    if model.get("sun") is True:
        text += ". The sun shines in"
    elif _count(model, "outside_directions") or model.get("light_through_holes") is True:
        text += ". Light comes in from outside"
    else:
        text += ". No light comes in from outside"
    return f"{text}. Photographed in {_several(len(states), 'light state')}." if states else f"{text}."


def _materials(model: dict[str, Any]) -> str:
    regions = _count(model, "regions")
    if not regions:
        return ""
    words = {"glossy_regions": "glossy", "metallic_regions": "metal"}
    kinds = [f"{count} {word}" for name, word in words.items() if (count := _count(model, name))]
    text = (
        f"{_several(regions, 'surface')}: {' and '.join(kinds)}, the others matte"
        if kinds
        else "All surfaces are matte"
    )
    mirrors = _count(model, "mirrors")
    if mirrors:
        text += f". {mirrors} {'is a mirror' if mirrors == 1 else 'are mirrors'}"
    return f"{text}. Panes of glass are seen through." if _count(model, "faces_of_panes") else f"{text}."


def _diffuse(model: dict[str, Any]) -> str:
    return LOBES.get(str(_part(model, "diffuse").get("lobe")), "")


def _exposures(model: dict[str, Any]) -> str:
    return EXPOSURES.get(str(_part(model, "response").get("exposures")), "")


def _quality(report: dict[str, Any]) -> str:
    psnr = report.get("holdout_psnr")
    if not isinstance(psnr, int | float):
        return ""
    of_radiance = _part(_part(report, "model"), "response").get("family") == "identity"
    error = f"{psnr:.1f} dB" if of_radiance else f"{100 * 10 ** (-psnr / 20):.2g} % of white ({psnr:.1f} dB)"
    return f"Typical error on pixels that the solve was not shown: {error}."


def _photos(report: dict[str, Any]) -> str:
    used, excluded = _count(report, "n_views"), report.get("excluded")
    if used is None:
        return ""
    names = ", ".join(str(name) for name in excluded) if isinstance(excluded, list) else ""
    return f"Solved from {_several(used, 'photo')}" + (f"; left out: {names}." if names else ".")


def _part(found: dict[str, Any], key: str) -> dict[str, Any]:
    value = found.get(key)
    return value if isinstance(value, dict) else {}


def _count(found: dict[str, Any], key: str) -> int | None:
    value = found.get(key)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _several(count: int, one: str) -> str:
    return f"{count} {one}" if count == 1 else f"{count} {one}s"


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
