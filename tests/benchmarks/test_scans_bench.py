"""Scans beside exact meshes: only the mesh is exchanged, and the table shows both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from benchmarks import scans, scans_section
from iris_addon.capture.reader import read_capture
from tests.truth_room import write_truth_room


def test_only_the_mesh_is_exchanged(tmp_path: Path) -> None:
    room = tmp_path / "room"
    write_truth_room(room)
    exact = read_capture(room)
    mesh = trimesh.Trimesh(exact.mesh.vertices * 1.001, exact.mesh.faces, process=False).subdivide()
    mesh.export(tmp_path / "room.ply")
    for _ in range(2):  # made anew where it is there
        made = scans.scanned(room, tmp_path / "room.ply", tmp_path / "out")
    found = read_capture(made)
    assert made.name == "room-scan" and len(found.mesh.faces) == 4 * len(exact.mesh.faces)
    for view, other in zip(found.views, exact.views, strict=True):
        np.testing.assert_array_equal(view.camera.c2w, other.camera.c2w)
        assert view.photo is not None and other.photo is not None
        assert view.photo.read_bytes() == other.photo.read_bytes()
    assert len(read_capture(room).mesh.faces) == len(exact.mesh.faces)


def record(capture: str, kd: float) -> dict:
    return {
        "run": {"capture": capture, "configuration": "ours", "preset": "draft", "seed": 0, "axis": "", "level": 0},
        "seconds_total": 61.4,
        "rays_traced": 79_400_000,
        "holdout_psnr": 26.0,
        "metrics": {"kd_psnr": kd, "emission_iou": 0.5},
        "machine": {"processor": "test", "cores": 2, "commit": "0"},
    }


def test_both_meshes_of_a_room_stand_below_each_other(tmp_path: Path) -> None:
    text = scans_section.describe([record("x/out/a-scan", 25.1), record("y/b", 30.0), record("y/a", 36.9)], tmp_path)
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith(("| a ", "| b "))]
    assert [row[:4] for row in rows] == [
        ["| a", "exact", "draft", "36.90"],
        ["| a", "scan", "draft", "25.10"],
        ["| b", "exact", "draft", "30.00"],
    ]
    assert rows[0][-3:] == ["26.00", "61", "79 |"]
