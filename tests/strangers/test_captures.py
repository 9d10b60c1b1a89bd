"""Captures made to break their reader: refused by one line that names the file, before anything large is allocated."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.base.glb_chunks import pack_chunks
from iris_addon.base.image_headers import announced_size
from iris_addon.base.images import check_image, exr_size, read_exr, write_exr
from iris_addon.capture.colmap import colmap_model, read_colmap_views
from iris_addon.capture.listing import inside, safe_name
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.capture.reader import read_capture
from tests.blender_home import ROOT
from tests.box_room import RoomCapture, box_mesh, write_mesh
from tests.capture.test_mesh_files import draco_glb
from tests.colmap_model import camera_of, poses, write_text
from tests.strangers.more_files import deep_tiff

LITTLE = 60 << 20
"""Bytes that no refusal allocates."""


def refused(call: Callable[..., object], *arguments: object, **options: object) -> str:
    """The message of the refusal: one line, with the way out, and made without much memory."""
    tracemalloc.start()
    try:
        with pytest.raises(BadInput) as caught:
            call(*arguments, **options)
        assert tracemalloc.get_traced_memory()[1] < LITTLE
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert " — " in message and message.isprintable()
    return message


# ---- photos ---------------------------------------------------------------------------------------------------------


def exr_of(path: Path, *sizes: tuple[int, int], channels: str = "RGB") -> None:
    """An EXR of one part per (height, width), all zero, which compresses to next to nothing."""
    window = (np.zeros(2, np.int32), np.array([63, 47], np.int32))  # the one attribute that all parts share
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "displayWindow": window}
    parts = [
        OpenEXR.Part(dict(header), {channels: np.zeros((*size, len(channels)), np.float16)}, f"part {k}")
        for k, size in enumerate(sizes)
    ]
    OpenEXR.File(parts).write(str(path))


def test_parts_of_an_exr_behind_the_picture_are_not_decoded(tmp_path: Path) -> None:
    exr_of(tmp_path / "a.exr", (48, 64), *[(2000, 2000)] * 4)
    assert "a.exr: has far larger parts" in refused(read_exr, tmp_path / "a.exr")


def test_sizes_of_all_parts_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exr_of(tmp_path / "a.exr", (48, 64), (48, 64), (40, 64))
    assert exr_size(tmp_path / "a.exr") == (64, 48) and read_exr(tmp_path / "a.exr").shape == (48, 64, 3)
    monkeypatch.setattr("iris_addon.base.image_headers.MAX_EXR_SAMPLES", 3 * 64 * 100)
    assert "million samples" in refused(read_exr, tmp_path / "a.exr")


def test_a_size_of_an_exr_is_that_of_the_part_that_is_read(tmp_path: Path) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    depth = OpenEXR.Part(dict(header), {"Z": np.zeros((20, 30), np.float32)}, "depth")
    colour = OpenEXR.Part(dict(header), {"RGB": np.ones((20, 30, 3), np.float32)}, "colour")
    OpenEXR.File([depth, colour]).write(str(tmp_path / "a.exr"))
    assert exr_size(tmp_path / "a.exr") == (30, 20) and read_exr(tmp_path / "a.exr").shape == (20, 30, 3)


def test_headers_announce_what_libraries_decode(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", np.zeros((20, 30, 3)))
    hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 20 +X 30\n" + bytes([128, 128, 128, 128]) * 600
    (tmp_path / "a.hdr").write_bytes(hdr)
    from PIL import Image

    for name in ("a.png", "a.jpg"):
        Image.new("RGB", (30, 20)).save(tmp_path / name)
    for name in ("a.exr", "a.hdr", "a.png", "a.jpg"):
        assert announced_size(tmp_path / name) == (30, 20)
    Image.new("RGB", (3, 2)).save(tmp_path / "a.bmp")
    assert "not an image" in refused(announced_size, tmp_path / "a.bmp")


def png(*chunks: tuple[bytes, bytes]) -> bytes:
    whole = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + whole


HEADER = (b"IHDR", struct.pack(">IIBBBBB", 32, 24, 8, 2, 0, 0, 0))


@pytest.mark.parametrize("chunks", [[HEADER, (b"IEND", b"")], [HEADER], [HEADER, (b"iDAT", b"x"), (b"IEND", b"")]])
def test_a_png_without_pixels_is_named(nerfstudio_room: RoomCapture, chunks: list[tuple[bytes, bytes]]) -> None:
    nerfstudio_room.photos[3].write_bytes(png(*chunks))
    assert "003.png" in refused(read_capture, nerfstudio_room.save())
    assert "003.png" in refused(check_image, nerfstudio_room.photos[3])


# ---- numbers --------------------------------------------------------------------------------------------------------

HUGE = int("9" * 400)


@pytest.mark.parametrize(
    "change",
    [
        lambda meta: meta.update(fl_x=HUGE),
        lambda meta: meta.update(w=HUGE),
        lambda meta: meta.update(k1=-HUGE),
        lambda meta: meta.update(applied_transform=[[HUGE] * 4] * 3),
        lambda meta: meta.update(applied_scale=HUGE),
        lambda meta: meta["frames"][1].update(exposure=HUGE),
        lambda meta: meta["frames"][1].update(transform_matrix="1"),
        lambda meta: meta["frames"][1].update(transform_matrix=[["1"] * 4] * 4),
    ],
)
def test_integers_of_any_length_are_no_numbers(nerfstudio_room: RoomCapture, change: Callable) -> None:
    change(nerfstudio_room.meta)
    assert "transforms.json" in refused(read_capture, nerfstudio_room.save())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("far", [1e308, 1e30, -1e12])
def test_cameras_and_meshes_far_away_are_refused(nerfstudio_room: RoomCapture, far: float) -> None:
    near = json.loads(json.dumps(nerfstudio_room.meta))
    for frame in nerfstudio_room.meta["frames"]:
        frame["transform_matrix"][0][3] = far
    assert "beyond 1e+09" in refused(read_capture, nerfstudio_room.save())
    nerfstudio_room.meta = near
    lines = [f"v {far} 0 0", f"v {far} 1 0", f"v {far} 0 1", "f 1 2 3"]
    (nerfstudio_room.root / "mesh.ply").unlink()
    (nerfstudio_room.root / "mesh.obj").write_text("\n".join(lines))
    assert "mesh.obj: has 3 vertices" in refused(read_capture, nerfstudio_room.save())


@pytest.mark.parametrize(
    "content",
    [b"a,1\n" + b"x" * 200_000 + b",1\n", b'"' * 300_000, b"name,exposure\n000,1e400\n", b"h\n000," + b"9" * 5000],
)
def test_tables_of_exposures_that_are_none_are_named(nerfstudio_room: RoomCapture, content: bytes) -> None:
    table = nerfstudio_room.root / "e.csv"
    table.write_bytes(content)
    assert "e.csv" in refused(read_capture, nerfstudio_room.save(), exposures=table)


# ---- paths ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("named", ["//server/share/x", "\\\\server\\share\\x", "/outside/x", "a/../../x", "../x"])
def test_a_path_out_of_the_capture_is_refused_before_the_disk_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str
) -> None:
    def touched(path: Path, *_: object, **__: object) -> None:
        raise AssertionError(f"{path} is touched")

    for method in ("stat", "lstat", "resolve", "is_file", "exists", "open"):
        monkeypatch.setattr(Path, method, touched)
    assert "outside the capture" in refused(inside, tmp_path, named, tmp_path / "transforms.json")


@pytest.mark.parametrize("named", [".", "..", "./", "images", "\0", "x" * 5000, "a" * 250])
def test_a_name_that_is_no_photo_is_one_line(nerfstudio_room: RoomCapture, named: str) -> None:
    for k in (1, 2):  # twice the same stem, so that whole paths are looked at
        nerfstudio_room.meta["frames"][k]["file_path"] = named
    assert "transforms.json" in refused(read_capture, nerfstudio_room.save())


def test_names_of_views_can_be_names_of_files() -> None:
    assert len(safe_name("漢" * 300).encode()) <= 200 and safe_name("\ud800") == "view"


def test_a_model_given_by_its_folder_does_not_reach_further_up(nerfstudio_room: RoomCapture) -> None:
    capture = read_capture(nerfstudio_room.save())
    for folder, found in (("sparse/0", True), ("colmap/sparse/0", True), ("Downloads/evil", False)):
        model = nerfstudio_room.root / folder
        model.mkdir(parents=True)
        write_text(model, camera_of(capture), poses(capture))
        photos = [view.photo for view in read_colmap_views(model, colmap_model(model) or model)]
        assert all((photo is not None) == found for photo in photos)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_photo_may_not_be_a_pipe_or_a_link_out(nerfstudio_room: RoomCapture, tmp_path: Path) -> None:
    photo = nerfstudio_room.photos[1]
    photo.rename(tmp_path / "secret.png")
    photo.symlink_to(tmp_path / "secret.png")
    assert "outside the capture" in refused(read_capture, nerfstudio_room.save())


# ---- meshes ---------------------------------------------------------------------------------------------------------


def glb(path: Path, accessors: list[dict], nodes: int = 1, attributes: dict | None = None) -> None:
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [{"attributes": attributes or {"POSITION": 0}}]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteLength": 36_000}],
        "buffers": [{"byteLength": 36_000}],
    }
    path.write_bytes(pack_chunks(document, np.random.default_rng(0).random(9000, np.float32).tobytes()))


def test_a_glb_of_zeros_that_are_not_in_it_is_refused(tmp_path: Path) -> None:
    glb(tmp_path / "a.glb", [{"componentType": 5126, "count": 250_000_000, "type": "VEC3"}])
    assert "a.glb: announces more numbers" in refused(read_mesh, tmp_path / "a.glb")


def test_a_glb_that_repeats_its_mesh_is_refused(tmp_path: Path) -> None:
    glb(tmp_path / "a.glb", [{"bufferView": 0, "componentType": 5126, "count": 3000, "type": "VEC3"}], nodes=3000)
    assert "a.glb: repeats its meshes" in refused(read_mesh, tmp_path / "a.glb")


@pytest.mark.parametrize("count", [-1, 1e9, "3000", None, True])
def test_a_glb_with_a_count_that_is_none_is_refused(tmp_path: Path, count: object) -> None:
    glb(tmp_path / "a.glb", [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}])
    assert "a.glb" in refused(read_mesh, tmp_path / "a.glb")


def test_pictures_in_a_glb_are_not_decoded(tmp_path: Path) -> None:
    import trimesh
    from PIL import Image

    picture = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4)))
    uv = np.random.default_rng(0).random((8, 2))
    mesh = trimesh.Trimesh(box_mesh().vertices, box_mesh().faces, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=picture)
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    at = data.index(b"IHDR") + 4
    (tmp_path / "a.glb").write_bytes(data[:at] + struct.pack(">II", 60000, 60000) + data[at + 8 :])
    read, _ = read_mesh(tmp_path / "a.glb")
    assert len(read.faces) == 12


def test_a_ply_that_names_a_texture_is_read_in_silence(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    write_mesh(tmp_path / "a.ply", box_mesh())
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data.replace(b"element vertex", b"comment TextureFile no.png\nelement vertex", 1))
    assert len(read_mesh(tmp_path / "a.ply")[0].faces) == 12
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("damage", ["draco", "tiff"])
def test_what_libraries_log_of_a_damaged_file_is_not_printed(tmp_path: Path, damage: str) -> None:
    """A process of its own: pytest listens to all logs."""
    path = tmp_path / ("a.glb" if damage == "draco" else "a.tif")
    if damage == "draco":
        pytest.importorskip("DracoPy")
        path.write_bytes(draco_glb().replace(b'"attributes": {"POSITION": 0}}', b'"attributes": [ "POSITION"  ]}'))
    else:
        samples = struct.pack("<HHI", 277, 3, 1)
        path.write_bytes(deep_tiff().replace(samples + b"\x03\0", samples + b"\0\x80"))
    code = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from iris_addon.base.errors import BadInput
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.capture.photo_files import read_photo
try:
    {"read_mesh" if damage == "draco" else "read_photo"}(Path({str(path)!r}))
except BadInput as error:
    print(error)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ran.stderr == "" and ran.stdout.count("\n") == 1 and path.name in ran.stdout, ran


@pytest.mark.parametrize("count", ["9" * 5000, "9" * 30, "-1", "x"])
def test_a_ply_with_a_count_that_is_none_is_refused(nerfstudio_room: RoomCapture, count: str) -> None:
    mesh = nerfstudio_room.root / "mesh.ply"
    mesh.write_bytes(mesh.read_bytes().replace(b"element vertex 8", f"element vertex {count}".encode()))
    assert "mesh.ply" in refused(read_mesh, mesh)
    assert "mesh.ply" in refused(read_capture, nerfstudio_room.save())


def test_names_out_of_files_stay_on_one_line(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta["camera_model"] = "X\nerror: spoofed\x1b[31m"
    assert "ERROR: SPOOFED" in refused(read_capture, nerfstudio_room.save())
