"""Hashes of every array of a solve's result: equal before and after a change that moves code and no numbers.

    python -m benchmarks.fingerprint [CAPTURE ...] [--check FILE | --write FILE]

Without captures: the bundled one, and staircase2 and redkitchen where the folder ``shared/captures`` lies beside the
repository. Each is solved at ``draft``, seed 0, nothing cached. Hashes hold for one machine and one set of packages:
another processor rounds in another order.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from iris_addon.base.files import write_json
from iris_addon.capture.reader import read_capture
from iris_addon.config import preset
from iris_addon.pipeline import solve
from iris_addon.results.result import Result

ROOT = Path(__file__).resolve().parent.parent
CAPTURES = (
    ROOT / "assets" / "demo_room",
    ROOT.parent / "shared" / "captures" / "staircase2",
    ROOT.parent / "shared" / "captures" / "redkitchen",
)
LEFT_OUT = {"report"}
"""Fields of a result that are no numbers of the room: the report holds seconds and the names of files."""


def arrays_of(value: object, name: str) -> Iterator[tuple[str, np.ndarray]]:
    """Every array and number below ``value``, by its dotted name, in a fixed order."""
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, (bool, int, float, np.generic)):
        yield name, np.asarray(value)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name not in LEFT_OUT:
                yield from arrays_of(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, dict):
        for key in sorted(value, key=str):
            yield from arrays_of(value[key], f"{name}.{key}")
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from arrays_of(item, f"{name}.{index}")


def fingerprint(result: Result) -> dict[str, str]:
    """SHA-256 of each array of ``result``: its type, its shape and its bytes."""
    hashes = {}
    for name, array in arrays_of(result, "result"):
        digest = hashlib.sha256(f"{array.dtype.str} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
        hashes[name] = digest.hexdigest()
    return hashes


def solved(folder: Path) -> dict[str, str]:
    """The fingerprint of a draft of the capture in ``folder``. Raises IrisError where it cannot be solved."""
    with tempfile.TemporaryDirectory(prefix="iris-fingerprint-") as scratch:
        os.environ["IRIS_CACHE"] = str(Path(scratch) / "cache")
        return fingerprint(solve(read_capture(folder), preset("draft"), Path(scratch) / "result"))


def main(arguments: list[str]) -> int:
    """Command line; 1 where a hash differs from ``--check``."""
    parser = argparse.ArgumentParser(prog="benchmarks.fingerprint", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--check", type=Path, help="file of --write to compare with")
    parser.add_argument("--write", type=Path, help="keep the hashes in this file")
    options = parser.parse_args(arguments)
    found: dict[str, dict[str, str]] = {}
    for folder in options.captures or [folder for folder in CAPTURES if folder.is_dir()]:
        found[folder.name] = solved(folder)
        whole = hashlib.sha256(json.dumps(found[folder.name], sort_keys=True).encode()).hexdigest()
        print(f"{folder.name}: {len(found[folder.name])} arrays, {whole}", flush=True)
    if options.write:
        write_json(options.write, found)
    if not options.check:
        return 0
    expected = json.loads(options.check.read_text(encoding="utf-8"))
    differing = [
        f"{capture}: {name}"
        for capture, hashes in found.items()
        for name in sorted(expected.get(capture, {}).keys() | hashes.keys())
        if expected.get(capture, {}).get(name) != hashes.get(name)
    ]
    print("\n".join(differing) or "equal")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
