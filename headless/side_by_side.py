"""Jobs of a batch side by side: a process for each, as many as cores and memory allow."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.parallel import CORES_VARIABLE, cores
from iris_addon.base.progress import Progress

from .child import RUN

JOB_BYTES = 4 << 30
"""Memory that a job gets before another one is started beside it; a room of 200 photos and a million triangles takes
less than three GiB."""
POLL_SECONDS = 0.2
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", CORES_VARIABLE)
"""What tells the libraries of a process how many cores are its own."""


def run_side_by_side(args: argparse.Namespace, jobs: Sequence[Sequence[str]], progress: Progress) -> None:
    """Run ``jobs``, each a list of units that follow one another, ``args.parallel`` at a time.

    What becomes of a unit stands in the line that it leaves behind; a unit whose solve failed leaves none.

    Raises:
        Cancelled: the processes have been stopped.
    """
    share = max(1, cores() // min(args.parallel, len(jobs)))
    environment = os.environ | {name: str(share) for name in THREADS}
    waiting, running, ended = [list(job) for job in jobs], [], 0
    try:
        with progress.stage("jobs"):
            while waiting or running:
                for process, rest in [one for one in running if one[0].poll() is not None]:
                    running.remove((process, rest))
                    if process.returncode == 0 and rest:
                        waiting.insert(0, rest)
                    else:
                        ended += 1
                while waiting and _room(args, len(running)):
                    first, *rest = waiting.pop(0)
                    running.append((_start(args, first, environment), rest))
                progress.update(ended / len(jobs))
                time.sleep(POLL_SECONDS)
    finally:
        for process, _rest in running:
            process.terminate()
        for process, _rest in running:
            process.wait()


def _room(args: argparse.Namespace, running: int) -> bool:
    """Whether another process fits: into the number, and into memory. One always does."""
    return running == 0 or (running < args.parallel and free_bytes() >= JOB_BYTES)


def free_bytes() -> int:
    """Memory that can be had without swapping; where the system does not tell, more than anyone asks for."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        return 1 << 62


def _start(args: argparse.Namespace, unit: str, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(RUN), "batch", str(args.jobs), "--only", unit]
    command += ["--resume"] if args.resume else []
    command += [] if args.path_mapping is None else ["--path-mapping", str(args.path_mapping)]
    return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
