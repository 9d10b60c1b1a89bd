"""Meshes as exporters write them: mixed and concave polygons, doubled faces, compressed GLBs."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from iris_addon.base.errors import BadInput
from iris_addon.capture.mesh_files import face_areas, read_mesh
from iris_addon.rays.tracer import Tracer
from tests.box_room import box_mesh, write_mesh

WALL = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 3], [0, 0, 3]], float)
HOLE = np.array([[1, 0, 1], [1, 0, 2], [2, 0, 2], [2, 0, 1]], float)
FLOOR = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]], float)
"""An L of 3 square metres."""
POINTS = np.concatenate([WALL, HOLE, FLOOR + [0, 1, 0]])
POLYGONS = [
    [0, 4, 5, 6, 7, 4, 0, 1, 2, 3],  # the wall, its hole reached by a bridge from its first corner
    [8, 9, 10, 11, 12, 13],
    [0, 1, 9],
    [0, 8, 9, 1],
]


def write_ply(path: Path, form: str, points: np.ndarray = POINTS, polygons: list[list[int]] = POLYGONS) -> None:
    """With a colour per vertex and a flag per face, as programs add them."""
    head = f"ply\nformat {form} 1.0\ncomment made by a test\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "property uchar red\n"
    head += f"element face {len(polygons)}\nproperty list uchar uint vertex_indices\nproperty uchar flag\nend_header\n"
    if form == "ascii":
        rows = [" ".join(f"{c:.17g}" for c in point) + " 7" for point in points]
        rows += [" ".join(str(x) for x in (len(p), *p)) + " 1" for p in polygons]
        path.write_text(head + "\n".join(rows) + "\n")
        return
    order = "<" if "little" in form else ">"
    data = b"".join(struct.pack(order + "3fB", *point, 7) for point in points)
    data += b"".join(struct.pack(f"{order}B{len(p)}IB", len(p), *p, 1) for p in polygons)
    path.write_bytes(head.encode() + data)


def write_obj(path: Path) -> None:
    rows = [f"v {x} {y} {z}" for x, y, z in POINTS] + ["f " + " ".join(str(k + 1) for k in p) for p in POLYGONS]
    path.write_text("\n".join(rows) + "\n")


@pytest.fixture(params=["ascii", "binary_little_endian", "binary_big_endian", "obj"])
def room_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / ("a.obj" if request.param == "obj" else "a.ply")
    if request.param == "obj":
        write_obj(path)
    else:
        write_ply(path, request.param)
    return path


def test_concave_polygons_and_holes_keep_their_area(room_file: Path) -> None:
    mesh, _ = read_mesh(room_file)
    per_polygon = [len(p) - 2 for p in POLYGONS]
    assert len(mesh.faces) == sum(per_polygon)
    areas = face_areas(mesh)
    assert areas[: per_polygon[0]].sum() == pytest.approx(11)
    assert areas[per_polygon[0] : per_polygon[0] + per_polygon[1]].sum() == pytest.approx(3)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_the_material_of_a_polygon_is_the_region_of_its_triangles(tmp_path: Path, form: str) -> None:
    write_ply(tmp_path / "a.ply", form)
    content = (tmp_path / "a.ply").read_bytes().replace(b"property uchar flag", b"property uchar material_index")
    (tmp_path / "a.ply").write_bytes(content)
    assert read_mesh(tmp_path / "a.ply")[0].regions is None  # one material
    materials, per_polygon = [7, 3, 7, *(3 for _ in POLYGONS[3:])], [len(p) - 2 for p in POLYGONS]
    if form == "ascii":
        lines = content.decode().splitlines()
        lines[-len(POLYGONS) :] = [
            f"{line.rpartition(' ')[0]} {material}"
            for line, material in zip(lines[-len(POLYGONS) :], materials, strict=True)
        ]
        (tmp_path / "a.ply").write_text("\n".join(lines) + "\n")
    else:
        data, end = bytearray(content), len(content)
        for polygon, material in zip(reversed(POLYGONS), reversed(materials), strict=True):
            data[end - 1] = material
            end -= 1 + 4 * len(polygon) + 1
        (tmp_path / "a.ply").write_bytes(data)
    regions = read_mesh(tmp_path / "a.ply")[0].regions
    assert regions is not None
    assert regions.tolist() == np.repeat([0 if material == 7 else 1 for material in materials], per_polygon).tolist()


def test_a_ray_through_a_window_leaves_the_room(room_file: Path) -> None:
    mesh, _ = read_mesh(room_file)
    hits = Tracer(mesh).closest(np.array([[1.5, -1, 1.5], [3.5, -1, 1.5]]), np.array([[0, 1.0, 0], [0, 1, 0]]))
    assert hits.face[0] == -1 and hits.face[1] >= 0


def test_triangles_keep_the_orientation_of_their_polygon(room_file: Path) -> None:
    normals = Tracer(read_mesh(room_file)[0]).normals
    assert (normals[8:12] @ [0, 0, 1] > 0.99).all()


def test_concave_quads_are_cut_inside(tmp_path: Path) -> None:
    dart = np.array([[0, 0, 0], [2, 1, 0], [0, 2, 0], [0.5, 1, 0]])
    for turn in range(4):
        write_ply(tmp_path / "a.ply", "ascii", np.roll(dart, turn, axis=0), [[0, 1, 2, 3]])
        assert face_areas(read_mesh(tmp_path / "a.ply")[0]).sum() == pytest.approx(1.5)


def test_triangles_are_read_as_trimesh_reads_them(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.ply", box_mesh())
    mesh, warnings = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.faces, box_mesh().faces)
    np.testing.assert_allclose(mesh.vertices, box_mesh().vertices)
    assert warnings == ()


def test_a_cut_off_file_is_damaged(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", "binary_little_endian")
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data[:-4])
    with pytest.raises(BadInput, match=r"a\.ply: is damaged or not a mesh .*ends before its last element"):
        read_mesh(tmp_path / "a.ply")


# ---- every face twice ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("welded", [True, False])
def test_faces_that_lie_twice_in_one_place_count_once(welded: bool, tmp_path: Path) -> None:
    """Back faces share the vertices of the front, or have their own; faces keep their numbers."""
    box = box_mesh()
    vertices = box.vertices if welded else np.concatenate([box.vertices, box.vertices])
    back = box.faces[:, ::-1] + (0 if welded else len(box.vertices))
    trimesh.Trimesh(vertices, np.concatenate([box.faces, back]), process=False).export(tmp_path / "a.ply")
    mesh, warnings = read_mesh(tmp_path / "a.ply")
    assert warnings == ("a.ply: 12 faces lie twice in one place; each counts once",)
    np.testing.assert_array_equal(mesh.faces[:12], box.faces)
    areas = face_areas(mesh)
    np.testing.assert_allclose(areas[:12], face_areas(box))
    assert len(areas) == 24 and (areas[12:] == 0).all()


# ---- GLB -----------------------------------------------------------------------------------------------------------


def test_a_draco_compressed_glb_is_read(tmp_path: Path) -> None:
    pytest.importorskip("DracoPy")
    (tmp_path / "a.glb").write_bytes(draco_glb())
    mesh, _ = read_mesh(tmp_path / "a.glb")
    assert face_areas(mesh).sum() == pytest.approx(face_areas(box_mesh()).sum(), rel=1e-3)


def draco_glb() -> bytes:
    import DracoPy

    box = box_mesh()
    packed = DracoPy.encode(box.vertices.astype(np.float32), box.faces.astype(np.uint32), quantization_bits=14)
    extension = {"bufferView": 0, "attributes": {"POSITION": 0}}
    low, high = box.vertices.min(0).tolist(), box.vertices.max(0).tolist()
    return glb(
        {
            "extensionsUsed": ["KHR_draco_mesh_compression"],
            "extensionsRequired": ["KHR_draco_mesh_compression"],
            "accessors": [
                {"componentType": 5126, "count": len(box.vertices), "type": "VEC3", "min": low, "max": high},
                {"componentType": 5125, "count": box.faces.size, "type": "SCALAR"},
            ],
            "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(packed)}],
            "buffers": [{"byteLength": len(packed)}],
            "meshes": [
                {
                    "primitives": [
                        {
                            "attributes": {"POSITION": 0},
                            "indices": 1,
                            "mode": 4,
                            "extensions": {"KHR_draco_mesh_compression": extension},
                        }
                    ]
                }
            ],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
            "scene": 0,
        },
        packed,
    )


def glb(document: dict, binary: bytes = b"") -> bytes:
    text = json.dumps({"asset": {"version": "2.0"}, **document}).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary if binary else b""
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@pytest.mark.parametrize(
    ("extension", "message"),
    [
        ("KHR_meshopt_compression", "needs KHR_meshopt_compression"),
    ],
)
def test_what_would_come_as_zeros_is_refused_by_name(extension: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(glb({"extensionsUsed": [extension]}))
    with pytest.raises(BadInput, match=message):
        read_mesh(tmp_path / "a.glb")


def test_a_missing_draco_decoder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.glb").write_bytes(glb({"extensionsRequired": ["KHR_draco_mesh_compression"]}))
    monkeypatch.setattr("iris_addon.capture.mesh_files.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"is Draco-compressed — export it without compression, or install .* DracoPy"):
        read_mesh(tmp_path / "a.glb")
