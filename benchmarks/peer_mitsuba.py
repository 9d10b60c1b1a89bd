"""Peer: differentiable path tracing with Mitsuba 3 (path replay backpropagation, Vicini et al. 2021).

    python -m benchmarks.peer_mitsuba RECORD CAPTURE [--limit 1200] [--tune]

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

from iris_addon.base.errors import IrisError
from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_json
from iris_addon.model.recovered import Emitter, Textures
from iris_addon.model.response import Response
from iris_addon.results.result import Result
from iris_addon.surface.topology import initial_regions

from . import machine
from .mitsuba_scene import ATLAS_SIZE, BASE_COLOR, CLIPPED, ROUGHNESS, SIDES, Problem, load_mitsuba, make_scene
from .records import Record
from .runs import Run, relative, run_isolated, standing_record

NAME = "mitsuba-prb"
SNAPSHOTS = (30, 60, 120, 300, 600, 1200)
SAMPLES = 2
"""Per pixel and step: many noisy steps go further in the same time than few clean ones."""
SHOWN_VIEWS, CLEAN_SAMPLES = 5, 32
EPSILON = 1e-6
"""Of Adam: the gradient of a texel that about a pixel shows. What is only seen by way of other surfaces has gradients
of noise, a hundred times smaller, which Adam with its usual 1e-8 turns into full steps: albedo then gets worse again
after two minutes."""
STEEPEST = 6.0
"""Largest slope of the response that weights an error; it grows without bound towards black."""
TUNED_TEXTURE_RATES = (0.01, 0.03, 0.06)
TUNED_LAMP_RATES = (0.03, 0.1, 0.2)
TUNING_SECONDS = 60


@dataclass(frozen=True)
class Rates:
    """Step sizes of Adam; they fall as 1 / sqrt(1 + n / decay) with the steps n, which needs no end to be known.

    Attributes:
        texture: of base colour and roughness, in [0, 1].
        lamp: of log radiance.
        decay: steps.
        warm_up: first steps, of the lamps alone: albedo is quicker to turn white than a lamp to get five times as
            bright, and a white room does not come back.
    """

    texture: float = 0.03
    lamp: float = 0.1
    decay: float = 300.0
    warm_up: int = 40


# ---- optimisation --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Snapshot:
    """Where the optimisation stood.

    Attributes:
        seconds: since before the first step, without scoring.
        loss: mean squared error of some photos, without the noise of a step.
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
    # Texels that the photo of this step does not show stay as they are.
    optimiser = mi.ad.Adam(lr=rates.texture, epsilon=EPSILON, mask_updates=True)
    optimiser[BASE_COLOR], optimiser[ROUGHNESS] = parameters[BASE_COLOR], parameters[ROUGHNESS]
    names = [f"log_lamp{k}" for k in range(len(problem.lamps))]
    darkest = dict(zip(names, (mi.Color3f(*bound) for bound in np.log(problem.lamp_bounds).tolist()), strict=True))
    for name in names:
        optimiser[name] = darkest[name]
    targets = [Target.of(photo, problem.response) for photo in problem.photos]
    rng = np.random.default_rng(seed)
    elapsed, steps = 0.0, 0

    for stop in stops:
        while elapsed < stop:
            begin = time.monotonic()
            fall = 1 / np.sqrt(1 + steps / rates.decay)
            texture = rates.texture * fall if steps >= rates.warm_up else 0.0
            optimiser.set_learning_rate(
                {BASE_COLOR: texture, ROUGHNESS: texture} | dict.fromkeys(names, rates.lamp * fall)
            )
            view = int(rng.integers(len(sensors)))
            _apply(dr, parameters, optimiser, names)
            seed_here = int(rng.integers(2**31))
            image = mi.render(scene, parameters, sensor=sensors[view], spp=samples, seed=seed_here)
            exposed = image * dr.opaque(mi.Float, float(problem.exposures[view]))
            loss = photo_loss(dr, mi, exposed, targets[view])
            dr.backward(loss)
            optimiser.step()
            for name, low in ((BASE_COLOR, 0.0), (ROUGHNESS, 0.05)):
                optimiser[name] = dr.clip(optimiser[name], low, 1.0)
            for name in names:
                optimiser[name] = dr.maximum(optimiser[name], darkest[name])
            dr.eval(optimiser[BASE_COLOR], optimiser[ROUGHNESS])
            dr.sync_thread()
            steps += 1
            elapsed += time.monotonic() - begin
        _apply(dr, parameters, optimiser, names)
        radiance = [np.exp(np.array(optimiser[name], np.float64)).ravel() for name in names]
        result = _result(problem, np.array(parameters[BASE_COLOR]), np.array(parameters[ROUGHNESS]), radiance)
        yield Snapshot(result, elapsed, steps, _clean_loss(mi, dr, scene, sensors, problem, targets))


def _clean_loss(
    mi: Any, dr: Any, scene: Any, sensors: Sequence[Any], problem: Problem, targets: Sequence[Target]
) -> float:
    """Mean of the loss over some photos, with so many samples that noise does not decide."""
    losses = []
    for view in range(0, len(sensors), len(sensors) // SHOWN_VIEWS or 1):
        image = mi.render(scene, sensor=sensors[view], spp=CLEAN_SAMPLES, seed=view)
        losses.append(photo_loss(dr, mi, image * float(problem.exposures[view]), targets[view]).array[0])
    return float(np.mean(losses))


def _apply(dr: Any, parameters: Any, optimiser: Any, names: Sequence[str]) -> None:
    """What the optimiser holds into the scene; lamps by the exponential, on both sides."""
    parameters[BASE_COLOR], parameters[ROUGHNESS] = optimiser[BASE_COLOR], optimiser[ROUGHNESS]
    for k, name in enumerate(names):
        for side in SIDES:
            if f"lamp{k}_{side}.emitter.radiance.value" in parameters:
                parameters[f"lamp{k}_{side}.emitter.radiance.value"] = dr.exp(optimiser[name])
    parameters.update()


@dataclass(frozen=True)
class Target:
    """The photo that a rendering is compared with, (H, W, 3) each.

    The photo is taken back to exposed radiance, because the response of a noisy rendering is darker than that of a
    clean one: compared as photos, few samples drive the lamps up without end. Weighted by the slope of the response an
    error is that of the photo again, to first order.

    Attributes:
        exposed: radiance times exposure.
        weight: slope of the response.
        clipped: 1 where the photo clips: the rendering should too, no more.
    """

    exposed: NDArray[np.float32]
    weight: NDArray[np.float32]
    clipped: NDArray[np.float32]

    @staticmethod
    def of(photo: NDArray[np.float32], response: Response) -> Target:
        """The target that ``photo`` (H, W, 3), display values, sets."""
        # A byte b stands for the values from b / 255 to (b + 1) / 255.
        exposed = response.invert(np.clip(photo + 0.5 / 255, 0, 1))
        clipped = photo >= CLIPPED
        exposed[clipped] = 1.0
        weight = np.minimum(response.slope(exposed), STEEPEST)
        return Target(exposed.astype(np.float32), weight.astype(np.float32), clipped.astype(np.float32))


def photo_loss(dr: Any, mi: Any, exposed: Any, target: Target) -> Any:
    """Mean squared error of a rendering (H, W, 3), times its exposure, in display values."""
    clipped = mi.TensorXf(target.clipped)
    error = exposed - mi.TensorXf(target.exposed)
    error = mi.TensorXf(target.weight) * (clipped * dr.minimum(error, 0.0) + (1.0 - clipped) * error)
    return dr.mean(dr.square(error), axis=None)


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
        Emitter(id=k, faces=faces, radiance=value, area=float(areas[faces].sum()), confidence=1.0)
        for k, (faces, value) in enumerate(zip(problem.lamps, radiance, strict=True))
    )
    exposures = {view.name: np.full(3, t) for view, t in zip(problem.capture.views, problem.exposures, strict=True)}
    return Result(
        mesh=replace(mesh, uv=problem.uv),
        regions=initial_regions(mesh),
        textures=textures,
        emitters=emitters,
        outside=None,
        response=problem.response,
        exposures=exposures,
        report={},
        up=problem.capture.up,
    )


# ---- records -------------------------------------------------------------------------------------------------------


def snapshot_records(capture: Path, folder: Path, limit: float, samples: int, progress: Progress) -> list[Record]:
    """Records of all snapshots up to ``limit`` seconds, read back or made in a process of its own."""
    runs = [snapshot_run(capture, stop, samples) for stop in stops_until(limit)]
    with progress.stage(f"{NAME} on {capture.name}, {limit:.0f} s and scoring"):
        last = folder / f"{runs[-1].key}.json"
        standing_record(runs[-1], folder)  # removes one of other settings
        error = run_isolated(__name__, last, [relative(capture), "--limit", str(limit), "--samples", str(samples)])
    if error is not None:
        return [{"run": asdict(runs[-1]), "error": error}]
    return [read_json(path) for run in runs if (path := folder / f"{run.key}.json").is_file()]


def stops_until(limit: float) -> tuple[float, ...]:
    """Times of the snapshots, the last at ``limit`` seconds."""
    return (*(stop for stop in SNAPSHOTS if stop < limit), limit)


def snapshot_run(capture: Path, seconds: float, samples: int) -> Run:
    """The run that the record of a snapshot stands for."""
    return Run(relative(capture), NAME, f"{seconds:g} s", scored="relight", samples=samples)


def write_snapshots(folder: Path, capture: Path, stops: Sequence[float], rates: Rates, samples: int) -> None:
    """Optimise on ``capture``, score every snapshot by maps and relighting, and write its record."""
    from iris_addon.evaluate.evaluation import evaluate

    from .worker import relight_scores

    for stop, shot in zip(stops, optimise(Problem.read(capture), stops, rates, 0, SAMPLES), strict=True):
        run = snapshot_run(capture, stop, samples)
        scores = evaluate(shot.result, capture, render=None)
        scores.pop("per_view")
        scores |= relight_scores(shot.result, capture, capture, run.views, samples, run.seed)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
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
        write_json(folder / f"{run.key}.json", record)


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
    parser.add_argument("--limit", type=float, default=SNAPSHOTS[-1], help="seconds; it is looked at on the way")
    parser.add_argument("--samples", type=int, default=12, help="per pixel of the pictures that are scored")
    parser.add_argument("--tune", action="store_true", help="look for the best learning rates first")
    args = parser.parse_args(arguments)
    try:
        rates = tune(args.capture) if args.tune else Rates()
        write_snapshots(args.record.parent, args.capture, stops_until(args.limit), rates, args.samples)
    except IrisError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
