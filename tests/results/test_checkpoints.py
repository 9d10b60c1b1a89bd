"""Stage files: read back only by the very solve that wrote them, and never in the way."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iris_addon.config import preset
from iris_addon.model.capture import Capture, Distortion
from iris_addon.results.checkpoints import Checkpoints, fingerprint
from tests.engine_room import cameras, furnished_room, photograph


def numbers() -> dict[str, np.ndarray]:
    return {"values": np.arange(6.0).reshape(2, 3), "name": np.array("gamma"), "empty": np.zeros((0, 3), np.float32)}


def never() -> dict[str, np.ndarray]:
    raise AssertionError("the stage was finished before")


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    from iris_addon.model.response import gamma

    views = cameras(2, 8, 6)
    return photograph(furnished_room(np.inf), views, np.full((2, 6, 8, 3), 0.2), np.ones(2), gamma(), tmp_path / "in")


def test_a_finished_stage_is_read_back_bit_by_bit(tmp_path: Path) -> None:
    Checkpoints(tmp_path, "key", False).stage("lights", numbers)
    again = Checkpoints(tmp_path, "key", True).stage("lights", never)
    assert set(again) == set(numbers())
    for name, value in numbers().items():
        assert again[name].dtype == value.dtype and np.array_equal(again[name], value)


@pytest.mark.parametrize("resume", [False, True])
def test_a_checkpoint_of_another_solve_is_ignored(tmp_path: Path, resume: bool) -> None:
    Checkpoints(tmp_path, "key", False).stage("lights", numbers)
    other = Checkpoints(tmp_path, "another key" if resume else "key", resume)
    assert other.stage("lights", lambda: {"values": np.ones(1)})["values"].shape == (1,)


@pytest.mark.parametrize("rows", [0, 3])
def test_a_table_stays_on_disk_and_is_read_back_by_the_same_solve_alone(tmp_path: Path, rows: int) -> None:
    table = np.zeros(rows, [("row", np.int32), ("value", np.float16, 3)])
    table["value"] = 0.5
    Checkpoints(tmp_path, "key", False).table("photo", lambda: table)
    again = Checkpoints(tmp_path, "key", True).table("photo", lambda: np.ones(7))
    assert again.dtype == table.dtype and np.array_equal(again, table) and (isinstance(again, np.memmap) or not rows)
    assert len(Checkpoints(tmp_path, "key", False).table("photo", lambda: np.ones(7))) == 7
    assert len(Checkpoints(tmp_path, "other", True).table("photo", lambda: np.ones(5))) == 5
    path = next(tmp_path.glob("photo.key*.npy"))
    path.write_bytes(path.read_bytes()[:-9])
    assert len(Checkpoints(tmp_path, "key", True).table("photo", lambda: np.ones(6))) == 6
    assert len(Checkpoints(tmp_path, "key", True, "512").table("photo", lambda: np.ones(4))) == 4
    Checkpoints(tmp_path, "key", True).clear()
    assert not list(tmp_path.glob("*.npy"))


@pytest.mark.parametrize("damage", ["truncated", "empty", "foreign", "pickle"])
def test_a_damaged_stage_is_computed_again(tmp_path: Path, damage: str) -> None:
    Checkpoints(tmp_path, "key", False).stage("lights", numbers)
    path = tmp_path / "lights.npz"
    content = path.read_bytes()
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "foreign":
        np.savez(path, something=np.ones(3))
    else:
        np.savez(path, key=np.array("key"), values=np.array([{"a": 1}], object))
    fresh = Checkpoints(tmp_path, "key", True).stage("lights", numbers)
    assert np.array_equal(fresh["values"], numbers()["values"])
    assert np.array_equal(Checkpoints(tmp_path, "key", True).stage("lights", never)["values"], fresh["values"])


def test_flipped_bytes_are_noticed(tmp_path: Path) -> None:
    Checkpoints(tmp_path, "key", False).stage("lights", numbers)
    path = tmp_path / "lights.npz"
    content = bytearray(path.read_bytes())
    at = content.find(np.float64(5.0).tobytes())
    content[at + 3] ^= 0xFF
    path.write_bytes(bytes(content))
    assert np.array_equal(Checkpoints(tmp_path, "key", True).stage("lights", numbers)["values"], numbers()["values"])


def test_clearing_removes_its_own_files_alone(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoints"
    checkpoints = Checkpoints(folder, "key", False)
    checkpoints.clear()
    checkpoints.stage("lights", numbers)
    (folder / "preview-albedo.png").write_bytes(b"picture")
    checkpoints.clear()
    assert not folder.exists()
    checkpoints.stage("lights", numbers)
    (folder / "notes.txt").write_text("mine")
    checkpoints.clear()
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_the_fingerprint_depends_on_all_inputs_of_a_solve(capture: Capture) -> None:
    config = preset("draft")
    view = capture.views[0]
    camera = view.camera
    moved = camera.c2w.copy()
    moved[0, 3] += 1e-9
    mesh = capture.mesh
    assert mesh.regions is not None

    def with_view(**changes) -> Capture:
        return replace(capture, views=(replace(view, **changes), *capture.views[1:]))

    def with_mesh(**changes) -> Capture:
        return replace(capture, mesh=replace(mesh, **changes))

    captures = [
        capture,
        with_view(exposure=2.0),
        with_view(name="other"),
        with_view(camera=replace(camera, c2w=moved)),
        with_view(camera=replace(camera, fx=camera.fx + 1)),
        with_view(camera=replace(camera, width=9)),
        with_view(distortion=Distortion(k1=0.1)),
        with_view(photo=capture.views[1].photo),
        with_mesh(vertices=mesh.vertices * 1.0001),
        with_mesh(faces=mesh.faces[:, ::-1].copy()),
        with_mesh(regions=mesh.regions + 1),
        with_mesh(regions=None),
        with_mesh(uv=np.zeros((len(mesh.faces), 3, 2), np.float32)),
        replace(capture, views=capture.views[:1]),
    ]
    prints = [fingerprint(c, config, "embree") for c in captures]
    changes = {"seed": 1}, {"max_patches": 7}
    prints += [fingerprint(capture, replace(config, **change), "embree") for change in changes]
    prints.append(fingerprint(capture, config, "warp-cuda"))
    assert len(set(prints)) == len(prints)
    assert fingerprint(replace(capture, warnings=("new",)), config, "embree") == prints[0]
    # Lights and materials are those of textures of every size.
    for change in ({"atlas_size": 512}, {"texels_per_metre": 50}, {"max_atlas_size": 64}):
        assert fingerprint(capture, replace(config, **change), "embree") == prints[0]


def test_the_fingerprint_sees_a_photo_or_a_response_file_change(capture: Capture, tmp_path: Path) -> None:
    table = tmp_path / "curve.txt"
    table.write_text("0\n1\n")
    config = replace(preset("draft"), response=table)
    before = fingerprint(capture, config, "embree")
    assert fingerprint(capture, config, "embree") == before
    for path in (capture.views[1].photo, table):
        assert path is not None
        stat = path.stat()
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns + 1_000_000))
        after = fingerprint(capture, config, "embree")
        assert after != before
        before = after
