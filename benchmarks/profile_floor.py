"""A solve against its floor: what its rays and its bytes would cost if nothing else did.

    python -m benchmarks.profile_floor [CAPTURE] [--preset balanced] [--no-report]

Rays are counted per stage as they are cast, bytes as the sparse products move them: radiance gathered along rays, and
averages over neighbours. The floor of a stage is its rays at the measured throughput of incoherent rays in the same
room, plus its bytes at the measured bandwidth of memory.
Decoding photos, fitting and writing textures have no floor here: what a ratio above one contains.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.sparse import csr_matrix

from iris_addon.base.progress import Progress, console
from iris_addon.capture.reader import read_capture
from iris_addon.config import PRESETS, preset
from iris_addon.model.capture import Mesh
from iris_addon.rays.tracer import Tracer, points_on_faces
from iris_addon.transport.aimed_rays import SparseRays
from iris_addon.transport.transport import Transport

from . import machine
from .profile_section import Counts, Floors, describe
from .records import Record
from .runs import BUNDLED, capture_folder

SOLVES = 3
TRIAL_RAYS = 1 << 20
TRIAL_BYTES = 1 << 28


def measure_floors(mesh: Mesh, seed: int = 0) -> Floors:
    """Best of three: rays between random points of the surface, and a copy much larger than any cache."""
    rng = np.random.default_rng(seed)
    tracer = Tracer(mesh)
    share = tracer.areas / tracer.areas.sum()
    a, b = (
        points_on_faces(tracer.corners, rng.choice(len(share), TRIAL_RAYS, p=share), rng.random((TRIAL_RAYS, 2)) / 2)
        for _ in range(2)
    )
    a = (a + 1e-3 * (b - a)).astype(np.float32)
    b = b.astype(np.float32)
    direction = b - a
    length = np.linalg.norm(direction, axis=1)
    direction /= np.maximum(length[:, None], 1e-9)
    source = np.ones(TRIAL_BYTES // 8)
    target = np.empty_like(source)

    def best(work: Any) -> float:
        seconds = []
        for _ in range(3):
            start = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - start)
        return min(seconds)

    return Floors(
        TRIAL_RAYS / best(lambda: tracer.hit_faces(a, direction)),
        TRIAL_RAYS / best(lambda: tracer.unoccluded(a, direction, length)),
        2 * TRIAL_BYTES / best(lambda: np.copyto(target, source)),
    )


@contextmanager
def counted(progress: StageProgress) -> Iterator[Counts]:
    """Count rays and bytes by the stage ``progress`` is in, while inside."""
    counts, lock = Counts(), Lock()

    def wrap(owner: type, name: str, count: Any) -> Any:
        original = getattr(owner, name)

        def call(self: Any, *arguments: Any) -> Any:
            with lock:
                count(self, *arguments)
            return original(self, *arguments)

        return patch.object(owner, name, call)

    def rays(kind: dict[str, int]) -> Any:
        def count(_tracer: Tracer, origins: Any, *_rest: Any) -> None:
            kind[progress.current] += len(origins)

        return count

    # Words of 4 bytes. Per ray: patch and face index, its weight, RGB of the patch; per patch: RGB out.
    def moved(rays: int, rows: int) -> None:
        counts.moved[progress.current] += 4 * (6 * rays + 3 * rows)

    def gathered(transport: Transport, *_arguments: Any) -> None:
        moved(transport.target.size + transport.unseen_target.size, transport.n_patches)

    def gathered_by_few(rays: SparseRays, *_arguments: Any) -> None:
        moved(len(rays.row), rays.n_rows)

    def averaged(kernel: csr_matrix, values: Any, *_arguments: Any) -> None:
        columns = values.size // len(values)
        # Per entry: column and weight, the values there; per row: values out.
        counts.moved[progress.current] += 4 * ((2 + columns) * kernel.nnz + columns * (len(kernel.indptr) - 1))

    with (
        wrap(Tracer, "closest", rays(counts.closest)),
        wrap(Tracer, "hit_faces", rays(counts.closest)),
        wrap(Tracer, "unoccluded", rays(counts.occluded)),
        wrap(Transport, "gather_radiance", gathered),
        wrap(SparseRays, "gather_radiance", gathered_by_few),
        wrap(csr_matrix, "__matmul__", averaged),
    ):
        yield counts


class StageProgress(Progress):
    """Progress that knows which stage it is in."""

    current = ""

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """As :meth:`Progress.stage`."""
        self.current = name
        with super().stage(name) as inner:
            yield inner


def profile(folder: Path, preset_name: str) -> Record:
    """Solve cold, and count: seconds, rays and bytes per stage, and the limits of the machine.

    Limits and solves are measured in turn, :data:`SOLVES` times: other work on the machine only ever adds seconds, so
    that the highest throughput and the fewest seconds of a stage are closest to what the code costs.
    """
    from iris_addon.pipeline import solve

    capture = read_capture(folder)
    floors, seconds, counts = [], [], Counts()
    for _ in range(SOLVES):
        floors.append(asdict(measure_floors(capture.mesh)))
        progress = StageProgress(console())
        with tempfile.TemporaryDirectory(prefix="iris-profile-") as scratch:
            os.environ["IRIS_CACHE"] = str(Path(scratch) / "cache")
            with counted(progress) as counts:
                report = solve(capture, preset(preset_name), Path(scratch) / "result", progress).report  # type: ignore[arg-type]
        seconds.append(report["seconds"])
    return {
        "run": {"capture": folder.name, "preset": preset_name},
        "machine": machine.describe(),
        "seconds": {stage: min(run[stage] for run in seconds) for stage in seconds[0]},
        "counts": {name: dict(stages) for name, stages in vars(counts).items()},
        "floors": {limit: max(trial[limit] for trial in floors) for limit in floors[0]},
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=capture_folder, nargs="?", default=BUNDLED)
    parser.add_argument("--preset", choices=list(PRESETS), default="balanced")
    parser.add_argument("--no-report", action="store_true", help="print alone, leave docs as they are")
    args = parser.parse_args(arguments)
    record = profile(args.capture, args.preset)
    print(describe([record]))
    if not args.no_report:
        from .report import publish

        publish("profile", [record])
    return 0


if __name__ == "__main__":
    sys.exit(main())
