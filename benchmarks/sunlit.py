"""Rooms without a lamp, lit by the sun and the sky through a window: is the sun found, and what is the room worth?

    python -m benchmarks.sunlit [ROOM ...] [--preset draft] [--seeds 1]

The rooms are those of :mod:`benchmarks.sunlit_room`, rendered to OUT/captures once. Records lie in OUT/records; a run
that has one is not repeated.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .rooms import SAMPLES, measure_rooms, parser_of, rendered

ROOMS = ("blind", "pane", "scan")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_of("sunlit", __doc__)
    parser.add_argument("rooms", nargs="*", choices=[*ROOMS, []], default=[], metavar="ROOM", help="by default all")
    args = parser.parse_args(arguments)
    rooms = [rendered("sunlit_room", name, args.out / "captures") for name in args.rooms or ROOMS]
    measure_rooms("sunlit", rooms, args, samples=SAMPLES)
    return 0


if __name__ == "__main__":
    sys.exit(main())
