"""Sofa, tables, chairs and shelf, with what lies on them. Coordinates are those of architecture.py."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from .shapes import ball, box, cushion, cylinder, lathe, panel, tube


def sofa(m: SimpleNamespace) -> None:
    """Three seats against the left wall, two loose cushions."""
    x0, y0, y1 = 0.06, 0.95, 3.05
    box("sofa base", (x0, y0, 0.14), (0.92, y1, 0.30), m.linen, bevel=0.02, segments=3)
    box("sofa back", (x0, y0, 0.30), (0.24, y1, 0.80), m.linen, bevel=0.05, segments=4)
    for name, a, b in (("near", y0, y0 + 0.18), ("far", y1 - 0.18, y1)):
        box(
            f"sofa arm {name}", (x0 + 0.005, a - 0.005, 0.145), (0.93, b + 0.005, 0.60), m.linen, bevel=0.05, segments=4
        )
    span = (y1 - y0 - 0.36) / 3
    for k in range(3):
        y = y0 + 0.18 + span * (k + 0.5)
        cushion(f"seat cushion {k}", (0.58, y, 0.375), (0.68, span + 0.005, 0.17), m.linen, square=0.22)
        cushion(f"back cushion {k}", (0.325, y, 0.655), (0.2, span - 0.01, 0.46), m.linen, tilt=-0.16, square=0.3)
    cushion("throw cushion near", (0.50, 1.33, 0.645), (0.14, 0.42, 0.40), m.mustard, turn=0.25, tilt=-0.35)
    cushion("throw cushion far", (0.51, 2.64, 0.645), (0.14, 0.42, 0.40), m.teal, turn=-0.3, tilt=-0.35)
    for x in (0.14, 0.82):
        for y in (y0 + 0.1, y1 - 0.1):
            cylinder(f"sofa leg {x} {y}", (x, y, 0.0), (x, y, 0.142), 0.018, m.walnut, top=0.026)


def coffee_table(m: SimpleNamespace) -> None:
    """Varnished walnut top on a steel frame, on the rug; bowl with lemons, books, vase."""
    panel("rug", [(0.98, 0.85, 0.012), (2.68, 0.85, 0.012), (2.68, 2.85, 0.012), (0.98, 2.85, 0.012)], m.rug)
    box("rug edge", (0.978, 0.848, 0.0), (2.682, 2.852, 0.0115), m.terracotta, bevel=0.0)
    box("coffee table top", (1.40, 1.22, 0.385), (2.0, 2.42, 0.42), m.walnut, bevel=0.008, segments=3)
    box("coffee table shelf", (1.45, 1.27, 0.15), (1.95, 2.37, 0.168), m.walnut)
    for x in (1.42, 1.955):
        for y in (1.24, 2.375):
            box(f"coffee table leg {x} {y}", (x, y, 0.012), (x + 0.025, y + 0.025, 0.385), m.graphite, bevel=0.003)
    bowl = [
        (0.0, 0.002),
        (0.055, 0.0),
        (0.06, 0.012),
        (0.1, 0.03),
        (0.145, 0.065),
        (0.172, 0.105),
        (0.168, 0.107),
        (0.14, 0.071),
        (0.095, 0.038),
        (0.05, 0.022),
        (0.0, 0.02),
    ]
    lathe("brass bowl", bowl, (1.68, 1.98, 0.42), m.brass, segments=48)
    for k, (x, y, z) in enumerate(((1.645, 1.96, 0.478), (1.722, 1.99, 0.480), (1.672, 2.04, 0.489))):
        ball(f"lemon {k}", (x, y, z), 0.037, m.lemon)
    box("book on table", (1.56, 1.38, 0.42), (1.78, 1.68, 0.448), m.books[1], bevel=0.002, turn=0.2)
    box("upper book on table", (1.585, 1.42, 0.448), (1.765, 1.66, 0.471), m.books[2], bevel=0.002, turn=-0.12)
    box("magazine", (1.5, 1.7, 0.168), (1.72, 2.0, 0.176), m.books[0], bevel=0.001, turn=0.35)
    vase = [
        (0.0, 0.0),
        (0.038, 0.0),
        (0.05, 0.02),
        (0.062, 0.07),
        (0.055, 0.12),
        (0.03, 0.17),
        (0.022, 0.21),
        (0.03, 0.235),
        (0.025, 0.235),
        (0.017, 0.21),
        (0.0, 0.2),
    ]
    lathe("table vase", vase, (1.86, 2.27, 0.42), m.clay)


def chair(m: SimpleNamespace, name: str, x: float, y: float, turn: float) -> None:
    """Wooden chair whose back is towards −y before it is turned about its centre."""

    def place(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[tuple, tuple]:
        middle = np.add(low, high) / 2
        half = np.subtract(high, low) / 2
        c, s = math.cos(turn), math.sin(turn)
        centre = np.array([x + c * middle[0] - s * middle[1], y + s * middle[0] + c * middle[1], middle[2]])
        return tuple(centre - half), tuple(centre + half)

    parts = {
        "seat": ((-0.21, -0.2, 0.44), (0.21, 0.21, 0.465)),
        "leg 1": ((-0.20, -0.2, 0.0), (-0.165, -0.165, 0.92)),
        "leg 2": ((0.165, -0.2, 0.0), (0.20, -0.165, 0.92)),
        "leg 3": ((-0.20, 0.165, 0.0), (-0.165, 0.2, 0.44)),
        "leg 4": ((0.165, 0.165, 0.0), (0.20, 0.2, 0.44)),
        "slat 1": ((-0.165, -0.192, 0.60), (0.165, -0.174, 0.68)),
        "slat 2": ((-0.165, -0.192, 0.72), (0.165, -0.174, 0.79)),
        "slat 3": ((-0.165, -0.192, 0.83), (0.165, -0.174, 0.91)),
        "rail": ((-0.165, -0.19, 0.22), (0.165, -0.172, 0.245)),
        "front rail": ((-0.165, 0.172, 0.30), (0.165, 0.19, 0.33)),
    }
    for part, (low, high) in parts.items():
        box(f"{name} {part}", *place(low, high), m.oak, bevel=0.006, turn=turn)


def dining_table(m: SimpleNamespace) -> None:
    """Round oak table with two chairs, a kettle, cups and a plate."""
    cx, cy = 3.78, 2.62
    lathe(
        "dining table top",
        [(0.0, 0.71), (0.46, 0.71), (0.475, 0.722), (0.475, 0.735), (0.465, 0.745), (0.0, 0.745)],
        (cx, cy, 0),
        m.cream,
        segments=56,
    )
    stem = [
        (0.0, 0.0),
        (0.26, 0.0),
        (0.265, 0.012),
        (0.25, 0.022),
        (0.06, 0.045),
        (0.035, 0.09),
        (0.035, 0.66),
        (0.12, 0.71),
        (0.0, 0.71),
    ]
    lathe("dining table stem", stem, (cx, cy, 0), m.graphite, segments=40)
    chair(m, "chair near", 3.62, 1.98, 0.1)
    chair(m, "chair far", 4.44, 2.9, 1.95)
    z = 0.745
    body = [
        (0.0, 0.0),
        (0.092, 0.0),
        (0.102, 0.012),
        (0.104, 0.05),
        (0.092, 0.1),
        (0.066, 0.138),
        (0.05, 0.146),
        (0.048, 0.15),
        (0.02, 0.16),
        (0.008, 0.165),
        (0.008, 0.172),
        (0.017, 0.178),
        (0.017, 0.19),
        (0.0, 0.196),
    ]
    lathe("copper kettle", body, (3.7, 2.75, z), m.copper, segments=48)
    s = np.linspace(0, 1, 12)
    spout = np.stack([3.7 + 0.085 + 0.095 * s, 2.75 + 0.02 * s, z + 0.06 + 0.085 * s**1.5], -1)
    tube("kettle spout", spout, 0.014, m.copper)
    angle = np.linspace(0.12 * math.pi, 0.88 * math.pi, 20)
    handle = np.stack([3.7 + 0.085 * np.cos(angle), np.full(20, 2.75), z + 0.115 + 0.135 * np.sin(angle)], -1)
    tube("kettle handle", handle, 0.008, m.graphite)
    cup = [(0.0, 0.0), (0.028, 0.0), (0.036, 0.012), (0.042, 0.07), (0.039, 0.07), (0.033, 0.014), (0.0, 0.01)]
    for k, (x, y) in enumerate(((3.95, 2.48), (3.62, 2.42))):
        saucer = [(0.0, 0.0), (0.035, 0.0), (0.07, 0.01), (0.068, 0.013), (0.03, 0.005), (0.0, 0.005)]
        lathe(f"saucer {k}", saucer, (x, y, z), m.clay)
        lathe(f"cup {k}", cup, (x, y, z + 0.0055), m.clay)


def bookshelf(m: SimpleNamespace) -> None:
    """Open shelf on the front wall with rows of books, a ball and a jar."""
    x0, x1, depth, top = 1.35, 2.75, 0.30, 1.78
    for name, a in (("left", x0), ("right", x1 - 0.024)):
        box(f"shelf side {name}", (a, 0.018, 0), (a + 0.024, depth, top), m.oak, bevel=0.002)
    box("shelf back", (x0 + 0.024, 0.018, 0.06), (x1 - 0.024, 0.026, top - 0.024), m.oak, bevel=0.0)
    levels = [0.06, 0.48, 0.90, 1.32, top - 0.024]
    for z in levels:
        box(f"shelf board {z}", (x0 + 0.024, 0.026, z), (x1 - 0.024, depth - 0.004, z + 0.024), m.oak, bevel=0.002)
    random = np.random.default_rng(3)
    rows = [(0, 1.39, 2.55), (1, 1.39, 2.05), (2, 1.75, 2.70), (3, 1.39, 1.95)]
    for level, start, end in rows:
        x = start
        while x < end:
            thickness, height, deep = random.uniform(0.02, 0.05), random.uniform(0.2, 0.31), random.uniform(0.16, 0.22)
            cover = m.books[int(random.integers(len(m.books)))]
            z = levels[level] + 0.024
            box(
                f"book {level} {x:.3f}",
                (x, 0.2 + 0.05 - deep, z),
                (x + thickness, 0.25, z + height),
                cover,
                bevel=0.002,
                segments=1,
            )
            x += thickness + 0.0015
    ball("shelf ball", (2.35, 0.17, levels[1] + 0.024 + 0.085), 0.085, m.steel)
    jar = [
        (0.0, 0.0),
        (0.06, 0.0),
        (0.085, 0.03),
        (0.095, 0.09),
        (0.075, 0.16),
        (0.045, 0.185),
        (0.052, 0.205),
        (0.046, 0.205),
        (0.038, 0.185),
        (0.0, 0.175),
    ]
    lathe("shelf jar", jar, (1.56, 0.16, levels[2] + 0.024), m.clay)
    lathe(
        "shelf pot",
        [(0.0, 0.0), (0.07, 0.0), (0.085, 0.13), (0.078, 0.13), (0.065, 0.01), (0.0, 0.01)],
        (2.3, 0.16, levels[3] + 0.024),
        m.terracotta,
    )
    box("shelf box", (2.45, 0.06, levels[3] + 0.024), (2.69, 0.26, levels[3] + 0.17), m.graphite, bevel=0.006)


def build(m: SimpleNamespace) -> None:
    """All furniture."""
    for piece in (sofa, coffee_table, dining_table, bookshelf):
        piece(m)
