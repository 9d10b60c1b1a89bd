"""One leave-one-out run: ``python -m benchmarks.ablation_worker RECORD_FILE CAPTURE LEFT_OUT PRESET``.

What held-out losses decide is left out by refusing it whatever it gains. Mechanisms that no loss decides are replaced
by what a model without them would do; the engine has no switch for them, because nobody would turn it.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from iris_addon import decide
from iris_addon.capture.reader import read_capture
from iris_addon.config import PresetName, preset
from iris_addon.evaluate.evaluation import evaluate

from . import machine
from .ablation_section import NOTHING
from .records import Record, write_record


class Replaced(NamedTuple):
    """An attribute of a module of the engine, and what takes its place."""

    module: str
    name: str
    by: Any


def _own_labels(regions: np.ndarray, *_: object) -> np.ndarray:
    return np.arange(int(regions.max()) + 1, dtype=np.int32)


MECHANISMS: Mapping[str, tuple[Replaced, ...]] = {
    "regions: a scan's rejoined under its light": (Replaced("materials.rounds", "joined_regions", _own_labels),),
    "regions: a scan split by colour": (Replaced("surface.regions", "split_scan", lambda regions, *_: regions),),
    "regions: split at creases": (
        Replaced("surface.regions", "split_creases", lambda regions, *_: np.unique(regions, return_inverse=True)[1]),
    ),
    "gloss: pooled over regions of one object of the file": (
        Replaced("materials.region_likeness", "POOL_ALBEDO_IN_FILE", 1e-6),
    ),
    "gloss: pooled over near regions of like albedo": (Replaced("materials.region_likeness", "POOL_ALBEDO", 1e-6),),
    "paint: shared by regions": (
        Replaced("textures.principled", "shared_paint", lambda _a, _e, _r, painted: np.arange(len(painted))),
    ),
    "paint: texels of one colour evened": (
        Replaced("textures.paint", "Paint.evened", lambda _self, albedo, _error, _region: albedo),
    ),
    "textures: residual light": (
        Replaced("results.assembly", "residual_light", lambda _field, region, *_: np.ones((len(region), 3))),
    ),
    "textures: edges of models weigh less than those of scans": (
        Replaced("textures.bake", "MODELLED_EDGE_WEIGHT", 0.05),
    ),
}
"""Parts of the model that no held-out loss decides, by name."""


def variants() -> list[str]:
    """Everything that can be left out, and nothing first."""
    return [NOTHING, *decide.REFINEMENTS, *MECHANISMS]


@contextmanager
def left_out(name: str) -> Iterator[None]:
    """The engine without ``name``; raises KeyError for what is no refinement and no mechanism."""
    with ExitStack() as undone:
        if name in decide.REFINEMENTS:
            decide_as_before = decide.accept

            def refusing(asked: str, *losses: float, **more: float) -> bool:
                return asked != name and decide_as_before(asked, *losses, **more)

            undone.enter_context(patch.object(decide, "accept", refusing))
        elif name != NOTHING:
            for module, attribute, by in MECHANISMS[name]:
                owner: Any = importlib.import_module(f"iris_addon.{module}")
                *inside, attribute = attribute.split(".")
                for part in inside:
                    owner = getattr(owner, part)
                undone.enter_context(patch.object(owner, attribute, by))
        yield


@contextmanager
def accepted_refinements() -> Iterator[set[str]]:
    """Inside, collects the refinements that are accepted, for any subject."""
    names: set[str] = set()
    decide_as_before = decide.accept

    def noted(name: str, *losses: float, **more: float) -> bool:
        accepted = decide_as_before(name, *losses, **more)
        if accepted:
            names.add(name)
        return accepted

    with patch.object(decide, "accept", noted):
        yield names


def measure(capture: Path, name: str, preset_name: PresetName) -> Record:
    """Solve ``capture`` without ``name`` and score its maps. Raises IrisError where it cannot be solved."""
    from iris_addon.pipeline import solve

    with (
        tempfile.TemporaryDirectory(prefix="iris-ablation-") as scratch,
        left_out(name),
        accepted_refinements() as accepted,
    ):
        os.environ["IRIS_CACHE"] = str(Path(scratch) / "cache")
        start = time.monotonic()
        result = solve(read_capture(capture), preset(preset_name), Path(scratch) / "result")
        seconds = time.monotonic() - start
        metrics = evaluate(result, capture, render=None)
    metrics = {key: value for key, value in metrics.items() if isinstance(value, float)}
    return {
        "run": {"capture": str(capture), "left_out": name, "preset": preset_name},
        "machine": machine.describe(),
        "seconds_total": seconds,
        "accepted": sorted(accepted),
        "metrics": {**metrics, "holdout_psnr": result.report["holdout_psnr"]},
    }


def main(arguments: list[str]) -> int:
    """Command line of the worker."""
    path, capture, name, preset_name = arguments
    return write_record(Path(path), lambda: measure(Path(capture), name, preset_name))  # type: ignore[arg-type]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
