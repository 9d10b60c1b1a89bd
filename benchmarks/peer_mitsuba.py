"""Peer: differentiable path tracing with Mitsuba 3 (path replay backpropagation, Vicini et al. 2021).

    python -m benchmarks.peer_mitsuba RECORD CAPTURE [--seconds 30 60 ... 1200] [--tune]

Base colour and roughness on our texture atlas and the radiance of every lamp, by Adam on the squared error of the
photos. It is given what our solver has to find: the true response, the true exposures, the true faces of the lamps. One
random photo per step; the reported seconds start before the first step and contain compiling, not scoring.

Limits: metallic stays zero, no light from outside the mesh, texels that no photo sees keep their first value.

Mitsuba's LLVM variant needs a libLLVM of version 16 or newer; DRJIT_LIBLLVM_PATH names it where it is not found.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iris_addon.errors import IrisError
from iris_addon.progress import Progress
from iris_addon.response.curve import N_SAMPLES
from iris_addon.result.json_files import read_json
from iris_addon.result.types import Emitter, Result, Textures
from iris_addon.surface.parts import initial_parts

from . import machine
from .mitsuba_scene import ATLAS_SIZE, BASE_COLOR, ROUGHNESS, SIDES, Problem, load_mitsuba, make_scene
from .runs import Record, Run, relative, run_isolated, save_record

NAME = "mitsuba-prb"
SNAPSHOTS = (30, 60, 120, 300, 600, 1200)
SAMPLES = 8
BEYOND, BEYOND_SLOPE = 4.0, 0.3
"""How far and how steeply the response goes on above 1 while optimising."""
TUNED_TEXTURE_RATES = (0.01, 0.03, 0.06)
TUNED_LAMP_RATES = (0.03, 0.1, 0.2)
TUNING_SECONDS = 60


@dataclass(frozen=True)
class Rates:
    """Step sizes of Adam; they fall as 1 / sqrt(1 + t / decay), which needs no end to be known.

    Attributes:
        texture: of base colour and roughness, in [0, 1].
        lamp: of log radiance.
        decay: seconds.
    """

    texture: float = 0.03
    lamp: float = 0.1
    decay: float = 60.0


# ---- optimisation --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Snapshot:
    """Where the optimisation stood.

    Attributes:
        seconds: since before the first step, without scoring.
        loss: mean squared error of the photos over the last pass.
    """

    result: Result
    seconds: float
    steps: int
    loss: float


def optimise(problem: Problem, stops: Sequence[float], rates: Rates, seed: int, samples: int) -> Iterator[Snapshot]:
    """Optimise and stop to look at every time of ``stops`` (seconds, rising)."""
    mi = load_mitsuba()
    import drjit as dr

    scene, sensors = make_scene(mi, problem)
    parameters = mi.traverse(scene)
    optimiser = mi.ad.Adam(lr=rates.texture)
    optimiser[BASE_COLOR], optimiser[ROUGHNESS] = parameters[BASE_COLOR], parameters[ROUGHNESS]
    start_radiance = np.log(1.0 / problem.exposures.min())
    names = [f"log_lamp{k}" for k in range(len(problem.lamps))]
    for name in names:
        optimiser[name] = mi.Color3f(float(start_radiance))
    curve = mi.Float(problem.response.samples.astype(np.float32).ravel())
    rng = np.random.default_rng(seed)
    losses: list[float] = []
    elapsed, steps = 0.0, 0

    for stop in stops:
        while elapsed < stop:
            begin = time.monotonic()
            fall = 1 / np.sqrt(1 + elapsed / rates.decay)
            optimiser.set_learning_rate(
                {BASE_COLOR: rates.texture * fall, ROUGHNESS: rates.texture * fall}
                | dict.fromkeys(names, rates.lamp * fall)
            )
            view = int(rng.integers(len(sensors)))
            _apply(dr, parameters, optimiser, names)
            seed_here = int(rng.integers(2**31))
            image = mi.render(scene, parameters, sensor=sensors[view], spp=samples, seed=seed_here)
            display = _develop(dr, mi, image * dr.opaque(mi.Float, float(problem.exposures[view])), curve)
            loss = _photo_loss(dr, mi, display, problem.photos[view])
            dr.backward(loss)
            optimiser.step()
            for name, low in ((BASE_COLOR, 0.0), (ROUGHNESS, 0.05)):
                optimiser[name] = dr.clip(optimiser[name], low, 1.0)
            losses.append(float(loss.array[0]))
            steps += 1
            elapsed += time.monotonic() - begin
        _apply(dr, parameters, optimiser, names)
        radiance = [np.exp(np.array(optimiser[name], np.float64)).ravel() for name in names]
        result = _result(problem, np.array(parameters[BASE_COLOR]), np.array(parameters[ROUGHNESS]), radiance)
        yield Snapshot(result, elapsed, steps, float(np.mean(losses[-len(sensors) :])))


def _apply(dr: Any, parameters: Any, optimiser: Any, names: Sequence[str]) -> None:
    """What the optimiser holds into the scene; lamps by the exponential, on both sides."""
    parameters[BASE_COLOR], parameters[ROUGHNESS] = optimiser[BASE_COLOR], optimiser[ROUGHNESS]
    for k, name in enumerate(names):
        for side in SIDES:
            if f"lamp{k}_{side}.emitter.radiance.value" in parameters:
                parameters[f"lamp{k}_{side}.emitter.radiance.value"] = dr.exp(optimiser[name])
    parameters.update()


def _develop(dr: Any, mi: Any, exposed: Any, curve: Any) -> Any:
    """Display values of exposed radiance (H, W, 3) by linear interpolation of the response.

    Above 1 the curve goes on with BEYOND_SLOPE up to BEYOND: a clipped rendering of an open pixel must be told so.
    """
    x = dr.clip(exposed.array, 0.0, 1.0) * (N_SAMPLES - 1)
    low = dr.minimum(mi.UInt(dr.detach(x)), N_SAMPLES - 2)
    channel = dr.arange(mi.UInt, dr.width(x)) % 3
    a, b = (dr.gather(mi.Float, curve, channel * N_SAMPLES + low + k) for k in (0, 1))
    beyond = BEYOND_SLOPE * (dr.clip(exposed.array, 1.0, BEYOND) - 1.0)
    return mi.TensorXf(a + (b - a) * (x - mi.Float(low)) + beyond, exposed.shape)


def _photo_loss(dr: Any, mi: Any, display: Any, photo: NDArray[np.float32]) -> Any:
    """Mean squared error against ``photo`` (H, W, 3); a clipped pixel says that the rendering should clip, no more."""
    # A byte b stands for the values from b / 255 to (b + 1) / 255.
    target = mi.TensorXf(np.clip(photo + 0.5 / 255, 0, 1))
    clipped = mi.TensorXf((photo >= 254 / 255).astype(np.float32))
    error = display - target
    return dr.mean(dr.square(clipped * dr.minimum(error, 0.0) + (1.0 - clipped) * error), axis=None)


def _result(
    problem: Problem, base_color: NDArray, roughness: NDArray, radiance: Sequence[NDArray[np.float64]]
) -> Result:
    mesh, areas = problem.capture.mesh, problem.tracer.areas
    side = (ATLAS_SIZE, ATLAS_SIZE)
    textures = Textures(
        np.ascontiguousarray(base_color.reshape(*side, 3), np.float32),
        np.ascontiguousarray(roughness.reshape(side), np.float32),
        np.zeros(side, np.float32),
        np.ones(side, np.float32),
    )
    emitters = tuple(
        Emitter(k, faces, value, float(areas[faces].sum()), 1.0)
        for k, (faces, value) in enumerate(zip(problem.lamps, radiance, strict=True))
    )
    exposures = {view.name: np.full(3, t) for view, t in zip(problem.capture.views, problem.exposures, strict=True)}
    return Result(
        replace(mesh, uv=problem.uv), initial_parts(mesh), textures, emitters, None, problem.response, exposures,
        {}, problem.capture.up,
    )  # fmt: skip


# ---- records -------------------------------------------------------------------------------------------------------


def snapshot_records(capture: Path, folder: Path, samples: int, progress: Progress) -> list[Record]:
    """Records of all snapshots on ``capture``, read back or made in a process of its own."""
    last = folder / f"{_run(capture, SNAPSHOTS[-1], samples).key}.json"
    with progress.stage(NAME):
        error = run_isolated(__name__, last, [relative(capture), "--samples", str(samples)])
    if error is not None:
        return [{"run": asdict(_run(capture, 0, samples)), "error": error}]
    return [read_json(folder / f"{_run(capture, stop, samples).key}.json") for stop in SNAPSHOTS]


def _run(capture: Path, seconds: float, samples: int) -> Run:
    return Run(relative(capture), NAME, f"{seconds:g} s", samples=samples)  # type: ignore[arg-type]


def write_snapshots(folder: Path, capture: Path, stops: Sequence[float], rates: Rates, samples: int) -> None:
    """Optimise on ``capture``, score every snapshot and write its record."""
    from iris_addon.blender.render import render_views
    from iris_addon.evaluate import evaluate

    for stop, shot in zip(stops, optimise(Problem.read(capture), stops, rates, 0, SAMPLES), strict=True):
        scores = evaluate(shot.result, capture, render=render_views, samples=samples)
        scores.pop("per_view")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        run = _run(capture, stop, samples)
        record = {
            "run": asdict(run),
            "machine": machine.describe(),
            "stands_for": "Mitsuba 3 prb with Adam; true response, exposures and lamp faces given",
            "seconds_total": shot.seconds,
            "peak_memory_bytes": peak,
            "steps": shot.steps,
            "training_loss": shot.loss,
            "rates": asdict(rates),
            "metrics": scores,
        }
        save_record(folder / f"{run.key}.json", record)


def tune(capture: Path) -> Rates:
    """The rates with the least error of the photos after a minute, over a small grid; prints what it sees."""
    problem, best = Problem.read(capture), (np.inf, Rates())
    for texture in TUNED_TEXTURE_RATES:
        for lamp in TUNED_LAMP_RATES:
            rates = Rates(texture, lamp)
            (shot,) = optimise(problem, [TUNING_SECONDS], rates, 0, SAMPLES)
            print(
                f"texture {texture:g}  lamp {lamp:g}  steps {shot.steps}  mean squared error {shot.loss:.6f}",
                flush=True,
            )
            best = min(best, (shot.loss, rates), key=lambda pair: pair[0])
    return best[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", type=Path, help="record of the last snapshot; the others are written beside it")
    parser.add_argument("capture", type=Path)
    parser.add_argument("--seconds", type=float, nargs="+", default=SNAPSHOTS)
    parser.add_argument("--samples", type=int, default=64, help="per pixel of the pictures that are scored")
    parser.add_argument("--tune", action="store_true", help="look for the best learning rates first")
    args = parser.parse_args(arguments)
    try:
        rates = tune(args.capture) if args.tune else Rates()
        write_snapshots(args.record.parent, args.capture, sorted(args.seconds), rates, args.samples)
    except IrisError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
