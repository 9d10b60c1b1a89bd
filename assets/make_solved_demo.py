"""Make the solved demo that the extension opens without a solver: solve assets/demo_room into assets/demo_solved.

    .venv/bin/python assets/make_solved_demo.py [--result DIR] [--out DIR]

Run it again when the schema of results changes: a test refuses a demo of another one. The textures have 1024 texels a
side, so that the package stays small; base colour is compressed with loss, the others have 8 bits. --result takes a
finished solve of that room in place of a new one.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ASSETS = Path(__file__).resolve().parent
sys.path.insert(0, str(ASSETS.parent))

from iris_addon.base.images import write_exr, write_png  # noqa: E402
from iris_addon.base.progress import Progress, console  # noqa: E402
from iris_addon.capture.inspection import inspect  # noqa: E402
from iris_addon.capture.reader import read_capture  # noqa: E402
from iris_addon.config import preset  # noqa: E402
from iris_addon.pipeline import solve  # noqa: E402
from iris_addon.results.files import BASE_COLOR, COVERAGE, MAPS  # noqa: E402
from iris_addon.results.folder import load_result  # noqa: E402

CAPTURE = ASSETS / "demo_room"
ATLAS = 1024
COVERAGE_LEVELS = 31
"""Of the map that Blender paints in three colours: half as many bytes as with 255."""
REVIEWED = ("render", "error")
"""Pictures of the report that Review shows; the photo is in the capture."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--result", type=Path, help="a finished solve, made with this size of textures")
    parser.add_argument("--out", type=Path, default=ASSETS / "demo_solved", help="folder, replaced")
    args = parser.parse_args()
    progress = Progress(console())
    capture = read_capture(CAPTURE)
    with tempfile.TemporaryDirectory() as folder:
        source = args.result or Path(folder) / "result"
        if args.result is None:
            solve(capture, preset("balanced", atlas_size=ATLAS), source, progress)
        result = load_result(source)
        made = Path(folder) / "demo_solved"
        result.save(made)
        inspect(capture, Path(folder) / "inspection", progress)
        _shrink(made, result.textures)
        _add_reviews(source, made)
        _add_inspection(Path(folder) / "inspection" / "capture.json", made / "inspection" / "capture.json")
        load_result(made)
        shutil.rmtree(args.out, ignore_errors=True)
        shutil.copytree(made, args.out)
    size = sum(path.stat().st_size for path in args.out.rglob("*") if path.is_file())
    print(f"{args.out}: {size / 1e6:.2f} MB")


def _shrink(folder: Path, textures) -> None:  # noqa: ANN001 - Textures
    write_exr(folder / BASE_COLOR, textures.base_color, half=True, lossy=True)
    for name, file in MAPS.items():
        write_png(folder / file, np.round(np.clip(getattr(textures, name), 0, 1) * 255).astype(np.uint8))
    levels = np.round(textures.coverage * COVERAGE_LEVELS) * (255 / COVERAGE_LEVELS)
    write_png(folder / COVERAGE, np.round(levels).astype(np.uint8))


def _add_reviews(source: Path, folder: Path) -> None:
    (folder / "report").mkdir()
    for kind in REVIEWED:
        for path in source.glob(f"report/*-{kind}.png"):
            with Image.open(path) as picture:
                picture.convert("RGB").quantize(256).save(folder / "report" / path.name, optimize=True)
    for path in source.glob("report/lamp-*.png"):
        shutil.copyfile(path, folder / "report" / path.name)


def _add_inspection(source: Path, path: Path) -> None:
    """What ``inspect`` measured, with the names of the photos in place of their paths."""
    content = json.loads(source.read_text())
    path.parent.mkdir()
    rows = [{**row, "photo": Path(row["photo"]).name} for row in content["views"]]
    path.write_text(json.dumps({**content, "root": "", "views": rows}))


if __name__ == "__main__":
    main()
