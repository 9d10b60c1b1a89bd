"""``python -m tests.real_blender.guide [SUITE]``: the user guide's pictures, from those that the last run took."""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from .root import REPOSITORY

LIMIT_BYTES = 150_000
WIDTH = 1100
VIEW = (0, 25, 1322, 900)  # the 3D view with its sidebar
PICTURES = {  # name in the guide: picture of the test, what of it is shown (left, top, right, bottom)
    "install": ("01_install", (150, 60, 1300, 800)),
    "preferences": ("02_preferences", (150, 60, 1300, 640)),
    "check": ("05_check", VIEW),
    "solve": ("07_preview", VIEW),
    "review": ("08_review_render", VIEW),
    "lamp_off": ("11_lamp_off", VIEW),
    "placed": ("15_placing", VIEW),
}


def write_guide_picture(source: Path, box: tuple[int, int, int, int], target: Path) -> None:
    """Crop, shrink, and compress as much as the limit asks for."""
    with Image.open(source) as picture:
        part = picture.convert("RGB").crop(box)
    width = min(WIDTH, part.width)
    part = part.resize((width, round(part.height * width / part.width)), Image.Resampling.LANCZOS)
    for quality in (90, 85, 80, 70):
        part.save(target, quality=quality, optimize=True)
        if target.stat().st_size < LIMIT_BYTES:
            return
    raise AssertionError(f"{target} stays above {LIMIT_BYTES} bytes")


def main() -> None:
    """Write all of them."""
    suite = sys.argv[1] if len(sys.argv) > 1 else "sid"
    for name, (picture, box) in PICTURES.items():
        target = REPOSITORY / "docs" / "images" / f"guide_{name}.jpg"
        write_guide_picture(REPOSITORY / "out" / "real_blender" / suite / f"{picture}.png", box, target)
        print(f"{target.name}: {target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
