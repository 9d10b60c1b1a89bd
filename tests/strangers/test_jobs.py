"""Job files, light shares, responses and results made to break what reads them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from headless import batch, cli
from headless.frame_folder import open_frames, write_film
from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import MAX_DEPTH
from iris_addon.config import MAX_SEED, preset
from iris_addon.edits.jobs import insertion_edits, relight_edit
from iris_addon.edits.light_shares import LightShares, read_shares, write_shares
from iris_addon.edits.motion import at_time
from iris_addon.response.photometry import fixed_response, read_response
from iris_addon.results.checkpoints import sole_writer
from iris_addon.results.folder import load_result, save_result
from tests.box_room import RoomCapture
from tests.result_room import room

RUN = Path(__file__).resolve().parents[2] / "headless" / "run.py"


def refused(call: Callable[..., object], *arguments: object) -> str:
    """The message of the refusal: one line that says what to do."""
    with pytest.raises(BadInput) as caught:
        call(*arguments)
    message = str(caught.value)
    assert " — " in message and message.isprintable()
    return message


# ---- animations -----------------------------------------------------------------------------------------------------


def test_a_film_looks_at_the_frames_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = open_frames(tmp_path, 10**15, ".png", {})
    monkeypatch.setattr("headless.frame_folder.find_ffmpeg", lambda: None)
    assert write_film(frames, 24) is None  # in no time
    for number in (1, 2, 4, 10**12):
        frames.path(number).write_bytes(b"png")
    (tmp_path / "frame_0003.png").touch()
    assert frames.all_finished() == [1, 2, 4]


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_film_is_not_written_through_a_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, precious = tmp_path / "ffmpeg", tmp_path / "precious"
    program.write_text('#!/bin/sh\nfor last; do :; done\nprintf film > "$last"\n')
    program.chmod(0o755)
    precious.write_text("precious")
    monkeypatch.setattr("headless.frame_folder.find_ffmpeg", lambda: str(program))
    frames = open_frames(tmp_path / "frames", 1, ".png", {})
    frames.path(1).write_bytes(b"png")
    for name in (".film.mp4", "film.mp4"):
        (frames.folder / name).symlink_to(precious)
    film = write_film(frames, 24)
    assert film is not None and film.read_text() == "film" and not film.is_symlink()
    assert precious.read_text() == "precious"


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_lock_that_is_a_link_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / ".lock").symlink_to(tmp_path / "precious")
    with pytest.raises(IrisError, match="is a link"), sole_writer(tmp_path / "r"):
        pass
    assert (tmp_path / "precious").read_text() == "precious"


def test_a_solve_removes_what_killed_ones_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from iris_addon import pipeline

    fresh = ["checkpoints/.preview-albedo-0123abcd.png", ".report-0123abcd.html", "report/.x-0123abcd.png"]
    others = [".job-solve-0123abcd.json", ".frame_0001-0123abcd.png"]  # another program may be writing these
    for name in fresh + others:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    left: list[list[str]] = []
    monkeypatch.setattr(
        pipeline, "_solve", lambda *_: left.append([name for name in fresh + others if (tmp_path / name).exists()])
    )
    arguments: list = [SimpleNamespace(mismatch=None), None, tmp_path]
    pipeline.solve(*arguments)
    assert left == [others]
    for name in others:
        os.utime(tmp_path / name, (0, 0))
    pipeline.solve(*arguments)
    assert left == [others, []]


def test_a_length_has_an_end() -> None:
    from iris_addon.edits.parsing import whole

    for length in (10**7, 10**400, -1, 1.5, True):
        assert "'length'" in refused(whole, length, "length")


def test_a_shared_exposure_that_is_none_is_refused(tmp_path: Path) -> None:
    frames = open_frames(tmp_path, 3, ".png", {})
    for value in ("x", [1, 2], -1, [1, 2, float("nan")]):
        frames.facts["exposure"] = value
        assert "frames.json" in refused(frames.exposure)
    frames.facts["exposure"] = [1.0, 2.0, 3.0]
    assert frames.exposure().tolist() == [1, 2, 3]


# ---- options --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "option", [("--seed", "99999999999"), ("--samples", "9" * 5000), ("--samples", "-1"), ("--frames", "1-1000000000"),
               ("--exposure", "1e300"), ("--fps", "²")]
)  # fmt: skip
def test_options_beyond_what_blender_takes_are_usage_errors(
    option: tuple[str, str], capsys: pytest.CaptureFixture
) -> None:
    assert cli.main(["relight", "r", "--lights", "l", "--views", "v", "--out", "o", *option]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_a_resolution_beyond_all_photos_is_a_usage_error() -> None:
    assert cli.main(["synth", "s.blend", "--out", "o", "--resolution", "99999x99999"]) == 2


def test_twice_the_largest_seed_fits_into_blender() -> None:
    """The two halves of a composited picture have seeds of their own."""
    assert 2 * MAX_SEED + 1 == 2**31 - 1


# ---- batch ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        'name = "a\\u0000b"',
        'out = "o\\u0000"',
        'name = "a\\u001b[2J"',
        'capture = "\\u0000"',
        "seed = -1",
        "seed = 4294967296",
    ],
)
def test_jobs_that_cannot_run_are_told_before_any_runs(tmp_path: Path, line: str) -> None:
    capture = "" if line.startswith("capture") else 'capture = "b"\n'
    (tmp_path / "jobs.toml").write_text(f'[[job]]\ncapture = "a"\n[[job]]\n{capture}{line}\n')
    assert "jobs.toml: job 2" in refused(batch.read_jobs, tmp_path / "jobs.toml")


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 3000, "\x00", "a = 1", "[[job]]\ncapture = 1", "a" * 100 + " = {" * 500]
)
def test_what_is_no_job_file_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "jobs.toml").write_text(text)
    assert "jobs.toml" in refused(batch.read_jobs, tmp_path / "jobs.toml")


def test_a_job_whose_traceback_has_no_place_does_not_end_the_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(job: batch.Job, progress: Progress, *, resume: bool) -> None:
        raise ValueError("one\ntwo\x1b[2J")

    monkeypatch.setattr(batch, "solve_job", fail)
    config = preset("draft")
    for out in (Path(f"{tmp_path}/a\0b"), Path("/proc/nowhere")):
        unit = batch.Unit(batch.Job(name="a", capture=tmp_path, out=out, config=config))
        line = unit.line()
        batch._run_unit(unit, line, [line], Namespace(resume=False), Progress())
        assert line.status == "failed" and line.error.startswith("ValueError: one two") and line.error.isprintable()


def test_a_summary_looks_at_the_frames_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for an animation, and not once for each of the frames that a job file says it has."""
    frames = "".join(f'[[job.frames]]\nname = "{k}"\nframes = "1-1000000"\n' for k in range(3))
    (tmp_path / "jobs.toml").write_text(f'[[job]]\ncapture = "a"\n{frames}')
    folder = tmp_path / "jobs" / "a" / "1"
    folder.mkdir(parents=True)
    for name in ("frame_0001.png", "frame_0007.exr", "frame_0007.png", "frame_9999999.png", "frame_x.png"):
        (folder / name).touch()
    looked: list[Path] = []
    for method in ("iterdir", "glob"):
        real = getattr(Path, method)
        counted = lambda self, *more, real=real: (looked.append(self), real(self, *more))[1]  # noqa: E731
        monkeypatch.setattr(Path, method, counted)
    assert cli.main(["batch", str(tmp_path / "jobs.toml"), "--summary"]) == 1
    assert looked == [folder]
    lines = json.loads((tmp_path / "jobs" / "summary.json").read_text())["jobs"]
    assert [line["figures"].get("frames") for line in lines] == [None, 0, 2, 0]


# ---- lights and objects ---------------------------------------------------------------------------------------------

HUGE = int("9" * 400)
POINT = {"type": "point", "position": [0, 0, 1], "intensity": 1}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "job",
    [
        {"outside": HUGE},
        {"outside": 1e308},
        {"recovered": {"all": {"scale": HUGE}}},
        {"lights": [{**POINT, "position": [HUGE, 0, 0]}]},
        {"lights": [{**POINT, "intensity": 1e308}]},
        {"lights": [{"type": "sun", "direction": [1e-200, 0, 0], "irradiance": 1}]},
        {"lights": [{"type": "hdri", "file": "~nosuchuser/x.exr"}]},
        {"lights": [{"type": "hdri", "file": "x" * 5000}]},
        {"lights": [{"type": "hdri", "file": "a\0b"}]},
        {"lights": {"keys": [[0, HUGE]]}},
        {"outside": {"keys": [[HUGE, 1]]}},
        {"a\nerror: spoofed\x1b[2J": 1},
    ],
)
def test_a_relighting_job_of_values_that_cannot_be_is_refused(job: dict, tmp_path: Path) -> None:
    refused(relight_edit, room(), job, tmp_path)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "thing",
    [
        {"shape": "cube", "size": HUGE, "location": [0, 0, 0]},
        {"shape": "cube", "size": 1, "location": [0, 0, 1e308]},
        {"file": "~nosuchuser/x.glb", "location": [0, 0, 0]},
        {"shape": "sphere", "center": ["1", "2", "3"], "radius": 1},
    ],
)
def test_an_object_of_values_that_cannot_be_is_refused(thing: dict, tmp_path: Path) -> None:
    refused(insertion_edits, room(), {"objects": [thing]}, tmp_path)


def test_all_that_a_job_file_may_nest_can_be_animated() -> None:
    value: object = 1.0
    for _ in range(MAX_DEPTH):
        value = [value]
    assert at_time(value, 0.5) == value


# ---- light shares ---------------------------------------------------------------------------------------------------


def test_light_shares_of_two_sizes_are_refused(tmp_path: Path) -> None:
    light = LightShares(np.ones((4, 6, 3), np.float32), {"a": np.ones((4, 6, 3), np.float32)})
    write_shares(tmp_path / "a.exr", light)
    assert read_shares(tmp_path / "a.exr").shares["a"].shape == (4, 6, 3)
    window = (np.zeros(2, np.int32), np.array([5, 3], np.int32))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "displayWindow": window}
    parts = [
        OpenEXR.Part(dict(header), {"RGB": np.zeros((4 + k, 6, 3), np.float32)}, name)
        for k, name in enumerate(("combined", "a"))
    ]
    OpenEXR.File(parts).write(str(tmp_path / "b.exr"))
    assert "b.exr: has parts of different sizes" in refused(read_shares, tmp_path / "b.exr")


def test_light_shares_are_looked_at_before_they_are_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    light = LightShares(np.ones((40, 60, 3), np.float32), {"a": np.ones((40, 60, 3), np.float32)})
    write_shares(tmp_path / "a.exr", light)
    monkeypatch.setattr(OpenEXR, "File", None)
    assert "a.exr: is not 30x40 pixels" in refused(read_shares, tmp_path / "a.exr", (30, 40))
    monkeypatch.setattr("iris_addon.base.image_headers.MAX_PIXELS", 1000)
    assert "a.exr: is 60x40 pixels" in refused(read_shares, tmp_path / "a.exr")


# ---- responses ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".gz", ".xz", ".bz2", ".txt", ".npy", ".json"])
def test_a_response_is_not_decompressed_by_its_name(tmp_path: Path, suffix: str) -> None:
    import bz2
    import gzip
    import lzma

    pack = {".gz": gzip.compress, ".xz": lzma.compress, ".bz2": bz2.compress}.get(
        suffix, lambda data: b"\x1f\x8b" + data
    )
    (tmp_path / f"c{suffix}").write_bytes(pack(b"0\n" * 1000 + b"1\n"))
    assert f"c{suffix}" in refused(read_response, tmp_path / f"c{suffix}")


def test_a_response_file_is_read_before_anything_is_traced(tmp_path: Path, nerfstudio_room: RoomCapture) -> None:
    from iris_addon.capture.reader import read_capture
    from iris_addon.pipeline import solve

    (tmp_path / "c.txt").write_text("0\n1e999\n")
    config = preset("draft", response=tmp_path / "c.txt")
    refused(fixed_response, config)
    seen: list[str] = []
    progress = Progress(lambda event: seen.append(event.stage))
    with pytest.raises(BadInput, match=r"c\.txt"):
        solve(read_capture(nerfstudio_room.save()), config, tmp_path / "out", progress)
    assert seen == []


# ---- results --------------------------------------------------------------------------------------------------------


def change(file: str, **values: object) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        content = json.loads((folder / file).read_text())
        (folder / file).write_text(json.dumps({**content, **values}))

    return apply


FACTOR = {"factor": [1, 1, 1]}
LAMP = {"id": HUGE, "faces": [], "radiance": [1, 1, 1], "area": 1, "confidence": 1}
POSES = {"twists": [[0] * 6] * 9000, "given": [[0] * 12] * 9000, "smooth": True}


@pytest.mark.parametrize(
    "damage",
    [
        change("response.json", exposures={'a": "b\n- evil': FACTOR}),
        change("response.json", exposures={"\ud800": FACTOR}),
        change("response.json", exposures={"a": {"factor": [HUGE, 1, 1]}}),
        change("response.json", coefficients=HUGE),
        change("response.json", samples=[[0, 1]]),
        change("response.json", local_exposure={"strength": HUGE}),
        change("emitters.json", emitters=[LAMP]),
        change("emitters.json", outside={"sh": HUGE}),
        change("report.json", warnings=3),
        change("report.json", warnings=[{}]),
        change("report.json", seconds={"a": "b"}),
        change("report.json", holdout_psnr="high"),
        change("report.json", model={"camera": {"correction": {"fx_over_width": HUGE}}}),
        change("report.json", model={"camera": {"poses": POSES}}),
    ],
)  # fmt: skip
def test_a_result_of_values_that_cannot_be_is_refused(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    save_result(room(), tmp_path / "r")
    damage(tmp_path / "r")
    assert ".json" in refused(load_result, tmp_path / "r")


def test_a_result_with_a_pipe_in_it_does_not_block(tmp_path: Path) -> None:
    if sys.platform == "win32":
        pytest.skip("no named pipes in folders")
    save_result(room(), tmp_path / "r")
    for name in (
        "response.json",
        "emitters.json",
        "materials/mesh.glb",
        "materials/roughness.png",
        "materials/base_color.exr",
    ):
        kept = shutil.move(tmp_path / "r" / name, tmp_path / "kept")
        os.mkfifo(tmp_path / "r" / name)
        assert name in refused(load_result, tmp_path / "r")
        (tmp_path / "r" / name).unlink()
        shutil.move(kept, tmp_path / "r" / name)
    load_result(tmp_path / "r")


def test_a_glb_of_a_result_with_parts_beyond_its_end_is_refused(tmp_path: Path) -> None:
    save_result(room(), tmp_path / "r")
    mesh = tmp_path / "r" / "materials" / "mesh.glb"
    data = mesh.read_bytes()
    for old, new in ((b'"byteLength":', b'"byteLength":9'), (b'"up":[', b'"up":[9'), (b'"faces":', b'"faces":-')):
        mesh.write_bytes(data.replace(old, new, 1))
        assert "mesh.glb" in refused(load_result, tmp_path / "r")


# ---- the real command -----------------------------------------------------------------------------------------------


def test_the_command_says_one_line_and_exits_3(tmp_path: Path) -> None:
    save_result(room(), tmp_path / "r")
    change("response.json", exposures={'a"\nb': FACTOR})(tmp_path / "r")
    command = [sys.executable, str(RUN), "camera", str(tmp_path / "r"), "--out", str(tmp_path / "o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3 and done.stderr.count("\n") == 1 and "response.json" in done.stderr
    assert not (tmp_path / "o").exists()
