"""The room in every format: the writers and what is said of their input are held against the original."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import formats_section
from benchmarks.format_captures import FIPT, FORMATS, differences, write_room
from benchmarks.formats_section import SAME_INPUT
from iris_addon.capture.programs import PROGRAMS
from iris_addon.capture.reader import read_capture


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in FORMATS if FORMATS[name].like != name and "own" not in name])
def test_the_engine_gets_the_same_room_in_every_format(name: str, tmp_path: Path) -> None:
    root, truth = write_room(name, tmp_path / "written")
    reference, its_truth = write_room(FORMATS[name].like, tmp_path / "reference")
    capture, expected = read_capture(root), read_capture(reference)
    assert capture.mismatch is None and len(capture.views) == len(expected.views)
    for what, value in differences(capture, expected).items():
        assert value <= SAME_INPUT[what], what
    assert (truth / "gt").is_dir() and (its_truth / "gt").is_dir()


def test_every_program_is_among_the_formats() -> None:
    written = " ".join(FORMATS)
    assert [program.name for program in PROGRAMS if program.name not in written] == []
    assert all(FORMATS[form.like].like == form.like for form in FORMATS.values())


def record(name: str, seed: int, kd: float, **difference: float) -> dict:
    metrics = dict.fromkeys(formats_section.COLUMNS, 1.0) | {"kd_psnr": kd}
    machine = {"processor": "P", "cores": 2, "commit": "abc"}
    run = {"format": name, "preset": "draft", "seed": seed}
    return {
        "run": run,
        "machine": machine,
        "metrics": metrics,
        "difference": dict.fromkeys(SAME_INPUT, 0.0) | difference,
    }


def test_the_table_has_the_original_first_with_its_spread_and_says_what_differs() -> None:
    records = [record("Bundler", 0, 39.0, place=0.002), record("Meshroom", 0, 39.5, turn=1e-6)]
    records += [record(FIPT, seed, 38.0 + seed) for seed in (0, 1, 2)]
    records += [record("Metashape", 0, 39.0, pixels=float("nan"))]
    lines = formats_section.describe(records, Path()).splitlines()[4:8]
    assert lines[0].startswith("| **FIPT** | 3 seeds | 39.00 ± 1.00 |")
    rows = {line.split(" | ")[0].strip("| "): line for line in lines[1:]}
    assert "| place 0.002 m | 39.00 |" in rows["Bundler"] and "| the same | 39.50 |" in rows["Meshroom"]
    assert "pixels nan" in rows["Metashape"]
    assert np.isfinite(list(SAME_INPUT.values())).all()
