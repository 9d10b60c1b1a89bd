"""The camera as look-up tables: .cube files and an OpenColorIO configuration, for other programs.

``camera.cube``      1D, 1024 entries over the relative exposure x = radiance · exposure in 0 … 1: exactly the table of
                     response.json. Programs clamp beyond 1, as the camera did.
``camera_log.cube``  1D, 4096 entries over the shaper s = (log2 x + 14) / 16, so that radiance of any range fits into
                     0 … 1 before the table: s = 0 is x = 2^-14, s = 0.875 is saturation, s = 1 is x = 4.
``camera_3d.cube``   the same over the same shaper as 65³ nodes, for programs that take no 1D tables.
``config.ocio``      the display "Camera" with one view per photo: its exposure and white balance, then ``camera.cube``.

Where several cameras took the photos, ``camera_2.cube``, ``camera_2_log.cube`` and ``camera_2_3d.cube`` are the second
one's, and so on; a photo's view passes through the table of its camera.

Input is scene-linear Rec.709, output is the display value the photo has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..base.files import atomic_write
from ..model.device import Device
from ..model.response import N_SAMPLES, Response

SHAPER_STOPS_BELOW, SHAPER_STOPS = 14.0, 16.0
"""Range of the shaper in stops: below saturation, and in all."""
LOG_ENTRIES, GRID_SIDE = 4096, 65
"""Entries of camera_log.cube, and nodes per axis of camera_3d.cube."""


NO_TABLES: Mapping[str, str] = MappingProxyType({})
"""For photos of one camera."""


def shaper(x: NDArray[np.floating]) -> NDArray[np.float64]:
    """s in [0, 1] of the relative exposure ``x`` (any shape): 16 stops, 14 of them below saturation."""
    return np.clip((np.log2(np.maximum(x, 2.0**-SHAPER_STOPS_BELOW)) + SHAPER_STOPS_BELOW) / SHAPER_STOPS, 0.0, 1.0)


def unshaper(s: NDArray[np.floating]) -> NDArray[np.float64]:
    """The relative exposure of ``s``; the first node stands for black."""
    s = np.asarray(s, np.float64)
    return np.where(s > 0.0, 2.0 ** (s * SHAPER_STOPS - SHAPER_STOPS_BELOW), 0.0)


def write_luts(
    folder: Path,
    response: Response,
    exposures: Mapping[str, NDArray[np.floating]],
    devices: Sequence[Device] = (),
) -> list[Path]:
    """Write the files of the module's docstring into ``folder`` and return them.

    Args:
        exposures: (3,) factor from radiance to the argument of the response, by name of the photo.
        devices: further cameras with a response of their own.

    Raises:
        IrisError: a file cannot be written.
    """
    files = _tables("camera", response)
    table_of = {}
    for number, device in enumerate(devices, start=2):
        files |= _tables(f"camera_{number}", device.response)
        table_of |= dict.fromkeys(device.photos, f"camera_{number}.cube")
    files["config.ocio"] = ocio_config(exposures, table_of)
    for name, text in files.items():
        atomic_write(folder / name, lambda path, text=text: path.write_text(text, encoding="utf-8"))
    return [folder / name for name in files]


def _tables(stem: str, response: Response) -> dict[str, str]:
    """The three tables of a response, by name of their file."""
    log_curve = _shaped(response, LOG_ENTRIES)
    grid = _shaped(response, GRID_SIDE)
    # The red index runs fastest in a .cube file.
    blue, green, red = np.meshgrid(*[np.arange(GRID_SIDE)] * 3, indexing="ij")
    cube = np.stack([grid[red.ravel(), 0], grid[green.ravel(), 1], grid[blue.ravel(), 2]], -1)
    over_log = "input: (log2(radiance * exposure) + 14) / 16"
    return {
        f"{stem}.cube": _cube("LUT_1D_SIZE", N_SAMPLES, response.samples.T, "input: radiance * exposure, 0 to 1"),
        f"{stem}_log.cube": _cube("LUT_1D_SIZE", LOG_ENTRIES, log_curve, over_log),
        f"{stem}_3d.cube": _cube("LUT_3D_SIZE", GRID_SIDE, cube, over_log),
    }


def ocio_config(exposures: Mapping[str, NDArray[np.floating]], table_of: Mapping[str, str] = NO_TABLES) -> str:
    """An OpenColorIO 2 configuration beside ``camera.cube``: scene-linear Rec.709 and a view per photo.

    ``table_of`` names the file of the curve of photos that another camera took.
    """
    views = exposures or {"exposure 1": np.ones(3)}
    shown = "\n".join(f'    - !<View> {{name: "{name}", colorspace: "photo {name}"}}' for name in views)
    spaces = "\n".join(_photo_space(name, views[name], table_of.get(name, "camera.cube")) for name in views)
    return f"""ocio_profile_version: 2
search_path: .
roles:
  scene_linear: Linear Rec.709
  default: Linear Rec.709
  reference: Linear Rec.709
  data: Raw
file_rules:
  - !<Rule> {{name: Default, colorspace: Linear Rec.709}}
displays:
  Camera:
{shown}
active_displays: [Camera]
colorspaces:
  - !<ColorSpace>
    name: Linear Rec.709
    description: scene-linear radiance, Rec.709 primaries, D65
  - !<ColorSpace>
    name: Raw
    isdata: true
{spaces}
"""


def _photo_space(name: str, exposure: NDArray[np.floating], table: str) -> str:
    r, g, b = (f"{factor:.9g}" for factor in exposure)
    matrix = f"[{r}, 0, 0, 0, 0, {g}, 0, 0, 0, 0, {b}, 0, 0, 0, 0, 1]"
    return f"""  - !<ColorSpace>
    name: "photo {name}"
    from_scene_reference: !<GroupTransform>
      children:
        - !<MatrixTransform> {{matrix: {matrix}}}
        - !<FileTransform> {{src: {table}, interpolation: linear}}"""


def _shaped(response: Response, entries: int) -> NDArray[np.float64]:
    """(entries, 3) display values at even steps of the shaper."""
    x = unshaper(np.linspace(0.0, 1.0, entries))
    return response.apply(np.repeat(x[:, None], 3, axis=1))


def _cube(size: str, entries: int, table: NDArray[np.floating], comment: str) -> str:
    rows = "\n".join(f"{r:.7f} {g:.7f} {b:.7f}" for r, g, b in table.tolist())
    return f"# {comment}\n# output: display value of the photo\n{size} {entries}\n{rows}\n"
