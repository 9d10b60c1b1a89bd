"""Make the bundled demo capture: model the room, render its photos and their ground truth into assets/demo_room.

    .venv/bin/python assets/make_demo_room.py [--samples 96] [--out DIR] [--blend FILE]

Everything is made from numbers in assets/room: no file is read. --blend keeps the scene and renders nothing.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import bpy

ASSETS = Path(__file__).resolve().parent
sys.path[:0] = [str(ASSETS), str(ASSETS.parent)]

from room import architecture, cameras, decor, furniture, materials  # noqa: E402

from iris_addon.base.progress import Progress, console  # noqa: E402
from iris_addon.blender.synth.run import STAGE_WEIGHTS, TRUTH_RENDER, SynthConfig, synth  # noqa: E402


def build_room(blend: Path) -> None:
    """Model the room in an empty file and save it as ``blend``."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    palette = materials.palette()
    for part in (architecture, furniture, decor):
        part.build(palette)
    cameras.build()
    bpy.context.scene.unit_settings.system = "METRIC"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend.absolute()), compress=True)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=96, help="samples per pixel before denoising")
    parser.add_argument("--out", type=Path, default=ASSETS / "demo_room", help="capture folder, replaced")
    parser.add_argument("--blend", type=Path, help="only save the scene there")
    args = parser.parse_args()
    if args.blend:
        build_room(args.blend)
        return
    with tempfile.TemporaryDirectory() as folder:
        blend = Path(folder) / "demo_room.blend"
        build_room(blend)
        capture = Path(folder) / "demo_room"
        config = SynthConfig(compact=True, render=replace(TRUTH_RENDER, samples=args.samples))
        synth(blend, capture, config, Progress(console(), STAGE_WEIGHTS))
        shutil.rmtree(args.out, ignore_errors=True)
        shutil.copytree(capture, args.out)
    size = sum(path.stat().st_size for path in args.out.rglob("*") if path.is_file())
    print(f"{args.out}: {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
