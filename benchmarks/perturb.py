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

from iris_addon.base.errors import BadInput

from . import perturb_cameras, perturb_geometry, perturb_masks, perturb_photos, perturb_scan, perturb_scene

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
        Axis(
            name="exposure", title="all exposures raised", unit="stops", levels=(0, 1, 2, 3, 4), apply=_p.raise_exposure
        ),
        Axis(
            name="white_balance",
            title="white balance drift per photo",
            unit="stops rms",
            levels=(0, 0.1, 0.2, 0.4, 0.8),
            apply=_p.drift_white_balance,
        ),
        Axis(
            name="tone_mapping",
            title="local tone mapping",
            unit="strength",
            levels=(0, 0.15, 0.3, 0.5, 0.7),
            apply=_p.map_tones,
        ),
        Axis(
            name="vignetting",
            title="vignetting",
            unit="stops in the corners",
            levels=(0, 0.25, 0.5, 1, 2),
            apply=_p.darken_corners,
        ),
        Axis(
            name="response",
            title="response away from the prior",
            unit="standard deviations",
            levels=(0, 1, 2, 3, 4),
            apply=_p.odd_response,
            truth_moves=True,
        ),
        Axis(
            name="measured_response",
            title="measured response (DoRF), by distance from their mean",
            unit="percentile",
            levels=(0, 25, 50, 75, 100),
            apply=_p.measured_response,
            truth_moves=True,
        ),
        Axis(
            name="exposure_noise",
            title="error of the recorded exposures",
            unit="stops rms",
            levels=(0, 0.125, 0.25, 0.5, 1, np.inf),
            apply=_c.misreport_exposures,
        ),
        Axis(
            name="pose",
            title="error of the poses",
            unit="cm and half degrees",
            levels=(0, 0.25, 0.5, 1, 2),
            apply=_c.shake_poses,
        ),
        Axis(name="photos", title="photos", unit="number", levels=(-1, 16, 12, 8, 4), apply=_c.keep_photos),
        Axis(
            name="hidden_lamps",
            title="photos of lamps left out",
            unit="share",
            levels=(0, 0.25, 0.5, 0.75, 1),
            apply=_c.drop_lamp_photos,
        ),
        Axis(
            name="mesh_noise",
            title="noise of the mesh",
            unit="mm",
            levels=(0, 2, 5, 10, 20),
            apply=_g.shake_mesh,
            truth_moves=True,
        ),
        Axis(
            name="holes",
            title="rays that escape through holes",
            unit="share",
            levels=(0, 0.15, 0.3, 0.45, 0.6),
            apply=_g.cut_holes,
            truth_moves=True,
        ),
        Axis(
            name="decimation",
            title="mesh simplified to cells of",
            unit="cm",
            levels=(0, 2, 5, 10, 20),
            apply=_g.cluster_vertices,
            truth_moves=True,
        ),
        Axis(
            name="scan",
            title="mesh fused from noisy depth, voxels of",
            unit="cm",
            levels=(0, 1, 2, 3, 4),
            apply=perturb_scan.scan_mesh,
            truth_moves=True,
        ),
        Axis(
            name="density",
            title="longest edge of the mesh",
            unit="cm",
            levels=(-1, 20, 10, 5, 3),
            apply=_g.subdivide,
            truth_moves=True,
        ),
        Axis(
            name="parts",
            title="regions merged",
            unit="share",
            levels=(0, 0.25, 0.5, 0.75, 1),
            apply=_g.merge_regions,
            truth_moves=True,
        ),
        Axis(
            name="gloss",
            title="glossier room",
            unit="times the roughness",
            levels=(1, 0.7, 0.4, 0.2, 0.1),
            apply=_s.glossier,
            truth_moves=True,
        ),
        Axis(
            name="dark_walls",
            title="darker walls",
            unit="times their albedo",
            levels=(1, 0.5, 0.2, 0.1, 0.05),
            apply=_s.darker_walls,
            truth_moves=True,
        ),
        Axis(
            name="lamp_colour",
            title="coloured lamps",
            unit="power of their colour",
            levels=(1, 1.5, 2, 2.5, 3),
            apply=_s.coloured_lamps,
            truth_moves=True,
        ),
        Axis(
            name="dominant_lamp",
            title="one lamp dominates",
            unit="stops",
            levels=(0, 1, 2, 3, 4),
            apply=_s.dominant_lamp,
            truth_moves=True,
        ),
        Axis(
            name="mask_eroded",
            title="given mask: faces missing at its border",
            unit="share",
            levels=(0, 0.2, 0.4, 0.6, 0.8),
            apply=_m.erode,
            masks_only=True,
        ),
        Axis(
            name="mask_dilated",
            title="given mask: area added around it",
            unit="times its area",
            levels=(0, 0.25, 0.5, 1, 2),
            apply=_m.dilate,
            masks_only=True,
        ),
        Axis(
            name="mask_false",
            title="given mask: false lamps",
            unit="number",
            levels=(0, 1, 2, 4, 8),
            apply=_m.add_false,
            masks_only=True,
        ),
        Axis(
            name="mask_missed",
            title="given mask: lamps missed",
            unit="share",
            levels=(0, 0.25, 0.5, 0.75, 1),
            apply=_m.miss,
            masks_only=True,
        ),
    )
}


def perturb(source: Path, axis: str, level: int, seed: int, out: Path) -> Perturbed:
    """Copy the capture ``source`` under ``out`` and make it as hard as ``level`` of ``axis``.

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
        if axis in ("holes", "decimation", "scan", "hidden_lamps") or AXES[axis].masks_only:
            perturb_masks.true_lamp_faces(source)
    except BadInput as error:
        return str(error)
    return None
