"""Rooms with a mirror, and one with polished steel in its place: is it told which is which, and what is it worth?

    python -m benchmarks.mirrors [ROOM ...] [--preset draft] [--seeds 1]

The rooms are those of :mod:`benchmarks.mirror_room`, rendered to OUT/captures once. Records lie in OUT/records; a run
that has one is not repeated.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .rooms import SAMPLES, measure_rooms, parser_of, rendered

ROOMS = ("wardrobe", "cabinet", "steel")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_of("mirrors", __doc__)
    parser.add_argument("rooms", nargs="*", choices=[*ROOMS, []], default=[], metavar="ROOM", help="by default all")
    args = parser.parse_args(arguments)
    rooms = [rendered("mirror_room", name, args.out / "captures") for name in args.rooms or ROOMS]
    measure_rooms("mirrors", rooms, args, samples=SAMPLES)
    return 0


if __name__ == "__main__":
    sys.exit(main())
