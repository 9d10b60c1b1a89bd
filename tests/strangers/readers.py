"""Every reader of the package with a small good file of each kind it takes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from headless import batch
from headless.frame_folder import open_frames
from headless.outcome import summarise
from headless.relighting import _naming
from iris_addon.base.files import write_arrays
from iris_addon.base.image_headers import announced_size
from iris_addon.base.images import read_image, write_exr, write_png
from iris_addon.base.untrusted import read_arrays, read_json
from iris_addon.blender.synth.photos import read_response as read_synth_response
from iris_addon.blender.worker import jobs
from iris_addon.capture.inspection import Capture
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.edits.jobs import insertion_edits, relight_edit
from iris_addon.edits.light_shares import LightShares, read_shares, write_shares
from iris_addon.edits.motion import camera_at
from iris_addon.evaluate.ground_truth import read_ground_truth
from iris_addon.response.photometry import read_response
from iris_addon.results.camera_luts import ocio_config
from iris_addon.results.folder import load_result, save_result
from tests.box_room import box_mesh, write_fipt_room, write_nerfstudio_room, write_obj
from tests.colmap_model import camera_of, poses, write_binary, write_text
from tests.result_room import room

from .camera_files import camera_targets
from .checks import Target, files
from .more_files import more_targets

# ---- good files -----------------------------------------------------------------------------------------------------


def targets(root: Path) -> list[Target]:
    """Every kind of file with its reader, in folders below ``root``."""
    return [*_captures(root), *camera_targets(root), *_results(root), *_jobs(root), *more_targets(root)]


def _captures(root: Path) -> Iterator[Target]:
    def photos(folder: Path) -> None:
        capture = read_capture(folder)
        load_photo(capture.views[1])
        read_views(folder)

    nerfstudio = write_nerfstudio_room(root / "nerfstudio").root
    (nerfstudio / "meta.json").write_text('{"up_axis": "+z"}')
    transforms = json.loads((nerfstudio / "transforms.json").read_text())
    transforms |= {"cx": 16.0, "cy": 12.0, "k1": 0.01, "applied_transform": np.eye(4)[:3].tolist(), "mesh": "mesh.ply"}
    transforms["frames"][0] |= {"exposure_time": 0.1, "iso": 100, "f_number": 4}
    (nerfstudio / "transforms.json").write_text(json.dumps(transforms))
    names = ("transforms.json", "mesh.ply", "meta.json", "images/001.png")
    yield from files("nerfstudio", nerfstudio, lambda: photos(nerfstudio), *names)

    jpeg = write_nerfstudio_room(root / "jpeg")
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x829A: 0.01, 0x8827: 100, 0x829D: 4.0})
    pixels = [np.asarray(Image.open(path).convert("RGB")) for path in sorted((jpeg.root / "images").glob("*.png"))]
    for k, frame in enumerate(jpeg.meta["frames"]):
        Image.fromarray(pixels[k]).save(jpeg.root / "images" / f"{k:03d}.jpg", exif=exif)
        frame["file_path"] = f"images/{k:03d}.jpg"
    jpeg.save()
    (jpeg.root / "mesh.ply").unlink()
    write_obj(jpeg.root / "mesh.obj", box_mesh(), groups=True)
    yield from files("jpeg", jpeg.root, lambda: photos(jpeg.root), "images/001.jpg", "mesh.obj")

    radiance = write_nerfstudio_room(root / "radiance")
    for k, frame in enumerate(radiance.meta["frames"]):
        write_exr(radiance.root / "images" / f"{k:03d}.exr", pixels[k] / 255.0)
        frame["file_path"] = f"images/{k:03d}.exr"
    radiance.save()
    (radiance.root / "mesh.ply").unlink()
    plain = trimesh.Trimesh(box_mesh().vertices, box_mesh().faces, process=False)
    plain.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((8, 2)))
    plain.export(radiance.root / "mesh.glb")
    yield from files("radiance", radiance.root, lambda: photos(radiance.root), "images/001.exr", "mesh.glb")
    ascii_ = write_nerfstudio_room(root / "ascii").root
    text = trimesh.Trimesh(box_mesh().vertices, box_mesh().faces).export(file_type="ply", encoding="ascii")
    (ascii_ / "mesh.ply").write_bytes(text)  # type: ignore[arg-type]
    yield from files("ascii", ascii_, lambda: photos(ascii_), "mesh.ply")

    fipt = write_fipt_room(root / "fipt").root
    maps = fipt / "gt" / "train" / "DiffCol"
    (fipt / "gt" / "cam").mkdir(parents=True)
    maps.mkdir(parents=True)
    np.save(fipt / "gt" / "cam" / "crf_gt.npy", np.tile(np.linspace(0, 1, 1024), (3, 1)))
    write_exr(maps / "000_0001.exr", pixels[0] / 255.0)

    def truth() -> None:
        photos(fipt)
        found = read_ground_truth(fipt)
        assert found is not None
        found.map("DiffCol", "train", 0)

    names = ("train/transforms.json", "val/transforms.json", "cam/exposure.npy", "gt/cam/crf_gt.npy")
    yield from files("fipt", fipt, truth, *names, "gt/train/DiffCol/000_0001.exr", "scene.obj")

    for form, write in (("txt", write_text), ("bin", write_binary)):
        colmap = write_nerfstudio_room(root / f"colmap-{form}").root
        capture: Capture = read_capture(colmap)
        (colmap / "transforms.json").unlink()
        (colmap / "sparse" / "0").mkdir(parents=True)
        write(colmap / "sparse" / "0", camera_of(capture), poses(capture))
        names = (f"sparse/0/cameras.{form}", f"sparse/0/images.{form}")
        yield from files("colmap", colmap, lambda colmap=colmap: photos(colmap), *names)

    given = root / "exposures"
    given.mkdir()
    stems = [f"{k:03d}" for k in range(6)]
    (given / "e.csv").write_text("name,exposure\n" + "".join(f"{stem},0.5\n" for stem in stems))
    (given / "e.json").write_text(json.dumps(dict.fromkeys(stems, 0.5)))
    np.save(given / "e.npy", np.full(6, 0.5))
    other = write_nerfstudio_room(root / "other").root
    for file in ("e.csv", "e.json", "e.npy"):
        yield from files("exposures", given, lambda file=file: read_capture(other, exposures=given / file), file)


def _results(root: Path) -> Iterator[Target]:
    folder = root / "result"
    result = room()
    result.report["model"] = {
        "camera": {
            "correction": {"fx_over_width": 0.6, "focal": 1.0, "principal": [0.0, 0.0], "offset": [0.0, 0.0]},
            "poses": {"given": [np.eye(4)[:3].ravel().tolist()] * 2, "twists": [[0.0] * 6] * 2, "smooth": True},
        }
    }
    save_result(result, folder)

    def whole() -> None:
        loaded = load_result(folder)
        ocio_config(loaded.exposures)
        summarise(loaded)

    names = ("report.json", "response.json", "emitters.json", "materials/mesh.glb", "materials/base_color.exr")
    yield from files("result", folder, whole, *names, "materials/roughness.png")

    curves = root / "curves"
    curves.mkdir()
    (curves / "c.txt").write_text("\n".join(f"{x} {x} {x}" for x in np.linspace(0, 1, 1024)))
    (curves / "c.json").write_text(json.dumps({"samples": np.linspace(0, 1, 1024).tolist()}))
    np.save(curves / "c.npy", np.linspace(0, 1, 1024))
    for file in ("c.txt", "c.json", "c.npy"):
        yield from files("response", curves, lambda file=file: read_response(curves / file), file)
        yield from files("synth", curves, lambda file=file: read_synth_response(curves / file), file)

    arrays = root / "arrays"
    arrays.mkdir()
    values = {"key": np.array("a" * 64), "x": np.arange(60.0).reshape(3, 20), "m": np.ones(9, bool)}
    for compressed in (False, True):
        file = arrays / f"a{compressed:d}.npz"
        write_arrays(file, values, compressed=compressed)
        yield from files("arrays", arrays, lambda file=file: read_arrays(file), file.name)


def _jobs(root: Path) -> Iterator[Target]:
    folder = root / "jobs"
    folder.mkdir()
    result, cameras = room(), [view.camera for view in read_views(root / "nerfstudio")]
    turn = {"turns": 1, "center": [0, 0, 0]}
    lights = {
        "recovered": {"all": {"off": True}, "3": {"scale": 2.0, "color": [1, 0.8, 0.5]}},
        "outside": {"keys": [[0, 0.5], [1, 1.0]]},
        "camera": {"view": 1, "orbit": {"center": [1, 1, 1], "turns": 1}},
        "lights": [
            {"type": "area", "center": [0, 0, 2], "direction": [0, 0, -1], "radiance": 3, "turntable": turn},
            {"type": "spot", "position": [0, 0, 2], "target": [0, 0, 0], "intensity": [1, 1, 1], "angle": 40},
            {"type": "point", "position": {"keys": [[0, [0, 0, 1]], [1, [0, 0, 2]]]}, "intensity": 1},
            {"type": "sun", "direction": [0, 0, -1], "irradiance": 1},
            {"type": "hdri", "file": "sky.exr", "rotation": 10},
            {"type": "mesh", "shape": "box", "size": 0.1, "location": [0, 0, 1], "radiance": 2},
        ],
    }  # fmt: skip
    objects = {
        "objects": [
            {"shape": "sphere", "radius": 0.1, "pixel": [10, 10], "base_color": 0.5, "roughness": 0.2},
            {"file": "chair.glb", "location": [0, 0, 0], "rotation": [0, 0, 90], "height": 1, "snap": "down"},
            {"shape": "sphere", "center": [0, 0, 1], "radius": 0.1},
        ],
        "lights": lights["lights"][:2],
        "camera": {"path": [0, 1]},
    }
    (folder / "lights.json").write_text(json.dumps(lights))
    (folder / "objects.json").write_text(json.dumps(objects))
    (folder / "jobs.toml").write_text(
        '[[job]]\ncapture = "a"\nname = "b"\nseed = 3\n[[job]]\ncapture = "c"\npreset = "draft"\n'
    )

    def relit() -> None:
        job = read_json(folder / "lights.json")
        with _naming(folder / "lights.json"):
            for moment in (0.0, 0.5):
                relight_edit(result, job, folder, moment)
                camera_at(
                    job.get("camera", {}) if isinstance(job.get("camera", {}), dict) else {}, cameras, result.up, moment
                )

    def inserted() -> None:
        job = read_json(folder / "objects.json")
        with _naming(folder / "objects.json"):
            insertion_edits(result, job, folder, cameras, 0.5)

    yield from files("relight", folder, relit, "lights.json")
    yield from files("insert", folder, inserted, "objects.json")
    yield from files("batch", folder, lambda: batch.read_jobs(folder / "jobs.toml"), "jobs.toml")

    shares = root / "shares"
    write_shares(shares / "a.exr", LightShares(np.ones((4, 6, 3), np.float32), {"x": np.ones((4, 6, 3), np.float32)}))
    yield from files("shares", shares, lambda: read_shares(shares / "a.exr"), "a.exr")

    pictures = root / "pictures"
    write_png(pictures / "a.png", np.zeros((4, 6), np.uint8))
    Image.new("RGB", (6, 4)).save(pictures / "a.jpg")
    write_exr(pictures / "a.exr", np.zeros((4, 6, 3)))
    (pictures / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 6\n" + bytes(96))
    for file in ("a.png", "a.jpg", "a.exr", "a.hdr"):
        yield from files("header", pictures, lambda file=file: announced_size(pictures / file), file)
    for file in ("a.png", "a.jpg"):
        yield from files("pixels", pictures, lambda file=file: read_image(pictures / file), file)

    frames = root / "frames"
    open_frames(frames, 3, ".png", {})
    (frames / "job-solve.json").write_text('{"state": "done", "what": "", "fix": "", "time": 1.0}')
    yield from files("frames", frames, lambda: open_frames(frames, 3, ".png", {}), "frames.json")
    yield from files("record", frames, lambda: jobs.record("solve", frames), "job-solve.json")
