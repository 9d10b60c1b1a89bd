"""Good files of photo formats, depth, sparse points, packed meshes, ground truth, checks, and rooms with every map."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pillow_heif
from PIL import Image

from headless import cli
from headless.batch import run_batch
from iris_addon.base.images import read_map, write_exr
from iris_addon.base.progress import Progress
from iris_addon.blender.scene_in.capture_objects import read_inspected
from iris_addon.blender.scene_in.scene_capture import read_face_runs, read_view_cameras
from iris_addon.capture.colmap import read_colmap_points
from iris_addon.capture.depth_maps import posed_depth
from iris_addon.capture.inspection import inspect
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.capture.photo_files import check_photo, read_device, read_orientation, read_photo
from iris_addon.capture.reader import read_capture
from iris_addon.evaluate.ground_truth import read_ground_truth, read_lights, read_objects, read_sun
from iris_addon.lighting.candidates import read_given_emitters
from iris_addon.results.folder import load_result, read_coverage, save_result
from tests.box_room import HEIGHT, WIDTH, write_fipt_room, write_nerfstudio_room
from tests.capture.test_glb_geometry import BOX_POSITIONS, BOX_TRIANGLES, STEP, UINT, USHORT, Glb
from tests.capture.test_mesh_files import draco_glb
from tests.capture.test_photo_files import matrix_profile
from tests.program_cameras import write_scannet, write_tum
from tests.results.test_folder import patterned, with_backdrop
from tests.sparse_points import write_points

from .checks import Target, files

CODES = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def more_targets(root: Path) -> Iterator[Target]:
    """Further kinds of files, in folders below ``root``."""
    yield from _photos(root / "photos")
    yield from _depth(root / "depth")
    yield from _points(root / "points")
    yield from _packed_meshes(root / "packed")
    yield from _rooms(root / "rooms")
    yield from _truth(root / "truth")
    yield from _checks(root / "checks")
    yield from _lines(root / "lines")


def _photos(folder: Path) -> Iterator[Target]:
    folder.mkdir()
    image = Image.fromarray(CODES)
    pillow_heif.register_heif_opener()
    image.save(folder / "a.webp", lossless=True)
    image.save(folder / "a.tif", compression="tiff_lzw")
    image.save(folder / "a.bmp")
    image.save(folder / "a.avif")
    image.save(folder / "a.heic", format="HEIF")
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "Maker"
    image.save(
        folder / "wide.jpg", exif=exif, icc_profile=matrix_profile([(0.68, 0.32), (0.265, 0.69), (0.15, 0.06)], 2.2)
    )
    (folder / "deep.tif").write_bytes(deep_tiff())
    (folder / "a.dng").write_bytes(_dng())
    for name in ("a.webp", "a.tif", "a.bmp", "a.avif", "a.heic", "wide.jpg", "deep.tif", "a.dng"):

        def read(path: Path = folder / name) -> None:
            check_photo(path)
            read_photo(path)
            read_orientation(path)
            read_device(path)

        yield from files("photo", folder, read, name)


def _tiff(entries: list[tuple[int, int, bytes]], pixels: bytes) -> bytes:
    """A little-endian TIFF of one strip; ``entries`` are (tag, type, values), without the place of the strip."""
    size = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 10: 8}
    entries = sorted([*entries, (273, 4, b"\0\0\0\0"), (279, 4, struct.pack("<I", len(pixels)))])
    end, table, extra = 8 + 2 + 12 * len(entries) + 4, b"", b""
    for tag, kind, values in entries:
        if len(values) > 4:
            place = struct.pack("<I", end + len(extra))
            extra += values + b"\0" * (len(values) % 2)
        else:
            place = values.ljust(4, b"\0")
        table += struct.pack("<HHI", tag, kind, len(values) // size[kind]) + place
    strip = struct.pack("<HHI", 273, 4, 1)
    table = table.replace(strip + b"\0\0\0\0", strip + struct.pack("<I", end + len(extra)))
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + table + b"\0\0\0\0" + extra + pixels


def _short(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}H", *values)


def deep_tiff() -> bytes:
    """A photo of 16 bits per channel."""
    shape = [(256, 3, _short(WIDTH)), (257, 3, _short(HEIGHT)), (258, 3, _short(16, 16, 16)), (259, 3, _short(1))]
    rest = [(262, 3, _short(2)), (277, 3, _short(3)), (278, 3, _short(HEIGHT)), (284, 3, _short(1))]
    return _tiff([*shape, *rest], (CODES.astype("<u2") * 257).tobytes())


def _dng() -> bytes:
    """Bayer pixels of a camera whose primaries are nearly XYZ's."""
    shape = [(256, 4, struct.pack("<I", WIDTH)), (257, 4, struct.pack("<I", HEIGHT)), (258, 3, _short(16))]
    bayer = [(259, 3, _short(1)), (262, 3, _short(32803)), (277, 3, _short(1)), (278, 4, struct.pack("<I", HEIGHT))]
    bayer += [(33421, 3, _short(2, 2)), (33422, 1, bytes([0, 1, 1, 2])), (254, 4, struct.pack("<I", 0))]
    matrix = [1, 0, 0, 0, 1, 0, 0, 0, 1]
    dng = [(50706, 1, bytes([1, 4, 0, 0])), (50708, 2, b"Made by a test\0"), (50717, 3, _short(65535))]
    dng += [(50721, 10, b"".join(struct.pack("<ii", v, 1) for v in matrix)), (271, 2, b"Maker\0"), (272, 2, b"Model\0")]
    dng += [(50728, 5, struct.pack("<IIIIII", 1, 1, 1, 1, 1, 1)), (50778, 3, _short(21))]
    return _tiff([*shape, *bayer, *dng], (CODES[..., 1].astype("<u2") * 257).tobytes())


def _depth(folder: Path) -> Iterator[Target]:
    """Depth of each format beside the photos of a room, all of it two metres away."""
    millimetres = Image.fromarray(np.full((HEIGHT, WIDTH), 2000, np.uint16))
    nerfstudio = write_nerfstudio_room(folder / "nerfstudio")
    nerfstudio.meta["depth_unit_scale_factor"] = 0.001
    for k, frame in enumerate(nerfstudio.meta["frames"]):
        frame["depth_file_path"] = f"images/depth{k}.{'npy' if k == 0 else 'png'}"
        millimetres.save(nerfstudio.root / "images" / f"depth{k}.png")
    np.save(nerfstudio.root / "images" / "depth0.npy", np.full((HEIGHT, WIDTH), 2000.0))
    nerfstudio.save()
    scannet, tum = write_nerfstudio_room(folder / "scannet"), write_nerfstudio_room(folder / "tum")
    for made, write in ((scannet, write_scannet), (tum, write_tum)):
        expected = read_capture(made.root)
        made.transforms.unlink()
        write(made.root, expected)
        (made.root / "depth").mkdir()
        for photo in made.photos:
            millimetres.save(made.root / "depth" / photo.name)
    (scannet.root / "intrinsic" / "intrinsic_depth.txt").write_bytes(
        (scannet.root / "intrinsic" / "intrinsic_color.txt").read_bytes()
    )
    listed = [line.replace("rgb/", "depth/") for line in (tum.root / "rgb.txt").read_text().splitlines()]
    (tum.root / "depth.txt").write_text("\n".join(listed))

    def read(where: Path) -> None:
        for depth in posed_depth(where)[:3]:
            depth.read()

    for made, names in (
        (nerfstudio, ("transforms.json", "images/depth0.npy", "images/depth1.png")),
        (scannet, ("intrinsic/intrinsic_depth.txt", "depth/001.png")),
        (tum, ("depth.txt", "depth/001.png")),
    ):
        yield from files(f"depth-{made.root.name}", made.root, lambda where=made.root: read(where), *names)


def _points(folder: Path) -> Iterator[Target]:
    for kind in ("txt", "bin"):
        (folder / kind).mkdir(parents=True)
    points = np.random.default_rng(1).random((20, 3))
    write_points(folder / "txt" / "points3D.txt", points)
    packed = struct.pack("<Q", len(points))
    for k, point in enumerate(points):
        packed += struct.pack("<Q3d3BdQ2I", k, *point, 1, 2, 3, 0.5, 1, k, 2)
    (folder / "bin" / "points3D.bin").write_bytes(packed)
    for kind in ("txt", "bin"):
        yield from files(
            "points", folder / kind, lambda kind=kind: read_colmap_points(folder / kind), f"points3D.{kind}"
        )


def _packed_meshes(folder: Path) -> Iterator[Target]:
    folder.mkdir()
    made = Glb()
    made.use("KHR_mesh_quantization")
    made.use("EXT_mesh_gpu_instancing")
    place = made.accessor(made.packed(BOX_POSITIONS, 8, 8, "ATTRIBUTES"), USHORT, 8, "VEC3")
    made.mesh(place, made.accessor(made.packed(BOX_TRIANGLES, 36, 4, "TRIANGLES"), UINT, 36, "SCALAR"))
    shifts = made.array(np.array([[0, 0, 0], [5, 0, 0]], "<f4"), 5126, "VEC3")
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": shifts}}}
    made.document["nodes"] = [{"mesh": 0, "scale": [STEP] * 3, "extensions": instances}]
    made.save(folder / "meshopt.glb")
    (folder / "draco.glb").write_bytes(draco_glb())
    for name in ("meshopt.glb", "draco.glb"):
        yield from files("packed", folder, lambda name=name: read_mesh(folder / name), name)


def _rooms(folder: Path) -> Iterator[Target]:
    """A result with everything that a result may have beside that of every room."""
    result, behind = patterned(), with_backdrop()
    coverage = np.ones(result.textures.roughness.shape, np.float32)
    result = replace(
        result,
        textures=replace(result.textures, coverage=coverage),
        backdrop=behind.backdrop,
        panes=np.array([4, 5]),
    )
    save_result(result, folder)
    names = ("materials/lamp_pattern.exr", "backdrop.exr", "backdrop_albedo.exr", "emitters.json")
    yield from files("whole", folder, lambda: load_result(folder), *names)
    yield from files(
        "coverage", folder, lambda: read_coverage(folder, lambda path: read_map(path) / 255.0), "materials/coverage.png"
    )
    given = folder / "given.json"
    given.write_text(json.dumps({"emitters": [{"faces": [[10, 12]]}, {"faces": [[0, 1], [2, 4]]}]}))
    yield from files("given", folder, lambda: read_given_emitters(given, np.ones(12)), "given.json")


def _truth(folder: Path) -> Iterator[Target]:
    fipt = write_fipt_room(folder).root
    (fipt / "train" / "DiffCol").mkdir()
    write_exr(fipt / "train" / "DiffCol" / "000_0001.exr", CODES / 255.0)
    for name in ("relight", "insert"):
        (fipt / name).mkdir()
    sun = {"direction": [0, 0, -1], "irradiance": [1, 1, 1], "angle": 0.5}
    (fipt / "meta_gt.json").write_text(json.dumps({"suns": [sun]}))
    (fipt / "relight" / "lights.json").write_text(json.dumps({"lights": []}))
    (fipt / "insert" / "objects.json").write_text(json.dumps({"objects": []}))

    def read() -> None:
        truth = read_ground_truth(fipt)
        assert truth is not None
        for reader in (read_sun, read_lights, read_objects):
            reader(truth)
        truth.map("DiffCol", "train", 0)

    yield from files("truth", fipt, read, "meta_gt.json", "relight/lights.json", "insert/objects.json")


def _checks(folder: Path) -> Iterator[Target]:
    """What a check of a capture writes and Blender reads."""
    folder.mkdir()
    capture = write_nerfstudio_room(folder / "room").root
    inspect(read_capture(capture), folder / "check", Progress())
    names = ("check/capture.json", "check/mesh.npz")
    yield from files("check", folder, lambda: read_inspected(folder / "check"), *names)
    run = {"object": "Cube", "start": 0, "stop": 12, "instance": False, "to_capture": np.eye(4).tolist()}
    (folder / "scene_map.json").write_text(json.dumps({"runs": [run], "cameras": {"000": "Camera"}}))

    def read_map() -> None:
        read_face_runs(folder)
        read_view_cameras(folder)

    yield from files("scene", folder, read_map, "scene_map.json")


def _lines(folder: Path) -> Iterator[Target]:
    """What tasks of a farm leave behind for the summary."""
    (folder / "jobs" / "lines").mkdir(parents=True)
    (folder / "jobs.toml").write_text('[[job]]\ncapture = "a"\n[[job.frames]]\nframes = "1-3"\n')
    line = {"name": "a", "preset": "draft", "status": "done", "wall_seconds": 1.5, "figures": {"frames": 3}}
    (folder / "jobs" / "lines" / "a.json").write_text(json.dumps({**line, "metrics": {"kd_psnr": 20.0}, "out": "a"}))
    args = cli.make_parser().parse_args(["batch", str(folder / "jobs.toml"), "--summary"])
    yield from files("lines", folder, lambda: run_batch(args, Progress()), "jobs/lines/a.json", "jobs.toml")
