"""A capture taken with one of the measured responses, solved in a process of its own:
``python -m benchmarks.curves_worker RECORD_FILE CAPTURE RANK known|withheld PRESET``."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from iris_addon.base.progress import Progress
from iris_addon.capture.reader import read_capture
from iris_addon.config import PresetName, preset
from iris_addon.evaluate.evaluation import evaluate

from . import machine
from .perturb_cameras import misreport_exposures
from .perturb_photos import copy_capture, curves_by_distance, take_with_curve
from .records import write_record

SCORES = ("kd_psnr", "kd_psnr_all", "crf_l2", "exposure_log2_rmse")


def measure(source: Path, rank: int, exposures: str, preset_name: PresetName) -> dict[str, Any]:
    """Solve ``source`` taken with the curve of that rank from the mean of all; what came of it."""
    from iris_addon.pipeline import solve

    with tempfile.TemporaryDirectory(prefix="iris-curves-") as name:
        root = copy_capture(source, Path(name) / "taken")
        rng = np.random.default_rng(rank)
        note = take_with_curve(root, curves_by_distance()[rank], rng)
        if exposures == "withheld":
            note += f"; {misreport_exposures(root, root, np.inf, rng)}"
        os.environ["IRIS_CACHE"] = str(Path(name) / "cache")
        start = time.monotonic()
        result = solve(read_capture(root), preset(preset_name), Path(name) / "result", Progress())
        total = time.monotonic() - start
        metrics = evaluate(result, root, render=None)
    return {
        "run": {"capture": str(source), "rank": rank, "exposures": exposures, "preset": preset_name},
        "machine": machine.describe(),
        "perturbation": note,
        "seconds_total": total,
        "metrics": {score: metrics.get(score) for score in SCORES},
    }


def main(arguments: list[str]) -> int:
    """Command line of the worker."""
    path, capture, rank, exposures, preset_name = arguments
    return write_record(Path(path), lambda: measure(Path(capture), int(rank), exposures, preset_name))  # type: ignore[arg-type]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
