"""Damaged files for every reader: ``make fuzz`` for as long as wanted. What breaks one is kept in corpus/."""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from .checks import Target, check
from .mutations import DAMAGE, EDITS, Edit
from .readers import targets

CORPUS = Path(__file__).parent / "corpus"
AT_ONCE = 50
"""Examples of one target before the next one's turn."""


def fuzz(
    seconds: float, first_seed: int, root: Path, found: Callable[[Target, bytes, str], None], only: str = ""
) -> dict[str, int]:
    """Damage every kind of file in turn until ``seconds`` have passed; returns how many were tried by target.

    Args:
        root: an empty folder.
        found: called with a target, what broke its reader, and how.
        only: part of the names of targets that are tried; empty for all.
    """
    end, tried = time.monotonic() + seconds, {}
    chosen = [target for target in targets(root) if only in target.name]
    number = first_seed
    while time.monotonic() < end:
        for target in chosen:
            if time.monotonic() < end:
                tried[target.name] = tried.get(target.name, 0) + _some(target, number, found)
        number += 1
    return tried


def _some(target: Target, number: int, found: Callable[[Target, bytes, str], None]) -> int:
    tried = 0

    @seed(number)
    @settings(
        max_examples=AT_ONCE,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(EDITS)
    def one(edits: list[Edit]) -> None:
        nonlocal tried
        data = target.good
        for edit in edits:
            data = DAMAGE[target.path.suffix](data, edit)
        tried += 1
        wrong = check(target, data)
        if wrong is not None:
            found(target, data, wrong)

    one()
    return tried


def keep(target: Target, data: bytes) -> Path:
    """Add ``data`` to the corpus; every test run reads it from then on."""
    path = CORPUS / f"{target.name}-{hashlib.sha256(data).hexdigest()[:8]}{target.path.suffix}"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def main() -> int:
    """Fuzz and tell what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", default="", help="part of the names of targets")
    options = parser.parse_args()
    ways: dict[tuple[str, str], int] = {}

    def found(target: Target, data: bytes, wrong: str) -> None:
        way = (target.name, wrong[:60])
        ways[way] = ways.get(way, 0) + 1
        if ways[way] == 1:
            print(f"{target.name}: {wrong} ({keep(target, data).name})", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        tried = fuzz(options.seconds, options.seed, Path(folder), found, options.only)
    total = f"{sum(tried.values())} damaged files for {len(tried)} readers"
    print(f"seed {options.seed}: {total}, {sum(ways.values())} findings")
    return 1 if ways else 0


if __name__ == "__main__":
    sys.exit(main())
