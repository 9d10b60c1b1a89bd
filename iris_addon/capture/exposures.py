"""Exposure factors of photos: from EXIF, from keys of a transforms file, or from a file the user gives.

A factor takes scene radiance to the argument of the response, up to one scale common to a capture.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ExifTags

from ..base.errors import BadInput
from ..base.images import HDR_SUFFIXES
from ..base.untrusted import decoding, number_in_text, open_text
from ..model.capture import View
from .listing import load_array, number, read_json_object
from .photo_files import read_device, read_exif

MAX_CSV_BYTES = 16 * 1024 * 1024


def factor(seconds: float, iso: float = 100.0, f_number: float = 1.0) -> float:
    """Relative exposure t · ISO/100 / N² of a photo; infinite for an f-number whose square is too small for one."""
    square = f_number**2
    return seconds * iso / 100.0 / square if square > 0 else np.inf


def checked(value: float, label: str, path: Path) -> float:
    """``value`` if it is finite and positive; raises BadInput."""
    if not np.isfinite(value) or value <= 0:
        raise BadInput(f"{label}: exposure {value:g}", "give a finite number above zero", path)
    return float(value)


def from_frame(frame: Mapping[str, Any], label: str, path: Path) -> float | None:
    """Exposure of a frame by its keys "exposure", or "exposure_time" with "iso" and "f_number"; None without them."""
    if "exposure" in frame:
        return checked(number(frame, "exposure", path), label, path)
    if "exposure_time" in frame:
        settings = {key: number(frame, key, path) for key in ("iso", "f_number") if key in frame}
        if settings.get("f_number", 1.0) == 0:
            raise BadInput(f"{label}: f_number 0", "give the f-number of the lens, or leave it out", path)
        return checked(factor(number(frame, "exposure_time", path), **settings), label, path)
    return None


def with_unit_mean(views: Sequence[View]) -> tuple[tuple[View, ...], float]:
    """Views whose exposures have a geometric mean of 1, and the factor that they were divided by.

    Exposure times may be in any unit, and constants that are small against radiance must not depend on it. Unless all
    views have exposures, they are returned unchanged, with a factor of 1.
    """
    given = [view.exposure for view in views if view.exposure is not None]
    if not views or len(given) < len(views):
        return tuple(views), 1.0
    unit = float(np.exp(np.log(given).mean()))
    return tuple(replace(view, exposure=value / unit) for view, value in zip(views, given, strict=True)), unit


# ---- EXIF -----------------------------------------------------------------------------------------------------------

_ISO = {
    "speed": ExifTags.Base.ISOSpeedRatings,
    "recommended": ExifTags.Base.RecommendedExposureIndex,
    "standard": ExifTags.Base.StandardOutputSensitivity,
    "iso_speed": ExifTags.Base.ISOSpeed,
}
"""Places where cameras write the ISO. The first is one number of 16 bits, full where the ISO is larger."""
ISO_OVERFLOW = 65535
MIN_EXIF, MAX_EXIF = 1e-7, 1e7
"""Smallest and largest setting that is one; what lies outside is nonsense."""
MAX_APEX = 32.0
"""Of the logarithm of a time or an f-number."""


def exif_settings(photo: Path) -> dict[str, float]:
    """Those of "seconds", "f_number" and "iso" that the EXIF block of ``photo`` gives, in any of its spellings.

    Times and f-numbers may be given as APEX values alone: 2^-Tv seconds, N = 2^(Av/2).
    """
    exif = read_exif(photo)
    if exif is None:
        return {}
    try:
        with decoding(photo):
            block = exif.get_ifd(ExifTags.IFD.Exif) or exif  # camera raw files have theirs in the first directory
    except BadInput:  # a damaged block counts as none; pixels are checked elsewhere
        return {}
    time = _positive(block.get(ExifTags.Base.ExposureTime))
    if time is None and (apex := _finite(block.get(ExifTags.Base.ShutterSpeedValue))) is not None:
        time = _positive(2.0 ** -np.clip(apex, -MAX_APEX, MAX_APEX))
    f_number = _positive(block.get(ExifTags.Base.FNumber))
    if f_number is None and (apex := _finite(block.get(ExifTags.Base.ApertureValue))) is not None:
        f_number = _positive(2.0 ** (np.clip(apex, -MAX_APEX, MAX_APEX) / 2))
    isos = [_positive(block.get(tag)) for tag in _ISO.values()]
    iso = next((value for value in isos if value is not None and value != ISO_OVERFLOW), None)
    found = {"seconds": time, "f_number": f_number, "iso": iso}
    return {name: value for name, value in found.items() if value is not None}


METER_CONSTANT = 12.5
"""K of reflected-light meters, cd/m² · s (ISO 2720): that of most makers."""


def metered_luminance(photo: Path) -> float | None:
    """Luminance, cd/m², for which the EXIF block of ``photo`` says it was exposed: K N² / (t · ISO), None without."""
    if photo.suffix.lower() in HDR_SUFFIXES:
        return None
    found = exif_settings(photo)
    if found.keys() != {"seconds", "f_number", "iso"}:
        return None
    return METER_CONSTANT * found["f_number"] ** 2 / (found["seconds"] * found["iso"])


def with_device(view: View) -> View:
    """The view with the maker and model of its camera by EXIF, unless the capture gives them."""
    return view if view.device or view.photo is None else replace(view, device=read_device(view.photo))


def _finite(value: Any) -> float | None:
    """An EXIF value as a number; None for nonsense, as the rationals 1/0 and 0/0."""
    value = value[0] if isinstance(value, tuple) and value else value
    try:
        number_ = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number_ if np.isfinite(number_) and abs(number_) < MAX_EXIF else None


def _positive(value: Any) -> float | None:
    number_ = _finite(value)
    return number_ if number_ is not None and number_ > MIN_EXIF else None


def from_exif(photos: Mapping[str, Path]) -> dict[str, float]:
    """Exposure by view name, for the photos whose EXIF gives the time and every setting that any photo gives.

    A photo that lacks the ISO or f-number others have cannot be compared with them, so it stays unknown.
    """
    settings = {
        name: exif_settings(photo) for name, photo in photos.items() if photo.suffix.lower() not in HDR_SUFFIXES
    }
    used = {key for found in settings.values() for key in found}
    if "seconds" not in used:
        return {}
    return {name: factor(**found) for name, found in settings.items() if used <= found.keys()}


# ---- A file given by the user ---------------------------------------------------------------------------------------


def apply_file(path: Path, views: Sequence[View], val_views: Sequence[View]) -> tuple[list[View], list[View]]:
    """Views with exposures from ``path``.

    JSON: object of name: factor. CSV: lines of name, factor. Both may name held-out views too. .npy: one factor per
    training view, in order. A name is that of the view or the file name of its photo, with or without extension.

    Raises:
        BadInput: unreadable, a factor is not positive, or a training photo is missing.
    """
    if not path.is_file():
        raise BadInput("no such exposure file", "check --exposures", path)
    if path.suffix.lower() == ".npy":
        values = load_array(path, len(views), "training photo")
        known = [
            replace(view, exposure=checked(value, view.name, path)) for view, value in zip(views, values, strict=True)
        ]
        return known, list(val_views)
    table = _read_csv(path) if path.suffix.lower() == ".csv" else _read_json(path)
    for view in views:
        if not any(alias in table for alias in _aliases(view)):
            raise BadInput(f"has no exposure for {view.name}", "add a line for every training photo", path)
    return _look_up(views, table, path), _look_up(val_views, table, path)


def _look_up(views: Iterable[View], table: Mapping[str, float], path: Path) -> list[View]:
    found = []
    for view in views:
        value = next((table[alias] for alias in _aliases(view) if alias in table), None)
        found.append(view if value is None else replace(view, exposure=checked(value, view.name, path)))
    return found


def _aliases(view: View) -> tuple[str, ...]:
    return (view.name,) if view.photo is None else (view.name, view.photo.name, view.photo.stem)


def _read_json(path: Path) -> dict[str, float]:
    values = read_json_object(path)
    return {name: number(values, name, path) for name in values}


def _read_csv(path: Path) -> dict[str, float]:
    table = {}
    with open_text(path, MAX_CSV_BYTES, mend="give one line of name,exposure per photo", newline="") as file:
        for line, row in enumerate(csv.reader(file)):
            if not row or row[0].startswith("#"):
                continue
            try:
                table[row[0].strip()] = number_in_text(row[1])
            except (IndexError, ValueError) as error:
                if line > 0:  # the first line may be a heading
                    raise BadInput(f"line {line + 1} is not name,exposure", "correct the line", path) from error
    return table
