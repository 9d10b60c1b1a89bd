"""Plant, picture, clock, pouf, vases and sideboard. Coordinates are those of architecture.py."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from .shapes import ball, box, cylinder, from_arrays, lathe, panel


def plant(m: SimpleNamespace) -> None:
    """Pot on a side table, arching blades."""
    at = np.array([0.42, 0.46, 0.0])
    lathe(
        "side table top",
        [(0.0, 0.48), (0.235, 0.48), (0.24, 0.488), (0.24, 0.50), (0.235, 0.505), (0.0, 0.505)],
        at,
        m.walnut,
        segments=48,
    )
    for k in range(3):
        a = 2 * math.pi * k / 3 + 0.4
        foot, head = (0.22, 0.09)
        cylinder(
            f"side table leg {k}",
            at + (foot * math.cos(a), foot * math.sin(a), 0),
            at + (head * math.cos(a), head * math.sin(a), 0.482),
            0.013,
            m.walnut,
        )
    pot = [(0.0, 0.0), (0.08, 0.0), (0.115, 0.15), (0.12, 0.17), (0.11, 0.17), (0.105, 0.15), (0.0, 0.148)]
    lathe("plant pot", pot, at + (0, 0, 0.505), m.terracotta)
    lathe("plant soil", [(0.0, 0.158), (0.106, 0.1545)], at + (0, 0, 0.505), m.soil)
    random = np.random.default_rng(11)
    for k in range(18):
        turn, length, droop = 2.4 * k, random.uniform(0.38, 0.62), random.uniform(0.35, 1.1)
        lean = random.uniform(0.25, 0.75)
        s = np.linspace(0, 1, 9)
        out = length * np.sin(lean) * s + 0.16 * droop * s**2 * length
        up = length * np.cos(lean) * s - 0.55 * droop * s**2.2 * length
        width = 0.032 * np.sin(np.pi * np.clip(s * 0.93 + 0.07, 0, 1)) ** 0.8
        direction, across = (
            np.array([math.cos(turn), math.sin(turn), 0]),
            np.array([-math.sin(turn), math.cos(turn), 0]),
        )
        spine = at + (0, 0, 0.655) + 0.03 * direction + out[:, None] * direction + up[:, None] * np.array([0, 0, 1.0])
        spine[:, :2] = np.maximum(spine[:, :2], 0.05)
        fold = np.array([0, 0, 1.0]) * (0.25 * width)[:, None]
        points = np.concatenate([spine - width[:, None] * across + fold, spine, spine + width[:, None] * across + fold])
        faces = [(r * 9 + i, r * 9 + i + 1, (r + 1) * 9 + i + 1, (r + 1) * 9 + i) for r in range(2) for i in range(8)]
        from_arrays(f"leaf {k}", points, faces, m.leaf, smooth=True)


def picture(m: SimpleNamespace) -> None:
    """Framed landscape above the sofa, a clock on the right wall."""
    y0, y1, z0, z1, bar = 1.42, 2.58, 1.2, 2.0, 0.04
    panel("picture", [(0.016, y0, z0), (0.016, y1, z0), (0.016, y1, z1), (0.016, y0, z1)], m.picture)
    box("picture backing", (0.0, y0, z0), (0.014, y1, z1), m.graphite, bevel=0.0)
    box("picture frame bottom", (0.0, y0 - bar, z0 - bar), (0.032, y1 + bar, z0), m.walnut)
    box("picture frame top", (0.0, y0 - bar, z1), (0.032, y1 + bar, z1 + bar), m.walnut)
    box("picture frame near", (0.0, y0 - bar, z0), (0.032, y0, z1), m.walnut)
    box("picture frame far", (0.0, y1, z0), (0.032, y1 + bar, z1), m.walnut)
    x, y, z = 4.998, 2.45, 1.72
    face = lathe(
        "clock",
        [(0.0, 0.0), (0.15, 0.0), (0.155, 0.01), (0.155, 0.032), (0.145, 0.034), (0.14, 0.022), (0.0, 0.022)],
        (0, 0, 0),
        m.trim,
        segments=48,
    )
    face.rotation_euler, face.location = (0, -math.pi / 2, 0), (x, y, z)
    box("clock hour hand", (x - 0.03, y - 0.006, z), (x - 0.026, y + 0.006, z + 0.08), m.graphite, bevel=0.0)
    box("clock minute hand", (x - 0.034, y, z - 0.005), (x - 0.031, y + 0.115, z + 0.005), m.graphite, bevel=0.0)


def odds_and_ends(m: SimpleNamespace) -> None:
    """Pouf, floor vase, sideboard with a ball and a bowl."""
    pouf = [
        (0.0, 0.0),
        (0.22, 0.0),
        (0.25, 0.02),
        (0.265, 0.08),
        (0.27, 0.19),
        (0.265, 0.3),
        (0.25, 0.35),
        (0.2, 0.378),
        (0.1, 0.388),
        (0.0, 0.39),
    ]
    lathe("pouf", pouf, (2.55, 0.95, 0.0125), m.terracotta, segments=48)
    vase = [
        (0.0, 0.0),
        (0.1, 0.0),
        (0.13, 0.03),
        (0.165, 0.15),
        (0.17, 0.26),
        (0.14, 0.4),
        (0.085, 0.52),
        (0.065, 0.58),
        (0.08, 0.63),
        (0.072, 0.63),
        (0.055, 0.58),
        (0.0, 0.56),
    ]
    lathe("floor vase", vase, (4.62, 3.66, 0), m.clay, segments=48)
    box("sideboard", (3.25, 0.02, 0.12), (4.45, 0.42, 0.70), m.walnut, bevel=0.005)
    for k in range(3):
        x = 3.27 + 0.39 * k
        box(f"sideboard front {k}", (x, 0.42, 0.14), (x + 0.38, 0.436, 0.68), m.trim, bevel=0.003)
        ball(f"sideboard knob {k}", (x + 0.335, 0.447, 0.43), 0.013, m.brass, subdivisions=2)
    for x in (3.33, 4.33):
        for y in (0.07, 0.34):
            box(f"sideboard leg {x} {y}", (x, y, 0.0), (x + 0.04, y + 0.04, 0.12), m.walnut)
    ball("sideboard ball", (3.5, 0.2, 0.70 + 0.11), 0.11, m.cream)
    dish = [
        (0.0, 0.0),
        (0.07, 0.0),
        (0.08, 0.01),
        (0.15, 0.055),
        (0.19, 0.07),
        (0.185, 0.074),
        (0.14, 0.06),
        (0.07, 0.018),
        (0.0, 0.015),
    ]
    lathe("steel dish", dish, (4.1, 0.22, 0.70), m.steel, segments=48)


def build(m: SimpleNamespace) -> None:
    """Everything that is there to be looked at."""
    for piece in (plant, picture, odds_and_ends):
        piece(m)
