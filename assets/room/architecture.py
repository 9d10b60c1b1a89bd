"""The shell of the room: floor, walls, window, door, skirting, radiator, lamps. 5 x 4 x 2.7 m, origin in a corner."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from .shapes import ball, box, cylinder, from_arrays, lathe, panel, sheet

WIDTH, DEPTH, HEIGHT = 5.0, 4.0, 2.7
WINDOW = (1.65, 3.35, 0.95, 2.2)  # x from, x to, z from, z to, in the wall y = DEPTH
REVEAL = 0.14
DOOR = (0.45, 1.35, 2.06)  # y from, y to, height, in the wall x = WIDTH


def shell(m: SimpleNamespace) -> None:
    """Floor, ceiling and four walls with the opening of the window; closed from every side."""
    w, d, h = WIDTH, DEPTH, HEIGHT
    panel("floor", [(0, 0, 0), (w, 0, 0), (w, d, 0), (0, d, 0)], m.floor)
    panel("ceiling", [(0, d, h), (w, d, h), (w, 0, h), (0, 0, h)], m.ceiling)
    panel("wall left", [(0, d, 0), (0, d, h), (0, 0, h), (0, 0, 0)], m.sage)
    panel("wall right", [(w, 0, 0), (w, 0, h), (w, d, h), (w, d, 0)], m.plaster)
    panel("wall front", [(0, 0, 0), (0, 0, h), (w, 0, h), (w, 0, 0)], m.plaster)
    x0, x1, z0, z1 = WINDOW
    xs, zs = (0, x0, x1, w), (0, z0, z1, h)
    vertices = [(x, d, z) for z in zs for x in xs]
    faces = [
        (4 * r + c, 4 * r + c + 1, 4 * r + c + 5, 4 * r + c + 4) for r in range(3) for c in range(3) if (r, c) != (1, 1)
    ]
    start = len(vertices)
    corners = [(x0, z0), (x1, z0), (x1, z1), (x0, z1)]
    vertices += [(x, y, z) for y in (d, d + REVEAL) for x, z in corners]
    faces += [(start + k, start + 4 + k, start + 4 + (k + 1) % 4, start + (k + 1) % 4) for k in range(4)]
    from_arrays("wall back", np.array(vertices, dtype=float), faces, m.plaster)


def window(m: SimpleNamespace) -> None:
    """One bright pane set back in the wall, a frame with a mullion and a transom, a sill."""
    x0, x1, z0, z1 = WINDOW
    y = DEPTH + REVEAL
    panel("window pane", [(x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1)], m.window)
    bar, front, back = 0.055, y - 0.06, y - 0.005
    middle, transom = (x0 + x1) / 2, z1 - 0.36
    bars = {
        "left": ((x0, z0), (x0 + bar, z1)),
        "right": ((x1 - bar, z0), (x1, z1)),
        "bottom": ((x0 + bar, z0), (x1 - bar, z0 + bar)),
        "top": ((x0 + bar, z1 - bar), (x1 - bar, z1)),
        "mullion": ((middle - 0.03, z0 + bar), (middle + 0.03, z1 - bar)),
        "transom left": ((x0 + bar, transom), (middle - 0.03, transom + 0.045)),
        "transom right": ((middle + 0.03, transom), (x1 - bar, transom + 0.045)),
    }
    for name, ((xa, za), (xb, zb)) in bars.items():
        box(f"window {name}", (xa, front, za), (xb, back, zb), m.trim)
    box("window sill", (x0 - 0.06, DEPTH - 0.1, z0 - 0.035), (x1 + 0.06, y, z0), m.trim, bevel=0.008)
    rail = DEPTH - 0.09
    cylinder("curtain rail", (0.95, rail, 2.36), (4.05, rail, 2.36), 0.012, m.steel)
    for x in (0.95, 4.05):
        ball(f"curtain finial {x}", (x, rail, 2.36), 0.028, m.steel, subdivisions=2)
        cylinder(
            f"curtain bracket {x}",
            (x + math.copysign(0.06, 2.5 - x), rail, 2.36),
            (x + math.copysign(0.06, 2.5 - x), DEPTH, 2.36),
            0.008,
            m.steel,
        )
    for name, start, end in (("left", 1.04, 1.6), ("right", 3.4, 3.96)):
        sheet(
            f"curtain {name}",
            (start, rail - 0.035),
            (end, rail - 0.035),
            (0.03, 2.345),
            m.curtain,
            waves=6,
            depth=0.07,
            side=(0, 1),
        )


def door(m: SimpleNamespace) -> None:
    """A panelled door with frame and lever handle."""
    y0, y1, top = DOOR
    x = WIDTH
    for name, a, b in (("near", y0 - 0.08, y0), ("far", y1, y1 + 0.08)):
        box(f"door frame {name}", (x - 0.04, a, 0), (x, b, top), m.trim)
    box("door frame top", (x - 0.04, y0 - 0.08, top), (x, y1 + 0.08, top + 0.08), m.trim)
    box("door leaf", (x - 0.022, y0, 0.008), (x - 0.002, y1, top), m.oak, bevel=0.002)
    for k, (za, zb) in enumerate(((0.18, 0.92), (1.08, 1.9))):
        for side, ya, yb in (("a", y0 + 0.12, (y0 + y1) / 2 - 0.04), ("b", (y0 + y1) / 2 + 0.04, y1 - 0.12)):
            box(f"door panel {k}{side}", (x - 0.034, ya, za), (x - 0.02, yb, zb), m.oak, bevel=0.01)
    box("door plate", (x - 0.027, y1 - 0.085, 0.93), (x - 0.02, y1 - 0.045, 1.12), m.brass, bevel=0.002)
    cylinder("door spindle", (x - 0.02, y1 - 0.065, 1.04), (x - 0.075, y1 - 0.065, 1.04), 0.009, m.brass)
    box("door lever", (x - 0.085, y1 - 0.185, 1.03), (x - 0.065, y1 - 0.055, 1.052), m.brass, bevel=0.006)


def skirting(m: SimpleNamespace) -> None:
    """Boards along the walls, interrupted by the door."""
    t, h = 0.016, 0.09
    runs = {
        "left": ((0, 0), (t, DEPTH)),
        "front": ((t, 0), (WIDTH - t, t)),
        "back": ((t, DEPTH - t), (WIDTH - t, DEPTH)),
        "right near": ((WIDTH - t, 0), (WIDTH, DOOR[0] - 0.08)),
        "right far": ((WIDTH - t, DOOR[1] + 0.08), (WIDTH, DEPTH)),
    }
    for name, ((xa, ya), (xb, yb)) in runs.items():
        box(f"skirting {name}", (xa, ya, 0), (xb, yb, h), m.trim, bevel=0.005)


def radiator(m: SimpleNamespace) -> None:
    """Ribbed panel under the window."""
    for k in range(12):
        x = 1.9 + 0.1 * k
        box(f"radiator rib {k}", (x, 3.86, 0.16), (x + 0.085, 3.945, 0.74), m.trim, bevel=0.018, segments=3)
    for z in (0.2, 0.67):
        box(f"radiator pipe {z}", (1.93, 3.89, z), (3.06, 3.92, z + 0.03), m.trim)
    for x in (2.0, 2.95):
        box(f"radiator bracket {x}", (x, 3.915, 0.3), (x + 0.03, 4.0, 0.34), m.trim)


def lamps(m: SimpleNamespace) -> None:
    """A ceiling lamp and a floor lamp with an opal globe."""
    centre = (2.55, 1.95)
    rim = [
        (0.0, 2.7),
        (0.29, 2.7),
        (0.30, 2.69),
        (0.30, 2.615),
        (0.295, 2.61),
        (0.275, 2.61),
        (0.27, 2.615),
        (0.27, 2.64),
        (0.0, 2.645),
    ]
    lathe("ceiling lamp rim", rim, (*centre, 0), m.brass, segments=48)
    lathe("ceiling lamp disc", [(0.0, 2.622), (0.266, 2.622)], (*centre, 0), m.pendant, segments=48)
    foot = (0.42, 3.52)
    profile = [
        (0.0, 0.0),
        (0.15, 0.0),
        (0.155, 0.006),
        (0.155, 0.018),
        (0.14, 0.026),
        (0.03, 0.034),
        (0.016, 0.06),
        (0.0125, 0.09),
    ]
    profile += [(0.0125, 1.36), (0.02, 1.375), (0.055, 1.39), (0.06, 1.41), (0.0, 1.412)]
    lathe("floor lamp stand", profile, (*foot, 0), m.steel, segments=32)
    ball("floor lamp globe", (*foot, 1.528), 0.135, m.globe, subdivisions=3)


def build(m: SimpleNamespace) -> None:
    """Everything that belongs to the building."""
    for part in (shell, window, door, skirting, radiator, lamps):
        part(m)
