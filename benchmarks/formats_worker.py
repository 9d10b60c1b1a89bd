"""The bundled room in one format, solved in a process of its own:
``python -m benchmarks.formats_worker RECORD_FILE FORMAT PRESET SEED``."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from iris_addon.base.progress import Progress
from iris_addon.capture.reader import read_capture
from iris_addon.config import PresetName, preset
from iris_addon.evaluate.evaluation import evaluate

from . import machine
from .format_captures import FORMATS, differences, write_room
from .records import Record, write_record


def measure(name: str, preset_name: PresetName, seed: int) -> Record:
    """Solve the bundled room written in the format ``name``; how its input differs from that of the format it is held
    against, and its scores. Raises IrisError where the room cannot be read or solved."""
    from iris_addon.pipeline import solve

    with tempfile.TemporaryDirectory(prefix="iris-formats-") as scratch:
        folder = Path(scratch)
        os.environ["IRIS_CACHE"] = str(folder / "cache")
        root, truth = write_room(name, folder / "written")
        reference, _ = write_room(FORMATS[name].like, folder / "reference")
        capture = read_capture(root)
        difference = differences(capture, read_capture(reference))
        start = time.monotonic()
        result = solve(capture, replace(preset(preset_name), seed=seed), folder / "result", Progress())
        seconds = time.monotonic() - start
        metrics = evaluate(result, truth, render=None)
    metrics = {key: value for key, value in metrics.items() if isinstance(value, float)}
    return {
        "run": {"format": name, "preset": preset_name, "seed": seed},
        "machine": machine.describe(),
        "seconds_total": seconds,
        "difference": difference,
        "warnings": list(capture.warnings),
        "metrics": {**metrics, "holdout_psnr": result.report["holdout_psnr"]},
    }


def main(arguments: list[str]) -> int:
    """Command line of the worker."""
    path, name, preset_name, seed = arguments
    return write_record(Path(path), lambda: measure(name, preset_name, int(seed)))  # type: ignore[arg-type]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
