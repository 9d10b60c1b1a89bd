"""Previews of a solve in progress: albedo, light and error of one photo, as three small pictures.

They lie beside the checkpoints and are removed with them.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.images import to_codes, write_png
from ..lighting.problem import Lights
from ..materials.rounds import MaterialProblem
from ..model.capture import Capture
from ..model.response import srgb
from ..response.photometry import Photometry
from ..surface.primary_rays import as_picture
from .files import PREVIEWS, preview_path
from .report import ERROR_GAIN, heat

PREVIEW_SIDE = 256
"""Longest side, pixels; Blender's icons have no more."""
WHITE_PERCENTILE = 90.0
"""Percentile of irradiance that is shown as white."""
DARK_SHARE = 1e-3
"""Irradiance, as a share of white, below which albedo is shown as darker than it is."""


def write_previews(
    folder: Path,
    capture: Capture,
    z: NDArray[np.floating],
    photometry: Photometry,
    problem: MaterialProblem,
    lights: Lights,
) -> None:
    """Write albedo, light and error of the photo that shows most of the room.

    Albedo is the photo's radiance over irradiance, with lamps black. Light is the irradiance and the lamps. The error
    is the difference between this photo and the mean of all photos on the same patches, developed like this photo:
    large where response, exposures or poses are wrong, and on gloss.

    Args:
        folder: of the result.
        z: (n, 3) display values of all pixels on the mesh; radiance for HDR input.

    Raises:
        IrisError: the disk is full.
    """
    samples, of_sample = problem.light.samples, problem.light.surface.sample_patch
    ends = np.searchsorted(samples.view, np.arange(len(capture.views) + 1))
    of_views = [slice(begin, end) for begin, end in pairwise(ends)]
    rows = max(of_views, key=lambda rows: len(np.unique(of_sample[rows])))
    patch, view, pixel = of_sample[rows], samples.view[rows], samples.pixel[rows]
    if not len(patch):
        return
    radiance = photometry.linearise_pixels(z[rows], view, pixel).radiance
    irradiance = problem.shading(lights).irradiance[patch]
    on_lamp = lights.mask[samples.face[rows]][:, None]
    white = max(float(np.percentile(irradiance, WHITE_PERCENTILE)), 1e-9)
    difference = photometry.develop(problem.observed.radiance[patch], view, pixel) - z[rows]
    columns = {
        "albedo": srgb(np.where(on_lamp, 0.0, radiance / np.maximum(irradiance, DARK_SHARE * white))),
        "light": srgb(np.where(on_lamp, 1.0, irradiance / white)),
        "error": heat(np.abs(np.where(on_lamp, 0.0, difference)).mean(-1) * ERROR_GAIN),
    }
    camera = capture.views[view[0]].camera
    step = -(-max(camera.width, camera.height) // PREVIEW_SIDE)
    for kind in PREVIEWS:
        picture = as_picture(columns[kind], pixel, camera, step)
        write_png(preview_path(folder, kind), to_codes(picture))
