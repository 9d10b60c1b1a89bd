"""The same photos with the mesh of a scanner in place of the exact one: what is lost?

    python -m benchmarks.scans [CAPTURE=MESH.ply ...] [--preset draft] [--seeds 1]

Photos, cameras and ground truth are those of CAPTURE. Default are the captures of the bench that have a mesh of their
name among the shared scans. Records lie in OUT/records; a run that has one is not repeated.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from .perturb_photos import copy_capture
from .rooms import measure_rooms, parser_of
from .runs import SCAN, SHARED_CAPTURES, capture_folder, captures, has_truth

SHARED_SCANS = SHARED_CAPTURES.parent / "scans"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_of("scans", __doc__)
    parser.add_argument("pairs", type=_pair, nargs="*", metavar="CAPTURE=MESH.ply", help="shared ones if left out")
    args = parser.parse_args(arguments)
    pairs = dict(args.pairs) or shared_scans()
    rooms: list[Path] = []
    for capture, mesh in pairs.items():
        rooms += [capture, scanned(capture, mesh, args.out / "captures")]
    measure_rooms("scans", rooms, args, scored="maps")
    return 0


def shared_scans() -> Mapping[Path, Path]:
    """The captures with ground truth that have a scan, and its mesh."""
    meshes = {capture: SHARED_SCANS / f"{capture.name}.ply" for capture in filter(has_truth, captures())}
    return {capture: mesh for capture, mesh in meshes.items() if mesh.is_file()}


def scanned(capture: Path, mesh: Path, folder: Path) -> Path:
    """A copy of ``capture`` in ``folder`` with another mesh; one that is there is made anew."""
    made = folder / f"{capture.name}{SCAN}"
    if made.exists():
        shutil.rmtree(made)
    folder.mkdir(parents=True, exist_ok=True)
    copy_capture(capture, folder).rename(made)
    shutil.copyfile(mesh, made / "scene.ply")
    return made


def _pair(text: str) -> tuple[Path, Path]:
    capture, _, mesh = text.partition("=")
    if not Path(mesh).is_file():
        raise argparse.ArgumentTypeError(f"{text}: no mesh {mesh!r}; give CAPTURE=MESH.ply")
    return capture_folder(capture), Path(mesh)


if __name__ == "__main__":
    sys.exit(main())
