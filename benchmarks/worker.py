"""One run in a process of its own: ``python -m benchmarks.worker RECORD_FILE RUN_AS_JSON``."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress
from iris_addon.results.result import Result

from . import machine
from .configurations import CONFIGURATIONS
from .perturb import Perturbed, perturb
from .records import write_record
from .runs import Run


def measure(run: Run, cache: Path) -> dict[str, Any]:
    """Solve and score ``run``; the record.

    Args:
        cache: folder that keeps transport for runs that may share it.

    Raises:
        IrisError: the capture cannot be used, or the configuration does not apply to it.
    """
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="iris-run-") as name:
        scratch = Path(name)
        os.environ["IRIS_CACHE"] = str(cache if run.warm else scratch / "cache")
        perturbed = perturb(Path(run.capture), run.axis, run.level, run.seed, scratch / "perturbed")
        result, seconds = solve(run, perturbed, scratch)
        scores = score(result, run, perturbed.truth)
    scores.pop("per_view", None)
    report = result.report
    return {
        "run": asdict(run),
        "machine": machine.describe(),
        "stands_for": CONFIGURATIONS[run.configuration].stands_for,
        "perturbation": perturbed.note,
        "seconds_total": seconds,
        "seconds_run": time.monotonic() - begin,
        **{name: report.get(name) for name in ("seconds", "peak_memory_bytes", "rays_traced", "n_patches", "n_views")},
        "n_faces": len(result.mesh.faces),
        "lamps": len(result.emitters),
        "model": report.get("model"),
        "holdout_psnr": report.get("holdout_psnr"),
        "metrics": scores,
    }


def solve(run: Run, perturbed: Perturbed, scratch: Path) -> tuple[Result, float]:
    """The result and its wall-clock seconds, reading of the capture and writing of the result included."""
    from iris_addon.pipeline import solve as run_solve

    chosen = CONFIGURATIONS[run.configuration]
    config = chosen.solve_config(run.preset, run.seed, perturbed.capture, scratch)
    start = time.monotonic()
    result = run_solve(chosen.read(config, perturbed.capture, scratch), config, scratch / "result", Progress())
    return result, time.monotonic() - start


def score(result: Result, run: Run, truth: Path) -> dict[str, Any]:
    """Metrics of ``result`` that ``run.scored`` names."""
    from iris_addon.evaluate.evaluation import evaluate

    if run.scored == "all":
        from iris_addon.blender.render.cycles import render_views

        return evaluate(result, truth, render=render_views, samples=run.samples, seed=run.seed)
    scores = evaluate(result, truth, render=None)
    if run.scored == "relight":
        scores |= relight_scores(result, truth, Path(run.capture), run.views, run.samples, run.seed)
        scores["left_out"] = {k: v for k, v in scores["left_out"].items() if k not in scores}
    return scores


def relight_scores(
    result: Result, truth: Path, developed_as: Path, views: int, samples: int, seed: int
) -> dict[str, float]:
    """The relighting metrics alone.

    Args:
        developed_as: capture through whose response pictures and references are compared. Where a sweep gives the
            photos another one, that of the capture as it is: a curve that is flat in the shadows hides errors there,
            and decibels through one curve cannot be compared with those through another.
        views: how many of the held-out views, 0 for all.

    Raises:
        BadInput: the capture has no ground truth.
    """
    from iris_addon.blender.render.cycles import render_views
    from iris_addon.evaluate.ground_truth import read_ground_truth
    from iris_addon.evaluate.metrics import combine
    from iris_addon.evaluate.pictures import relit_views, score_pictures

    ground, as_captured = read_ground_truth(truth), read_ground_truth(developed_as)
    if ground is None or as_captured is None:
        raise BadInput("has no ground truth", "use a capture that has it", truth)
    ground = replace(ground, val_views=ground.val_views[: views or None], response=as_captured.response)
    pictures = relit_views(result, ground, render_views, samples, seed, Progress())
    return {name: combine(list(values.values())) for name, values in score_pictures(pictures).items()}


def main(arguments: list[str]) -> int:
    """Command line of the worker."""
    path, run = Path(arguments[0]), Run(**json.loads(arguments[1]))
    return write_record(path, lambda: measure(run, path.parent / "cache"))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
