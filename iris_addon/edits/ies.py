"""Recovered lamps as photometric files (ANSI/IES LM-63-2002), which lighting and rendering programs read.

A recovered lamp is a surface of one radiance, or of one by angle, so what it sends in a direction is its radiance times
the area that one sees from there. Sides against a wall, and what the lamp hides of itself, send nothing. The angles of
a file are those of the room: 0 degrees is down, wherever the lamp points, so that a program places it without turning
it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.capture import HitDistance
from ..model.lamp_profile import LampProfile
from ..model.surface_points import even_points, interpolated

VERTICAL = np.arange(0.0, 181.0, 5.0)
"""Degrees from straight down."""
HORIZONTAL = np.arange(0.0, 361.0, 15.0)
"""Degrees around, counter-clockwise seen from above, from the x axis of the room; the last is the first again."""
IES_POINTS = 96
"""Points on a lamp."""
IES_CLEARANCE = 0.05
"""Metres: what is nearer than this before a side receives its light, and the room does not."""
RAY_START = 1e-4
"""Of the lamp's size: how far rays start from its surface."""
LONGEST_NAME = 60


def seen_areas(
    corners: NDArray[np.floating], room: HitDistance, lamp: HitDistance, profile: LampProfile | None = None
) -> NDArray[np.float64]:
    """(V, H) square metres of a lamp that one sees from each direction of VERTICAL and HORIZONTAL.

    Args:
        corners: (T, 3, 3) of its triangles, metres, z up.
        room: against everything, the lamp too.
        lamp: against these triangles alone.
        profile: what areas count for by the angle at which they are seen.
    """
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    face, weights = even_points(area, IES_POINTS)
    point, normal = interpolated(corners[face], weights), cross[face] / (2 * area[face, None])
    start = RAY_START * max(float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))), 1e-3)
    v, h = np.meshgrid(np.radians(VERTICAL), np.radians(HORIZONTAL[:-1]), indexing="ij")
    ways = np.stack([np.sin(v) * np.cos(h), np.sin(v) * np.sin(h), -np.cos(v)], -1).reshape(-1, 3).astype(np.float64)
    seen = np.zeros(len(ways))
    for side in (1.0, -1.0):
        outward = side * normal
        open_ = np.flatnonzero(room(point + start * outward, outward) > IES_CLEARANCE)
        cosine = outward[open_] @ ways.T
        row, way = np.nonzero(cosine > 1e-6)
        origin = point[open_[row]] + start * outward[open_[row]]
        clear = np.isinf(lamp(origin, ways[way]))
        visible = cosine[row[clear], way[clear]]
        np.add.at(seen, way[clear], visible if profile is None else visible * profile.at(visible))
    table = (seen * area.sum() / IES_POINTS).reshape(v.shape)
    table[[0, -1]] = table[[0, -1]].mean(1, keepdims=True)  # straight down and up are one direction each
    return np.concatenate([table, table[:, :1]], axis=1)


def total_flux(intensity: NDArray[np.floating]) -> float:
    """Lumens of intensities (V, H), candela at VERTICAL and HORIZONTAL, as programs that read the file add them up.

    They are linear between the angles; the integral over the sphere of that is exact.
    """
    around = 0.5 * (intensity[:, 1:] + intensity[:, :-1]).mean(1) * 2 * np.pi
    t = np.radians(VERTICAL)
    low, high = t[:-1], t[1:]
    slope = np.diff(around) / (high - low)
    # ∫ sin t dt and ∫ (t - low) sin t dt over each interval
    flat = np.cos(low) - np.cos(high)
    rising = np.sin(high) - np.sin(low) - (high - low) * np.cos(high)
    return float((around[:-1] * flat + slope * rising).sum())


def ies_file(areas: NDArray[np.floating], lumens: float, size: NDArray[np.floating], name: str, note: str = "") -> str:
    """The content of the file of a lamp of ``lumens`` in all, whose seen areas (V, H) are those of :func:`seen_areas`.

    Args:
        size: (3,) metres, extent along x, y and z.
        note: a line for people.

    Raises:
        ValueError: the lamp sends no light anywhere.
    """
    whole = total_flux(areas)
    if whole <= 0 or not lumens > 0:
        raise ValueError(f"{name} sends no light")
    candela = areas * (lumens / whole)
    lines = [
        "IESNA:LM-63-2002",
        "[TEST] recovered from photos",
        "[MANUFAC] IRIS for Blender",
        f"[LUMCAT] {_printable(name)}",
        f"[LUMINAIRE] {_printable(name)}, {lumens:.1f} lm",
        *([f"[OTHER] {_printable(note, 200)}"] if note else []),
        "TILT=NONE",
        # lamps, lumens per lamp (-1: candela are absolute), multiplier, angles, type C, metres, luminous opening
        f"1 -1 1 {len(VERTICAL)} {len(HORIZONTAL)} 1 2 " + " ".join(f"{extent:.4f}" for extent in size),
        "1 1 0",
        *_wrapped(VERTICAL, "{:g}"),
        *_wrapped(HORIZONTAL, "{:g}"),
    ]
    for column in candela.T:
        lines += _wrapped(column, "{:.5g}")
    return "\r\n".join(lines) + "\r\n"


def _wrapped(values: NDArray[np.floating], form: str, per_line: int = 12) -> list[str]:
    words = [form.format(value) for value in values]
    return [" ".join(words[at : at + per_line]) for at in range(0, len(words), per_line)]


def _printable(text: str, longest: int = LONGEST_NAME) -> str:
    """``text`` as the format allows it: one line of ASCII."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)[:longest]
