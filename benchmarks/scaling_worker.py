"""Captures of other sizes, each solved in a process of its own: ``python -m benchmarks.scaling_worker RECORD_FILE
CAPTURE SWEEP SIZE PRESET``.

Sizes are made out of one capture: its mesh cut finer or coarser, its photos repeated from places a few centimetres
off, its pixels resampled. Accuracy means nothing here and is not scored.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from iris_addon.base.files import write_json
from iris_addon.base.images import read_image, write_png
from iris_addon.base.progress import Progress
from iris_addon.capture.fipt import read_fipt, read_fipt_views
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.capture.reader import read_capture
from iris_addon.config import PresetName, preset

from . import machine
from .perturb_geometry import write_obj
from .perturb_photos import copy_capture, save_array
from .records import write_record
from .remeshing import cluster, subdivide_edges

JITTER = 0.05
"""Metres around its original that a repeated photo is moved."""


def with_triangles(root: Path, count: int) -> int:
    """Replace the mesh by one of about ``count`` triangles; how many it became."""
    mesh, _ = read_mesh(read_fipt(root).mesh_file)
    coarser = len(mesh.faces) > count
    keep = np.zeros(len(mesh.faces), bool)
    low, high = 1e-3, 2.0  # metres: cell or longest edge
    best = mesh
    for _ in range(14):
        size = float(np.sqrt(low * high))
        best = cluster(mesh, size, keep)[0] if coarser else subdivide_edges(mesh, size)[0]
        if abs(len(best.faces) / count - 1) < 0.1:
            break
        low, high = (size, high) if len(best.faces) > count else (low, size)
    read_fipt(root).mesh_file.unlink()
    write_obj(root / "scene.obj", best)
    return len(best.faces)


def with_photos(root: Path, count: int) -> int:
    """Keep ``count`` photos, or repeat them from places a few centimetres off until there are as many."""
    views = read_fipt_views(root, "train")
    path = root / "train" / "transforms.json"
    meta = json.loads(path.read_text(encoding="utf-8"))
    rng = np.random.default_rng(0)
    frames, exposures = [], []
    for k in range(count):
        view, frame = views[k % len(views)], dict(meta["frames"][k % len(views)])
        assert view.photo is not None
        name = f"r{k:03d}_{view.name}"
        shutil.copyfile(view.photo, view.photo.with_name(f"{name}{view.photo.suffix}"))
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3] += (k >= len(views)) * JITTER * rng.uniform(-1, 1, 3)
        frames.append({**frame, "file_path": f"Image/{name}", "transform_matrix": pose.tolist()})
        exposures.append(view.exposure or 1.0)
    write_json(path, {**meta, "frames": frames})
    if (root / "cam" / "exposure.npy").is_file():
        save_array(root / "cam" / "exposure.npy", np.array(exposures))
    return count


def with_width(root: Path, width: int) -> int:
    """Resample the photos to ``width`` pixels; their total number of pixels."""
    path = root / "train" / "transforms.json"
    meta = json.loads(path.read_text(encoding="utf-8"))
    views = read_fipt_views(root, "train")
    height = round(views[0].camera.height * width / views[0].camera.width)
    for view in views:
        assert view.photo is not None
        small = Image.fromarray(read_image(view.photo)).resize((width, height), Image.Resampling.BOX)
        write_png(view.photo, np.asarray(small))
    write_json(path, {**meta, "w": width, "h": height})
    return width * height * len(views)


Resize = Callable[[Path, int], int]
RESIZE: dict[str, Resize] = {"triangles": with_triangles, "photos": with_photos, "pixels": with_width}


def measure(source: Path, sweep: str, size: int, preset_name: PresetName) -> dict[str, Any]:
    """Solve ``source`` at one size; what it cost."""
    from iris_addon.pipeline import solve

    with tempfile.TemporaryDirectory(prefix="iris-scaling-") as name:
        root = copy_capture(source, Path(name) / "resized")
        actual = RESIZE[sweep](root, size)
        os.environ["IRIS_CACHE"] = str(Path(name) / "cache")
        start = time.monotonic()
        report = solve(read_capture(root), preset(preset_name), Path(name) / "result", Progress()).report
        total = time.monotonic() - start
    costs = {key: report[key] for key in ("seconds", "peak_memory_bytes", "rays_traced", "n_patches")}
    return {
        "run": {"sweep": sweep, "size": size, "preset": preset_name, "capture": str(source)},
        "machine": machine.describe(),
        "actual_size": actual,
        "seconds_total": total,
        **costs,
    }


def main(arguments: list[str]) -> int:
    """Command line of the worker."""
    path, capture, sweep, size, preset_name = arguments
    return write_record(Path(path), lambda: measure(Path(capture), sweep, int(size), preset_name))  # type: ignore[arg-type]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
