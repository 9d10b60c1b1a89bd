"""A capture at half its width and height, for sweeps of hundreds of solves.

Pixels are averaged in radiance and developed again; maps of the ground truth are averaged as their renderer averages
over a pixel. References of inserted objects are left out.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.files import write_json
from iris_addon.base.images import read_exr, read_image, write_exr, write_png
from iris_addon.capture.fipt import read_fipt_views
from iris_addon.evaluate.metrics import to_ldr
from iris_addon.model.capture import View
from iris_addon.model.response import Response

from .machine import ROOT
from .perturb_photos import Film, copy_capture

KEPT = ROOT / "out" / "benchmark_scenes"
PIXEL_LENGTHS = ("w", "h", "fl_x", "fl_y", "cx", "cy")
"""Entries of transforms.json that are counted in pixels."""


def halved_capture(source: Path) -> Path:
    """``source`` at half size, made once and kept; raises BadInput where response or exposures are not recorded."""
    kept = KEPT / f"{source.name}-half"
    if not (kept / "train").is_dir():
        partial = kept.with_name(f".{kept.name}-partial")
        shutil.rmtree(partial, ignore_errors=True)
        halve(copy_capture(source, partial))
        (partial / source.name).rename(kept)
        partial.rmdir()
    return kept


def halve(root: Path) -> None:
    """Halve photos, maps and references of the capture in ``root``, in place."""
    film = Film.of(root)
    rng = np.random.default_rng(0)
    photos = {view.name: _mean_of_blocks(film.radiance(view, rng)) for view in film.views}
    for view in film.views:
        assert view.photo is not None
        write_png(view.photo, _bytes(film.shoot(photos[view.name], view.exposure or 1.0)))
    for path in sorted((root / "gt").rglob("*.exr")):
        values = _mean_of_blocks(read_exr(path)).astype(np.float32)
        write_exr(path, values[..., 0] if values.shape[2] == 1 else values[..., :3])
    has_val = (root / "val" / "transforms.json").is_file()
    for view in read_fipt_views(root, "val") if has_val else ():
        _halve_held_out(root, view, film.response)
    for path in (root / split / "transforms.json" for split in (("train", "val") if has_val else ("train",))):
        meta = json.loads(path.read_text(encoding="utf-8"))
        write_json(path, meta | {key: meta[key] / 2 for key in PIXEL_LENGTHS if key in meta} | _size(meta))
    for folder in (root / "insert", root / "gt" / "insert"):
        shutil.rmtree(folder, ignore_errors=True)


def _size(meta: dict) -> dict[str, int]:
    return {key: int(meta[key]) // 2 for key in ("w", "h") if key in meta}


def _halve_held_out(root: Path, view: View, response: Response) -> None:
    """The held-out photo anew, from its radiance where that is kept (it is halved by now)."""
    png = root / "gt" / "val" / "Image" / f"{view.name}.png"
    if not png.is_file():
        return
    exr, exposure = png.with_suffix(".exr"), view.exposure or 1.0
    if exr.is_file():
        radiance = read_exr(exr)[..., :3].astype(np.float64)
    else:
        radiance = _mean_of_blocks(response.invert((read_image(png) + 0.5) / 256.0)) / exposure
    write_png(png, _bytes(to_ldr(radiance, response, exposure)))


def _mean_of_blocks(image: NDArray) -> NDArray[np.float64]:
    """(H, W, C) to (H // 2, W // 2, C), the mean of every 2 x 2 pixels."""
    height, width, channels = image.shape
    blocks = image[: height // 2 * 2, : width // 2 * 2].reshape(height // 2, 2, width // 2, 2, channels)
    return blocks.mean((1, 3), dtype=np.float64)


def _bytes(display: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.round(255 * display).astype(np.uint8)
