"""The pictures of an image sequence by their frame numbers: a folder, a pattern or one picture of it.

The number of a frame is the last run of digits in the name, as film and compositing programs have it: ``shot.1001.exr``
is frame 1001. ``shot.####.exr``, ``shot.%04d.exr`` and ``shot.*.exr`` name the whole sequence.
"""

from __future__ import annotations

import re
from pathlib import Path

from ..base.errors import BadInput
from .photo_files import PHOTO_SUFFIXES

MAX_DIGITS = 9
_PLACE = re.compile(r"#+|%0?\d*d|\*")
"""Where a pattern has the number."""


def frame_number(stem: str) -> int | None:
    """The last number in a file name without its suffix, None if there is none."""
    found = _split(stem)
    return None if found is None else int(found[1])


def plate_files(plate: Path) -> dict[int, Path]:
    """The pictures of ``plate`` by number, in order.

    Raises:
        BadInput: there are none, several sequences in one folder, or two pictures with one number.
    """
    if plate.is_dir():
        folder, wanted = plate, None
    else:
        folder, wanted = plate.parent, _wanted(plate)
        if not folder.is_dir():
            raise BadInput("no such folder", "give the folder of the frames, or a pattern as shot.####.png", folder)
    sequences: dict[tuple[str, str, str], dict[int, Path]] = {}
    for path in sorted(folder.iterdir()):
        found = _split(path.stem)
        if found is None or path.name.startswith(".") or path.suffix.lower() not in PHOTO_SUFFIXES:
            continue
        before, digits, after = found
        kind = (before, after, path.suffix.lower())
        if (wanted is not None and wanted != kind) or len(digits) > MAX_DIGITS:
            continue
        there = sequences.setdefault(kind, {})
        if there.setdefault(int(digits), path) != path:
            raise BadInput(f"is frame {int(digits)}, as {there[int(digits)].name} is", "delete one of the two", path)
    if not sequences:
        raise BadInput(
            "has no numbered pictures", "give the folder of the frames, or a pattern as shot.####.png", plate
        )
    if len(sequences) > 1:
        names = ", ".join(f"{before}####{after}{suffix}" for before, after, suffix in list(sequences)[:4])
        raise BadInput(f"holds several sequences: {names}", "name one of them", plate)
    return dict(sorted(next(iter(sequences.values())).items()))


def _wanted(plate: Path) -> tuple[str, str, str]:
    """What the names of the sequence ``plate`` have before and after the number, and their suffix."""
    places = list(_PLACE.finditer(plate.stem))
    if places:
        place = places[-1]
        return plate.stem[: place.start()], plate.stem[place.end() :], plate.suffix.lower()
    found = _split(plate.stem)
    if found is None or not plate.is_file():
        raise BadInput("is no folder, no pattern and no numbered picture", "give a pattern as shot.####.png", plate)
    return found[0], found[2], plate.suffix.lower()


def _split(stem: str) -> tuple[str, str, str] | None:
    """What is before the last number of ``stem``, the number, and what is after it."""
    digits = re.search(r"\d+(?=\D*$)", stem)
    return None if digits is None else (stem[: digits.start()], digits[0], stem[digits.end() :])
