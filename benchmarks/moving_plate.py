"""A plate with a moving camera in the bundled room: its truth with and without two balls, and scores against it.

    python -m benchmarks.moving_plate make FOLDER [--frames 24] [--resolution 160x120] [--samples 48]
    iris onto-plate RESULT --plate FOLDER/plate --camera FOLDER/transforms.json --objects FOLDER/objects.json --out OUT
    python -m benchmarks.moving_plate score FOLDER OUT

``make`` writes ``plate/`` (the empty room), ``truth/`` (with a grey and a metal ball), ``mask/`` (where the balls are
seen), ``transforms.json``, ``objects.json`` and ``exposures.json``. The exposure changes from frame to frame, slowly as
a camera follows the light and by a random part as well.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from iris_addon.base.files import write_json
from iris_addon.base.images import read_image, write_png
from iris_addon.edits.scene_edit import Sphere
from iris_addon.model.capture import Camera

from .machine import ROOT

FIRST = 1001
"""Number of the first frame, as film plates have it."""
POSITIONS = ((4.40, 1.05, 1.75), (3.70, 3.30, 1.65))
"""The camera goes from one to the other on a curve and looks at TARGET."""
BULGE, TARGET = (0.30, 0.10, 0.05), (2.45, 2.20, 0.35)
FIELD_OF_VIEW = math.radians(60)
DRIFT, JITTER = 0.8, 0.1
"""Stops: half the range of the slow change of exposure, and the deviation of the random part."""
RADIUS = 0.2
BALLS = (
    Sphere(np.array([2.20, 2.62, 0.2126]), RADIUS, base_color=np.full(3, 0.5), roughness=1.0, metallic=0.0),
    Sphere(np.array([2.48, 1.95, 0.2126]), RADIUS, base_color=np.full(3, 0.9), roughness=0.1, metallic=1.0),
)
BALL_SAMPLES = 6
"""Samples of the truth around the balls, as a multiple of the others: a mirror shows noise that walls do not."""
CHANGED = 4
"""Codes by which shadows and reflections of the balls change the truth, at least, where they are scored."""
Values = NDArray[np.floating]


def plate_camera(share: float, width: int, height: int) -> Camera:
    """The camera at ``share`` (0 … 1) of its way."""
    first, last, bulge = (np.array(point) for point in (*POSITIONS, BULGE))
    position = (1 - share) * first + share * last + 4 * share * (1 - share) * bulge
    backward = position - np.array(TARGET)
    backward /= np.linalg.norm(backward)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    c2w = np.eye(4)
    c2w[:3, :3], c2w[:3, 3] = np.stack([right, np.cross(backward, right), backward], 1), position
    focal = 0.5 * width / math.tan(0.5 * FIELD_OF_VIEW)
    return Camera(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2, c2w=c2w)


def make(folder: Path, frames: int, width: int, height: int, samples: int) -> None:
    """Render the plate and its truth into ``folder``; needs bpy."""
    sys.path.insert(0, str(ROOT / "assets"))
    import bpy
    from make_demo_room import build_room

    from iris_addon.blender.insert.differential import border
    from iris_addon.blender.synth.photos import GREY, develop, film
    from iris_addon.blender.synth.renders import Studio, add_outputs
    from iris_addon.blender.synth.run import TRUTH_RENDER
    from iris_addon.blender.synth.scene import prepare, read_geometry
    from iris_addon.model.response import LUMINANCE

    with tempfile.TemporaryDirectory() as temporary:
        build_room(Path(temporary) / "room.blend")
    scene = bpy.context.scene
    prepare(scene)
    add_outputs(scene, read_geometry(scene).materials)
    cameras = [plate_camera(k / (frames - 1), width, height) for k in range(frames)]
    empty = Studio(scene, replace(TRUTH_RENDER, samples=samples))
    plates = [empty.radiance(camera) for camera in cameras]
    grey = GREY / float(np.median([np.median(radiance @ LUMINANCE) for radiance in plates]))
    turns = np.arange(frames) / frames
    stops = DRIFT * np.sin(2 * np.pi * turns) + np.random.default_rng(0).normal(0.0, JITTER, frames)
    exposures = grey * 2.0**stops

    curve, poses = film(), []
    with empty.with_spheres(BALLS):
        # Random numbers of its own: noise that plate and truth share would look like agreement.
        full = Studio(scene, replace(TRUTH_RENDER, samples=samples, seed=1))
        fine = Studio(scene, replace(TRUTH_RENDER, samples=BALL_SAMPLES * samples, seed=2))
        for k, (camera, radiance, exposure) in enumerate(zip(cameras, plates, exposures, strict=True)):
            name = f"plate.{FIRST + k}.png"
            write_png(folder / "plate" / name, develop(radiance, exposure, curve))
            mask = full.maps(camera).object_index
            truth = full.radiance(camera)
            if (mask > 0).any():
                rows, columns = (np.flatnonzero((mask > 0).any(axis=axis)) for axis in (1, 0))
                box = ((rows[0], rows[-1] + 1), (columns[0], columns[-1] + 1))
                with border(scene, box, mask.shape):
                    inside = fine.radiance(camera)
                (top, bottom), (left, right) = box
                truth[top:bottom, left:right] = inside[top:bottom, left:right]
            write_png(folder / "truth" / name, develop(truth, exposure, curve))
            write_png(folder / "mask" / name, mask.astype(np.uint8))
            poses.append({"file_path": f"plate/{name}", "transform_matrix": camera.c2w.tolist()})
    lens = {"w": width, "h": height, "fl_x": cameras[0].fx, "fl_y": cameras[0].fy}
    write_json(folder / "transforms.json", {**lens, "cx": width / 2, "cy": height / 2, "frames": poses})
    write_json(folder / "objects.json", {"objects": [{"shape": "sphere", **asdict(ball)} for ball in BALLS]})
    write_json(folder / "exposures.json", {str(FIRST + k): value for k, value in enumerate(exposures)})


def score(folder: Path, out: Path) -> dict[str, Any]:
    """PSNR of the frames in ``out`` against the truth, and how steady the exposures are that were found.

    Returns:
        dB over all frames: ``whole``; ``balls`` (the mask); ``around`` (beside it, where the balls change the truth);
        ``changed`` (both); ``plate_changed``, what leaving the plate as it is would score there; ``worst_changed`` of a
        single frame. Stops: ``bias`` and ``flicker``, mean and standard deviation over frames of the found exposure
        against the true one, and ``colour``, the deviation between channels.
    """
    squares: dict[str, list[Values]] = {}
    worst = np.inf
    true = {int(k): v for k, v in json.loads((folder / "exposures.json").read_text()).items()}
    stops = []
    for number, exposure in true.items():
        name = f"plate.{number}.png"
        truth, plate = (read_image(folder / kind / name) / 255 for kind in ("truth", "plate"))
        found = read_image(out / f"frame_{number:04d}.png") / 255
        balls = read_image(folder / "mask" / name)[..., 0] > 0
        change = median_filter(np.abs(truth - plate).max(-1), 3)
        changed = balls | (change >= CHANGED / 255)
        regions = {"whole": np.ones_like(balls), "balls": balls, "around": changed & ~balls, "changed": changed}
        for region, inside in regions.items():
            squares.setdefault(region, []).append(((found - truth)[inside] ** 2).ravel())
        squares.setdefault("plate_changed", []).append(((plate - truth)[changed] ** 2).ravel())
        worst = min(worst, psnr(squares["changed"][-1]))
        record = json.loads((out / "exposures" / f"frame_{number:04d}.json").read_text())
        stops.append(np.log2(np.array(record["exposure"]) / exposure))
    difference = np.array(stops)
    return {
        **{region: psnr(np.concatenate(values)) for region, values in squares.items()},
        "worst_changed": worst,
        "bias": float(difference.mean()),
        "flicker": float(difference.mean(1).std()),
        "colour": float(difference.std(1).mean()),
        "frames": len(true),
    }


def psnr(squares: Values) -> float:
    """dB of squared errors of display values in [0, 1]."""
    return float(-10 * np.log10(max(float(squares.mean()), 1e-12)))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("folder", type=Path)
    making.add_argument("--frames", type=int, default=24)
    making.add_argument("--resolution", default="160x120")
    making.add_argument("--samples", type=int, default=48)
    scoring = commands.add_parser("score")
    scoring.add_argument("folder", type=Path)
    scoring.add_argument("out", type=Path)
    args = parser.parse_args()
    if args.command == "make":
        width, height = map(int, args.resolution.split("x"))
        make(args.folder, args.frames, width, height, args.samples)
    else:
        print(json.dumps(score(args.folder, args.out), indent=1))


if __name__ == "__main__":
    main()
