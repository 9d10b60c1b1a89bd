"""Rooms that we render ourselves, each set with a question of its own.

    python -m benchmarks.made_rooms sunlit|mirrors|patterns|profiles|states [ROOM ...] [--preset draft] [--seeds 1]

Rooms are rendered to OUT/captures once. Records lie in OUT/records; a run that has one is not repeated.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from .rooms import SAMPLES, measure_rooms, parser_of, rendered

SETS = {
    "sunlit": ("sunlit_room", ("blind", "pane", "scan")),
    "mirrors": ("mirror_room", ("wardrobe", "cabinet", "steel")),
    "patterns": ("pattern_room", ("television", "window", "panel")),
    "profiles": ("profile_room", ("downlights", "panel", "even")),
    "states": ("switched_room", ("switched", "steady", "mixed")),
}
"""The module that renders each set, and its rooms."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    arguments = sys.argv[1:] if arguments is None else arguments
    first = argparse.ArgumentParser(add_help=False)
    first.add_argument("set", choices=list(SETS))
    section = first.parse_known_args(arguments[:1] or ["--help"])[0].set
    maker, names = SETS[section]
    parser = parser_of(section, __doc__)
    parser.add_argument("set", choices=[section])
    parser.add_argument("rooms", nargs="*", choices=[*names, []], default=[], metavar="ROOM", help="by default all")
    args = parser.parse_args(arguments)
    rooms = [rendered(maker, name, args.out / "captures") for name in args.rooms or names]
    measure_rooms(section, rooms, args, samples=SAMPLES)
    return 0


if __name__ == "__main__":
    sys.exit(main())
