"""Captures made worse on purpose: each axis of the stability sweeps, applied to the files of a capture by code.

:func:`perturb` copies a capture and changes the copy. The first level of every axis is the capture as it is, byte for
byte; the other levels are the same for the same seed. What the solver gets and what it is scored against are two
folders: a wrong pose must not move the ground truth, and another response moves it.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iris_addon.errors import BadInput

from . import perturb_cameras, perturb_geometry, perturb_masks, perturb_photos, perturb_scene

Apply = Callable[[Path, Path, float, np.random.Generator], str]
"""(capture to change, truth to score against, level, generator) -> a note on what was done."""


@dataclass(frozen=True)
class Axis:
    """One way to make a capture worse.

    Attributes:
        title, unit: of the chart's horizontal axis.
        levels: how hard, from the capture as it is.
        truth_moves: whether the ground truth changes with the capture (mesh, response).
        masks_only: touches nothing but the lamp mask that some configurations are given.
    """

    name: str
    title: str
    unit: str
    levels: tuple[float, ...]
    apply: Apply
    truth_moves: bool = False
    masks_only: bool = False

    def label(self, level: int) -> str:
        """The level's value as the chart writes it."""
        value = self.levels[level]
        return "unknown" if value == np.inf else "all" if value == -1 else f"{value:g}"


@dataclass(frozen=True)
class Perturbed:
    """Folders of a perturbed capture, and what was done in a sentence."""

    capture: Path
    truth: Path
    note: str


_p, _c, _g, _m, _s = perturb_photos, perturb_cameras, perturb_geometry, perturb_masks, perturb_scene
AXES: Mapping[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("exposure", "all exposures raised", "stops", (0, 1, 2, 3, 4), _p.raise_exposure),
        Axis(
            "white_balance",
            "white balance drift per photo",
            "stops rms",
            (0, 0.1, 0.2, 0.4, 0.8),
            _p.drift_white_balance,
        ),
        Axis("tone_mapping", "local tone mapping", "strength", (0, 0.15, 0.3, 0.5, 0.7), _p.map_tones),
        Axis("vignetting", "vignetting", "stops in the corners", (0, 0.25, 0.5, 1, 2), _p.darken_corners),
        Axis("response", "response away from the prior", "standard deviations", (0, 1, 2, 3, 4), _p.odd_response, True),
        Axis(
            "measured_response",
            "measured response (DoRF), by distance from their mean",
            "percentile",
            (0, 25, 50, 75, 100),
            _p.measured_response,
            True,
        ),
        Axis(
            "exposure_noise",
            "error of the recorded exposures",
            "stops rms",
            (0, 0.125, 0.25, 0.5, 1, np.inf),
            _c.misreport_exposures,
        ),
        Axis("pose", "error of the poses", "cm and half degrees", (0, 0.25, 0.5, 1, 2), _c.shake_poses),
        Axis("photos", "photos", "number", (-1, 16, 12, 8, 4), _c.keep_photos),
        Axis("hidden_lamps", "photos of lamps left out", "share", (0, 0.25, 0.5, 0.75, 1), _c.drop_lamp_photos),
        Axis("mesh_noise", "noise of the mesh", "mm", (0, 2, 5, 10, 20), _g.shake_mesh, True),
        Axis("holes", "rays that escape through holes", "share", (0, 0.15, 0.3, 0.45, 0.6), _g.cut_holes, True),
        Axis("decimation", "mesh simplified to cells of", "cm", (0, 2, 5, 10, 20), _g.cluster_vertices, True),
        Axis("density", "longest edge of the mesh", "cm", (-1, 20, 10, 5, 3), _g.subdivide, True),
        Axis("parts", "parts merged", "share", (0, 0.25, 0.5, 0.75, 1), _g.merge_parts, True),
        Axis("gloss", "glossier room", "times the roughness", (1, 0.7, 0.4, 0.2, 0.1), _s.glossier, True),
        Axis("dark_walls", "darker walls", "times their albedo", (1, 0.5, 0.2, 0.1, 0.05), _s.darker_walls, True),
        Axis("lamp_colour", "coloured lamps", "power of their colour", (1, 1.5, 2, 2.5, 3), _s.coloured_lamps, True),
        Axis("dominant_lamp", "one lamp dominates", "stops", (0, 1, 2, 3, 4), _s.dominant_lamp, True),
        Axis(
            "mask_eroded",
            "given mask: faces missing at its border",
            "share",
            (0, 0.2, 0.4, 0.6, 0.8),
            _m.erode,
            masks_only=True,
        ),
        Axis(
            "mask_dilated",
            "given mask: area added around it",
            "times its area",
            (0, 0.25, 0.5, 1, 2),
            _m.dilate,
            masks_only=True,
        ),
        Axis("mask_false", "given mask: false lamps", "number", (0, 1, 2, 4, 8), _m.add_false, masks_only=True),
        Axis("mask_missed", "given mask: lamps missed", "share", (0, 0.25, 0.5, 0.75, 1), _m.miss, masks_only=True),
    )
}


def perturb(source: Path, axis: str, level: int, seed: int, out: Path) -> Perturbed:
    """Copy the capture ``source`` under ``out`` and make it as hard as ``level`` of ``axis`` says.

    Args:
        axis: name in :data:`AXES`, or "" for the capture as it is.
        level: index into the axis's levels; 0 copies nothing and names ``source`` itself.

    Raises:
        BadInput: the axis does not apply to this capture.
    """
    if not axis or level == 0:
        return Perturbed(source, source, "as captured")
    chosen = AXES[axis]
    capture = _p.copy_capture(source, out)
    truth = capture if chosen.truth_moves else source
    # The same generator for all levels of a seed: a harder level is the same accident, only worse.
    rng = np.random.default_rng([seed, zlib.crc32(axis.encode())])
    return Perturbed(capture, truth, chosen.apply(capture, truth, chosen.levels[level], rng))


def axis_applies(axis: str, source: Path) -> str | None:
    """Why ``axis`` cannot be applied to the capture, or None if it can."""
    try:
        if axis == "measured_response":
            perturb_photos.measured_curves()
        if axis in perturb_scene.CHANGES:
            perturb_scene.check_is_bundled(source)
        if axis in ("holes", "decimation", "hidden_lamps") or AXES[axis].masks_only:
            perturb_masks.true_lamp_faces(source)
    except BadInput as error:
        return str(error)
    return None
