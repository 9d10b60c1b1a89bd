"""GLBs whose geometry is compressed by meshopt, quantised or repeated by instances give the mesh of plain ones."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.capture.mesh_files import face_areas, read_mesh
from iris_addon.capture.meshopt_codec import decode
from iris_addon.model.capture import Mesh
from tests.box_room import box_mesh
from tests.capture.test_mesh_files import glb

BYTE, SHORT, USHORT, UINT, FLOAT = 5120, 5122, 5123, 5125, 5126
STEP = 4.0 / 65535
"""Metres per integer of the quantised box."""

# Made by meshoptimizer 0.30 from box_mesh() and from a grid of 40 x 40 vertices: one that computes all of a decoder's
# cases by itself would have its mistakes in common.
BOX_POSITIONS = "oAEAQAAAAQBAAAABBIQAAAEMzAAAgYKBARmZAAABP/8AAMHCwcLBwsEAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
BOX_TRIANGLES = "4f4A/w8HFqECBxORBQ8G/wIEAgMAdodWZ3iphmWJaJgBaQAA"
BOX_SEQUENCE = "0QAECAoMAggIBAoMBhIQBBIUDgQEEBIUAhYIEBYYBgoQCBYYDgAAAAA="
BOX_EXPONENTIAL = (
    "oAAAAQDAAAAIATCAAAAEAAABDMwAAAwLBgEwgAAABAABAD8AAP///wIKmpQ0AAAAAAEwgAAABAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
    "AA7QAAAO0AAADt"
)
TURNS = (
    "oAEfAAAAr3ABPwAAAA4DDQEPAAAAsd4BDwAAAAoZAQ8AAACxcAEPAAAACg0BHgAAAAMAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA/wc="
)
GRID_POSITIONS = (
    "eNpbEAoEWqtg4NUqXwRzFYxDnCgDEAi4CDgyMDQAIQig0wwMINsotwnEAJnGIugiQNg2Sm0Ci4KMcwTah9u6BjQPUmIbzIMCQCuJsY0ym2C2Ae"
    "OOhZBtlNsETyvAyHPEZR08BjEdysIAl8UDAM3mPmk="
)
GRID_TRIANGLES = (
    "eNrt1LENgkAYhuHjQm9L5wiMArFwA6MuYJgAwgasQJjKDYgDcK5gAUHj8/259s1T3XMxM7P/WDIzsx/fhx/+XB9judrNuZqampqampqampranr"
    "U0FbFK9Ze+ExsbGxsbGxsbGxsbGxsbGxsbGxsbG9u275C/4noXHt352oztpb8N2T2EN9nFo+U="
)


class Glb:
    """A GLB that grows; ``save`` writes it."""

    def __init__(self) -> None:
        self.blob = b""
        self.document: dict[str, Any] = {
            "accessors": [], "bufferViews": [], "buffers": [{}], "meshes": [], "nodes": [],
            "scenes": [{"nodes": [0]}], "scene": 0, "extensionsUsed": [], "extensionsRequired": [],
        }  # fmt: skip

    def view(self, data: bytes, **extra: Any) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        at = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        self.blob += data
        self.document["bufferViews"].append({**at, **extra})
        return len(self.document["bufferViews"]) - 1

    def packed(self, text: str, count: int, stride: int, mode: str, **extra: Any) -> int:
        """A view as gltfpack writes it: the plain data are said to be in a second buffer, which is not there."""
        number = self.view(base64.b64decode(text))
        view = self.document["bufferViews"][number]
        where = {"buffer": 0, "byteOffset": view["byteOffset"], "byteLength": view["byteLength"]}
        extension = {**where, "count": count, "byteStride": stride, "mode": mode, **extra}
        fallback = {"buffer": 1, "byteOffset": 0, "byteLength": count * stride}
        self.document["bufferViews"][number] = {**fallback, "extensions": {"EXT_meshopt_compression": extension}}
        self.use("EXT_meshopt_compression")
        if len(self.document["buffers"]) == 1:
            unused = {"byteLength": 1 << 16, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
            self.document["buffers"].append(unused)
        return number

    def accessor(self, view: int, kind: int, count: int, shape: str, **extra: Any) -> int:
        self.document["accessors"].append(
            {"bufferView": view, "componentType": kind, "count": count, "type": shape, **extra}
        )
        return len(self.document["accessors"]) - 1

    def array(self, values: np.ndarray, kind: int, shape: str, **extra: Any) -> int:
        return self.accessor(self.view(np.ascontiguousarray(values).tobytes()), kind, len(values), shape, **extra)

    def use(self, extension: str) -> None:
        for key in ("extensionsUsed", "extensionsRequired"):
            if extension not in self.document[key]:
                self.document[key].append(extension)

    def mesh(self, position: int, indices: int, **attributes: int) -> int:
        primitive = {"attributes": {"POSITION": position, **attributes}, "indices": indices, "mode": 4}
        self.document["meshes"].append({"primitives": [primitive]})
        return len(self.document["meshes"]) - 1

    def plain_box(self) -> int:
        box = box_mesh()
        position = self.array(box.vertices.astype("<f4"), FLOAT, "VEC3")
        return self.mesh(position, self.array(box.faces.astype("<u4").ravel(), UINT, "SCALAR"))

    def save(self, path: Path) -> Mesh:
        self.document["buffers"][0]["byteLength"] = len(self.blob)
        path.write_bytes(glb(self.document, self.blob))
        return read_mesh(path)[0]


def corners(mesh: Mesh) -> np.ndarray:
    """(F, 3, 3) corners of the faces, each face's in one order, the faces in one order."""
    faces = mesh.vertices[mesh.faces].round(3) + 0.0
    faces = np.array([sorted(face.tolist()) for face in faces])
    return np.array(sorted(faces.tolist()))


def assert_is_box(mesh: Mesh, tolerance: float = 2e-3) -> None:
    np.testing.assert_allclose(corners(mesh), corners(box_mesh()), atol=tolerance)


# ---- Compression by meshopt ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("indices", ["TRIANGLES", "INDICES"])
@pytest.mark.parametrize("positions", ["quantised", "exponential"])
def test_a_meshopt_compressed_glb_is_read(positions: str, indices: str, tmp_path: Path) -> None:
    made = Glb()
    node: dict[str, Any] = {"mesh": 0}
    if positions == "quantised":
        made.use("KHR_mesh_quantization")
        place = made.accessor(made.packed(BOX_POSITIONS, 8, 8, "ATTRIBUTES"), USHORT, 8, "VEC3")
        node["scale"] = [STEP] * 3
    else:
        packed = made.packed(BOX_EXPONENTIAL, 8, 12, "ATTRIBUTES", filter="EXPONENTIAL")
        place = made.accessor(packed, FLOAT, 8, "VEC3")
    text = BOX_TRIANGLES if indices == "TRIANGLES" else BOX_SEQUENCE
    made.mesh(place, made.accessor(made.packed(text, 36, 4, indices), UINT, 36, "SCALAR"))
    made.document["nodes"] = [node]
    assert_is_box(made.save(tmp_path / "a.glb"))


def grid(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


def test_vertices_of_several_blocks_are_those_that_were_packed() -> None:
    packed = grid(GRID_POSITIONS)
    plain = decode({"byteLength": len(packed), "count": 1600, "byteStride": 4, "mode": "ATTRIBUTES"}, packed)
    index = np.arange(1600)
    np.testing.assert_array_equal(
        np.frombuffer(plain, "<u2").reshape(-1, 2), np.column_stack([index % 40, index // 40])
    )


def test_triangles_of_a_grid_are_those_that_were_packed() -> None:
    packed = grid(GRID_TRIANGLES)
    said = {"byteLength": len(packed), "count": 9126, "byteStride": 4, "mode": "TRIANGLES"}
    found = np.frombuffer(decode(said, packed), "<u4").reshape(-1, 3)
    at = np.arange(1600).reshape(40, 40)
    one = np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:]], -1).reshape(-1, 3)
    other = np.stack([at[1:, :-1], at[1:, 1:], at[:-1, 1:]], -1).reshape(-1, 3)
    expected = np.concatenate([one, other])
    # The corner that a face begins with may differ; its winding may not.
    turned = np.stack([np.roll(found, k, 1) for k in range(3)])
    assert (turned == expected).all(-1).any(0).all()


def test_rotations_come_back_from_their_filter() -> None:
    packed = base64.b64decode(TURNS)
    said = {"byteLength": len(packed), "count": 4, "byteStride": 8, "mode": "ATTRIBUTES", "filter": "QUATERNION"}
    found = np.frombuffer(decode(said, packed), "<i2").reshape(-1, 4) / 32767
    half = 0.5**0.5
    expected = np.array([[0, 0, 0, 1], [0, 0, half, half], [0.5, 0.5, 0.5, 0.5], [0.1, -0.7, 0.1, 0.7]])
    assert (np.abs((found * expected).sum(1)) > 0.9999).all()


@pytest.mark.parametrize("text", [BOX_POSITIONS, BOX_TRIANGLES, BOX_SEQUENCE])
def test_damaged_streams_end_in_an_error_and_read_nothing_else(text: str) -> None:
    mode = {BOX_POSITIONS: "ATTRIBUTES", BOX_TRIANGLES: "TRIANGLES", BOX_SEQUENCE: "INDICES"}[text]
    count, stride = (8, 8) if mode == "ATTRIBUTES" else (36, 4)
    good, rng = base64.b64decode(text), np.random.default_rng(0)
    for length in range(len(good)):
        said = {"byteLength": length, "count": count, "byteStride": stride, "mode": mode}
        with pytest.raises(ValueError):
            decode({**said, "count": 3000}, good[:length])
    for _ in range(300):
        data = bytearray(good)
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
        said = {"byteLength": len(data), "count": count, "byteStride": stride, "mode": mode}
        try:
            assert len(decode(said, bytes(data))) == count * stride
        except ValueError:
            continue


def test_a_small_file_may_not_announce_any_number_of_vertices(tmp_path: Path) -> None:
    made = Glb()
    count = 500_000_000
    place = made.accessor(made.packed(BOX_POSITIONS, count, 8, "ATTRIBUTES"), USHORT, 8, "VEC3")
    made.mesh(place, made.accessor(made.packed(BOX_TRIANGLES, 36, 4, "TRIANGLES"), UINT, 36, "SCALAR"))
    made.document["nodes"] = [{"mesh": 0}]
    with pytest.raises(BadInput, match="announces more numbers than the file can hold"):
        made.save(tmp_path / "a.glb")


# ---- Quantisation --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("kind", [SHORT, USHORT])
def test_quantised_positions_are_read(kind: int, normalized: bool, tmp_path: Path) -> None:
    """Four numbers of 16 bits a vertex, the last of which is padding; the node scales them to metres."""
    largest = 32767 if kind == SHORT else 65535
    made = Glb()
    made.use("KHR_mesh_quantization")
    box, packed = box_mesh(), np.zeros((8, 4), "<i2" if kind == SHORT else "<u2")
    packed[:, :3] = np.rint(box.vertices / 4 * largest)
    view = made.view(packed.tobytes(), byteStride=8)
    place = made.accessor(view, kind, 8, "VEC3", normalized=normalized)
    made.mesh(place, made.array(box.faces.astype("<u2").ravel(), USHORT, "SCALAR"))
    made.document["nodes"] = [{"mesh": 0, "scale": [4.0 if normalized else 4.0 / largest] * 3}]
    assert_is_box(made.save(tmp_path / "a.glb"))


def test_quantised_texture_coordinates_are_fractions(tmp_path: Path) -> None:
    """Those of a strip, in which every face has a place of its own."""
    made = Glb()
    made.use("KHR_mesh_quantization")
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
    uv = np.array([[0, 0], [255, 0], [255, 255], [0, 255]], "<u1")
    padded = np.zeros((4, 4), "<u1")
    padded[:, :2] = uv
    place = made.array(vertices, FLOAT, "VEC3")
    texture = made.accessor(made.view(padded.tobytes(), byteStride=4), 5121, 4, "VEC2", normalized=True)
    faces = np.array([0, 1, 2, 0, 2, 3], "<u4")
    number = made.mesh(place, made.array(faces, UINT, "SCALAR"), TEXCOORD_0=texture)
    made.document["meshes"][number]["primitives"][0]["material"] = 0
    made.document |= {"materials": [{}], "nodes": [{"mesh": 0}]}
    mesh = made.save(tmp_path / "a.glb")
    assert mesh.uv is not None
    assert np.abs(mesh.uv[..., 0] - mesh.vertices[mesh.faces][..., 0]).max() < 1e-6


# ---- Instances -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", ["float", "short"])
def test_instances_stand_where_they_are_said_to(turns: str, tmp_path: Path) -> None:
    """Each is moved, turned and scaled below its node, which is moved and turned as well."""
    made = Glb()
    made.plain_box()
    half = 0.5**0.5
    moves = np.array([[0, 0, 0], [10, 0, 0], [0, 20, 5]], "<f4")
    quaternions = np.array([[0, 0, 0, 1], [0, 0, half, half], [half, 0, 0, half]])
    scales = np.array([[1, 1, 1], [2, 2, 2], [1, 0.5, 3]], "<f4")
    if turns == "float":
        rotation = made.array(quaternions.astype("<f4"), FLOAT, "VEC4")
    else:
        rotation = made.array(np.rint(quaternions * 32767).astype("<i2"), SHORT, "VEC4", normalized=True)
    attributes = {
        "TRANSLATION": made.array(moves, FLOAT, "VEC3"),
        "ROTATION": rotation,
        "SCALE": made.array(scales, FLOAT, "VEC3"),
    }
    made.use("EXT_mesh_gpu_instancing")
    shift = [1.0, 2.0, 3.0]
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    made.document["nodes"] = [
        {"mesh": 0, "translation": shift, "rotation": [0, 0, half, half], "extensions": instancing}
    ]
    mesh = made.save(tmp_path / "a.glb")
    quarter_z, quarter_x = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    box = box_mesh()
    places = [
        (scale * box.vertices) @ turn.T + move
        for move, turn, scale in zip(moves, (np.eye(3), quarter_z, quarter_x), scales, strict=True)
    ]
    expected = Mesh(np.concatenate(places) @ quarter_z.T + shift, np.concatenate([box.faces + 8 * k for k in range(3)]))
    np.testing.assert_allclose(corners(mesh), corners(expected), atol=5e-3)
    assert mesh.regions is not None and len(np.unique(mesh.regions)) == 3
    assert face_areas(mesh).sum() == pytest.approx(face_areas(expected).sum(), rel=1e-3)


def test_too_many_instances_are_refused(tmp_path: Path) -> None:
    made = Glb()
    made.plain_box()
    made.use("EXT_mesh_gpu_instancing")
    moves = made.array(np.zeros((100_001, 3), "<f4"), FLOAT, "VEC3")
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moves}}}
    made.document["nodes"] = [{"mesh": 0, "extensions": instancing}]
    with pytest.raises(BadInput, match="has 100001 instances, more than 100000"):
        made.save(tmp_path / "a.glb")
