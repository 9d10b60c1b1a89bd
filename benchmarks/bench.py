"""Speed against accuracy: every preset and every peer on every capture.

    python -m benchmarks.bench [--captures DIR ...] [--only STUDY ...] [--seeds 3] [--mitsuba-seconds 1200]

Records lie in OUT/records; a run that has one is not repeated. At the end all records are packed into docs/measured
and the charts and tables of docs/benchmarks.md are made anew (:mod:`benchmarks.report`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.progress import Progress, console

from .configurations import CONFIGURATIONS
from .peer_mitsuba import snapshot_records
from .records import OUT, read_records
from .runs import BUNDLED, Run, capture_folder, captures, has_truth, relative, run_all

STUDIES = ("presets", "peers", "ablation", "mitsuba")
PEER_PRESET = "draft"
RESPONSE_ABLATION = ("constant-exposure", "mean-response", "gamma")
PEERS = tuple(name for name in CONFIGURATIONS if name != "ours" and name not in RESPONSE_ABLATION)
MITSUBA_CAPTURES = (BUNDLED.name, "staircase2")


def planned(folders: Sequence[Path], studies: Sequence[str], seeds: int, samples: int) -> list[Run]:
    """All runs but Mitsuba's, the cheapest question first.

    Rendering costs more than a draft: nothing is rendered for further seeds, relighting alone for the peers, and
    nothing for the ablation of the response, which is about maps and curves. A capture without ground truth is scored
    by its held-out photos, which only a rendering can be; it has no true lamps to give to the peers.
    """
    runs = []
    for folder in folders:
        name, truth = relative(folder), has_truth(folder)
        if "presets" in studies:
            for preset, last in (("draft", seeds), ("balanced", seeds), ("final", 1)):
                for seed in range(last if truth else min(1, last)):
                    scored = "maps" if seed else "all"
                    runs.append(Run(name, "ours", preset, seed, scored=scored, samples=samples))
        if "peers" in studies and truth:
            runs += [Run(name, peer, PEER_PRESET, scored="relight", samples=samples) for peer in PEERS]
        if "ablation" in studies and truth:
            runs += [Run(name, curve, PEER_PRESET, scored="maps", samples=samples) for curve in RESPONSE_ABLATION]
    return runs


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=capture_folder, nargs="+", default=captures())
    parser.add_argument("--only", nargs="+", choices=STUDIES, default=STUDIES, metavar="STUDY", help=", ".join(STUDIES))
    parser.add_argument("--seeds", type=int, default=3, help="of draft and balanced; the others run once")
    parser.add_argument("--samples", type=int, default=12, help="per pixel of the pictures that are scored")
    parser.add_argument("--mitsuba-seconds", type=float, default=1200.0, help="how long Mitsuba may optimise")
    parser.add_argument("--out", type=Path, default=OUT / "bench")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    folder, progress = args.out / "records", Progress(console())
    runs = planned(args.captures, args.only, args.seeds, args.samples)
    failed = run_all(runs, folder, progress) if runs else []
    for capture in args.captures if "mitsuba" in args.only else ():
        if capture.name in MITSUBA_CAPTURES or len(args.captures) == 1:
            failed += snapshot_records(capture, folder, args.mitsuba_seconds, args.samples, progress)
    if not args.no_report:
        from .report import publish

        publish("bench", [*read_records(folder), *(record for record in failed if "error" in record)])
    return 0


if __name__ == "__main__":
    sys.exit(main())
