"""Good files of photogrammetry programs, RGB-D data sets, polygons, brackets of EXR and farms, with their readers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from headless.job_file import read_jobs
from iris_addon.base.images import read_image, write_exr
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture, read_views
from tests.box_room import write_nerfstudio_room
from tests.program_cameras import (
    write_arkit_scenes,
    write_bundler,
    write_meshroom,
    write_metashape,
    write_openmvg,
    write_polycam,
    write_reality_scan,
    write_record3d,
    write_scannet,
    write_scannetpp,
    write_sidecars,
    write_tum,
)

from .checks import Target, files

WRITTEN = (
    (write_metashape, ("cameras.xml",)),
    (write_meshroom, ("sfm.sfm",)),
    (write_openmvg, ("sfm_data.json",)),
    (write_reality_scan, ("cameras.csv",)),
    (write_sidecars, ("images/001.xmp", "images/002.xmp")),
    (write_bundler, ("bundle.out", "list.txt")),
    (write_scannet, ("intrinsic/intrinsic_color.txt", "pose/001.txt")),
    (write_tum, ("rgb.txt", "groundtruth.txt", "calibration.txt")),
    (write_scannetpp, ("dslr/nerfstudio/transforms.json",)),
    (write_polycam, ("mesh_info.json", "keyframes/corrected_cameras/001.json")),
    (write_record3d, ("metadata.json",)),
    (write_arkit_scenes, ("lowres_wide.traj", "lowres_wide_intrinsics/41069021_11.001.pincam")),
)
"""What writes a room as a program does, and which of its files are damaged."""
JOBS = """
[[job]]
capture = "/mnt/rooms/a"
name = "b"
exposures = "none"
[[job.frames]]
command = "relight"
lights = "lights.json"
frames = "1-120"
chunk = 7
fps = 24
exposure = "auto"
[[job.frames]]
name = "still"
views = "cameras.json"
frames = "3"
samples = 16
gpu = true
"""
CORNERS = [[0, 0, 0], [4, 0, 0], [4, 0, 3], [2, 0, 1], [0, 0, 3], [4, 3, 0], [0, 3, 0]]
POLYGONS = [[0, 1, 2, 3, 4], [0, 6, 5, 1], [1, 5, 2], [0, 4, 6]]
"""A concave wall of five corners beside a floor of four and triangles."""


def camera_targets(root: Path) -> Iterator[Target]:
    """Cameras, meshes, photos and jobs of other programs, in folders below ``root``."""
    for write, names in WRITTEN:
        name = write.__name__.removeprefix("write_").replace("_", "")
        room = write_nerfstudio_room(root / name)
        expected = read_capture(room.root)
        room.transforms.unlink()
        write(room.root, expected)

        def read(folder: Path = room.root) -> None:
            read_capture(folder)
            read_views(folder)

        yield from files(name, room.root, read, *names)
    yield from _polygons(root / "polygons")
    yield from _brackets(root / "brackets")
    yield from _jobs(root / "farm")


def _polygons(folder: Path) -> Iterator[Target]:
    folder.mkdir()
    faces = "".join(f"f {' '.join(f'{k + 1}/{k + 1}/1' for k in polygon)}\n" for polygon in POLYGONS)
    corners = "".join(f"v {x} {y} {z}\nvt {x} {z}\n" for x, y, z in CORNERS)
    (folder / "room.obj").write_text(f"mtllib room.mtl\no room\nvn 0 0 1\n{corners}usemtl wall\n{faces}")
    head = (
        f"element vertex {len(CORNERS)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(POLYGONS)}\nproperty list uchar int vertex_indices\nproperty uchar red\nend_header\n"
    )
    lines = [" ".join(map(str, corner)) for corner in CORNERS]
    lines += [f"{len(polygon)} {' '.join(map(str, polygon))} 7" for polygon in POLYGONS]
    (folder / "text.ply").write_text(f"ply\nformat ascii 1.0\n{head}" + "\n".join(lines) + "\n")
    body = np.array(CORNERS, "<f4").tobytes()
    for polygon in POLYGONS:
        body += bytes([len(polygon)]) + np.array(polygon, "<i4").tobytes() + b"\x07"
    (folder / "binary.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n" + head.encode() + body)
    for name in ("room.obj", "text.ply", "binary.ply"):
        yield from files("polygons", folder, lambda name=name: read_mesh(folder / name), name)


def _brackets(folder: Path) -> Iterator[Target]:
    """Photos whose radiance lies in EXR beside them, one of them of a light that others clip."""
    room = write_nerfstudio_room(folder)
    for number, photo in enumerate(room.photos):
        write_exr(folder / "hdr" / f"{photo.stem}.exr", read_image(photo)[..., :3] / 255.0 * 4.0**number)

    def read() -> None:
        load_photo(read_capture(folder, hdr=folder / "hdr").views[5])

    yield from files("brackets", folder, read, "hdr/000.exr", "hdr/005.exr")


def _jobs(folder: Path) -> Iterator[Target]:
    folder.mkdir()
    (folder / "jobs.toml").write_text(JOBS)
    rule = {"source_path_format": "POSIX", "source_path": "/mnt/rooms", "destination_path": "/srv/rooms"}
    (folder / "rules.json").write_text(
        f'{{"version": "pathmapping-1.0", "path_mapping_rules": [{str(rule)!s}]}}'.replace("'", '"')
    )
    yield from files("farm", folder, lambda: read_jobs(folder / "jobs.toml", folder / "rules.json"), "rules.json")
    yield from files("farm", folder, lambda: read_jobs(folder / "jobs.toml"), "jobs.toml")
