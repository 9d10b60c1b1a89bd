"""Make the pictures of the README from the bundled capture: the demo's own, relit, disco, objects put into a photo, the
camera's match.

    .venv/bin/python assets/make_gallery.py [--result DIR] [--out DIR] [--samples 96]

Every picture comes from the command line, with jobs that are written beside the renders in --out (out/gallery). What
`make demo` made is taken from --result, else it is made anew. Finished frames are not rendered again.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

ASSETS = Path(__file__).resolve().parent
sys.path.insert(0, str(ASSETS.parent))

from headless import cli  # noqa: E402
from iris_addon.results.folder import load_result  # noqa: E402
from iris_addon.results.result import Result  # noqa: E402

CAPTURE = ASSETS / "demo_room"
PICTURES = ASSETS.parent / "docs" / "images"
RELIT_VIEW, PHOTO_VIEW = 1, 25
LAMPS = {"ceiling": (2.55, 1.95, 2.62), "globe": (0.42, 3.52, 1.53), "window": (2.5, 4.14, 1.58)}
DISCO_COLORS = ((1, 0.05, 0.1), (0.1, 0.3, 1), (0.1, 1, 0.2), (1, 0.6, 0.05), (0.9, 0.1, 1), (0.05, 0.9, 0.9))
DISCO_FRAMES, DISCO_SHOWN = 24, (1, 3, 5, 7)


def lamp_ids(result: Result) -> dict[str, str]:
    """Id of the recovered lamp nearest to each one of the room."""
    centres = {
        str(lamp.id): result.mesh.vertices[result.mesh.faces[lamp.faces]].mean(axis=(0, 1)) for lamp in result.emitters
    }
    return {name: min(centres, key=lambda k: np.linalg.norm(centres[k] - at)) for name, at in LAMPS.items()}


def relit_jobs(ids: dict[str, str]) -> dict[str, dict]:
    """Four changes of light; the first three are mixed from light shares."""
    off = {"off": True}
    return {
        "evening": {"recovered": {ids["window"]: off}},
        "reading": {"recovered": {"all": off, ids["globe"]: {"scale": 2.0, "color": [1, 0.62, 0.3]}}},
        "dawn": {"recovered": {"all": off, ids["window"]: {"color": [0.35, 0.55, 1.0]}}},
        "party": {
            "recovered": {"all": off},
            "lights": [
                {
                    "type": "mesh",
                    "shape": "sphere",
                    "radius": 0.15,
                    "location": [2.6, 2.7, 1.9],
                    "radiance": [20, 2, 8],
                },
                {
                    "type": "spot",
                    "position": [4.2, 0.6, 2.4],
                    "target": [0.6, 1.6, 1.2],
                    "angle": 55,
                    "intensity": [3, 8, 14],
                },
                {
                    "type": "area",
                    "center": [3.4, 3.2, 2.6],
                    "direction": [0, 0, -1],
                    "size": [0.5, 0.5],
                    "radiance": [9, 5, 1],
                },
            ],
        },
    }


def disco_job() -> dict:
    """A ring of coloured spots that turns under the ceiling, the lamps off."""
    spots = []
    for k, color in enumerate(DISCO_COLORS):
        angle = 2 * np.pi * k / len(DISCO_COLORS)
        around = np.array([np.cos(angle), np.sin(angle)])
        spots.append(
            {
                "type": "spot",
                "position": [2.3, 2.0, 2.35],
                "direction": [*around.tolist(), -0.55 - 0.25 * (k % 2)],
                "angle": 44,
                "blend": 0.4,
                "intensity": (np.array(color) * 60).tolist(),
                "turntable": {"turns": 1, "center": [2.3, 2.0, 2.35]},
            }
        )
    dim = {"all": {"scale": 0.03}}
    return {"recovered": dim, "outside": 0.02, "lights": spots, "length": DISCO_FRAMES, "camera": {"view": 0}}


def photo_job() -> dict:
    """A mirror ball and two matte things on what the photo shows."""
    return {
        "objects": [
            {
                "shape": "sphere",
                "radius": 0.15,
                "pixel": [205, 196],
                "base_color": 0.92,
                "roughness": 0.02,
                "metallic": 1,
            },
            {
                "shape": "cone",
                "size": [0.3, 0.3, 0.42],
                "pixel": [120, 196],
                "base_color": [0.1, 0.32, 0.5],
                "roughness": 0.9,
            },
            {
                "shape": "box",
                "size": 0.2,
                "pixel": [262, 150],
                "rotation": [0, 0, 25],
                "base_color": 0.7,
                "roughness": 0.9,
            },
        ]
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--result", type=Path, help="what `make demo` made (out/demo); made anew without it")
    parser.add_argument("--out", type=Path, default=ASSETS.parent / "out" / "gallery")
    parser.add_argument("--samples", type=int, default=96)
    args = parser.parse_args()
    out: Path = args.out.absolute()
    result = args.result.absolute() if args.result else out / "demo"
    if not (result / "pictures").is_dir():
        run("demo", "--out", result)
    save("demo.png", demo_sheet(result / "pictures"))

    out.mkdir(parents=True, exist_ok=True)
    look = look_at(RELIT_VIEW, args.samples)
    relit = [photo(RELIT_VIEW)]
    run("render", result, *look, "--light-shares", "--out", out / "shares")
    for name, job in relit_jobs(lamp_ids(load_result(result))).items():
        more = ("--shares", out / "shares") if "lights" not in job else ()
        run("relight", result, *look, "--lights", write_job(out, name, job), *more, "--out", out / name)
        relit.append(only_picture(out / name))
    save("relit.jpg", np.concatenate(relit, axis=1))

    job = write_job(out, "disco", disco_job())
    for frame in DISCO_SHOWN:
        run("relight", result, *look, "--lights", job, "--frames", frame, "--exposure", 0.5, "--out", out / "disco")
    save("disco.jpg", np.concatenate([read(out / "disco" / f"frame_{k:04d}.png") for k in DISCO_SHOWN], axis=1))

    look = look_at(PHOTO_VIEW, args.samples)
    run(
        "insert",
        result,
        *look,
        "--objects",
        write_job(out, "photo", photo_job()),
        "--onto-photos",
        "--out",
        out / "photo",
    )
    save("inserted.jpg", np.concatenate([photo(PHOTO_VIEW), only_picture(out / "photo")], axis=1))
    run("render", result, *look, "--out", out / "match")
    save("camera_match.jpg", np.concatenate([photo(PHOTO_VIEW), only_picture(out / "match")], axis=1))


def demo_sheet(pictures: Path) -> np.ndarray:
    """The demo's pictures in three rows: a photo and its re-render; relit and inserted; albedo and lamps."""
    rows = (["photo_and_rerender"], ["relit", "inserted"], ["albedo", "lights"])
    return np.concatenate([np.concatenate([read(pictures / f"{name}.png") for name in row], axis=1) for row in rows])


def run(*args: object) -> None:
    """One command; ends the program where that fails."""
    code = cli.main([str(arg) for arg in args])
    if code:
        sys.exit(code)


def write_job(out: Path, name: str, job: dict) -> Path:
    """``job`` as ``name``.json in ``out``."""
    path = out / f"{name}.json"
    path.write_text(json.dumps(job, indent=1))
    return path


def photo(view: int) -> np.ndarray:
    """The photo of a view of the bundled capture, (H, W, 3) uint8."""
    return read(CAPTURE / "train" / "Image" / f"{name_of(view)}.png")


def name_of(view: int) -> str:
    """Its name in the capture."""
    return f"{view:03d}_0001"


def look_at(view: int, samples: int) -> tuple[object, ...]:
    """Arguments of a command that renders this view alone."""
    return ("--views", CAPTURE / "train", "--only", name_of(view), "--samples", samples)


def only_picture(folder: Path) -> np.ndarray:
    """The one PNG in ``folder``, (H, W, 3) uint8."""
    (path,) = folder.glob("*.png")
    return read(path)


def read(path: Path) -> np.ndarray:
    """(H, W, 3) uint8."""
    return np.asarray(Image.open(path).convert("RGB"))


def save(name: str, picture: np.ndarray) -> None:
    """Into docs/images."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(PICTURES / name, quality=90, optimize=True)
    print(PICTURES / name, f"{(PICTURES / name).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
