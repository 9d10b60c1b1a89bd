from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import types
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from headless import cli, environment, make_environment
from headless.cancellation import restore_handlers
from headless.job_file import read_jobs
from iris_addon.base.color_spaces import ACESCG, REC709
from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr, read_image
from iris_addon.results.folder import SCHEMA_VERSION, load_result, save_result
from tests.result_room import room
from tests.truth_room import true_result, write_truth_room

ROOT = Path(__file__).resolve().parents[2]


def run(*args: object, python: tuple[str, ...] = (sys.executable,), **env: str) -> subprocess.CompletedProcess[str]:
    command = [*python, str(ROOT / "headless" / "run.py"), *map(str, args)]
    kept = {name: value for name, value in os.environ.items() if name != "IRIS_PYTHON"}
    return subprocess.run(command, capture_output=True, text=True, env={**kept, **env}, check=False, cwd="/")


@pytest.fixture
def stub_solve(monkeypatch):
    """Replaces the engine by one that fails or succeeds by the name of the capture."""

    def solve(capture, config, out, progress, resume=False):
        with progress.stage("stub"):
            if capture.name == "broken":
                raise ValueError("no light\nat all")
            if capture.name == "interrupted":
                os.kill(os.getpid(), signal.SIGINT)
            progress.update(0.5)
        uv = room().mesh.uv
        report = {"preset": config.preset, "seed": config.seed, "seconds": {"stub": 0.5}, "resume": resume}
        report |= {"asked": [config.atlas_size, config.texels_per_metre]}
        result = replace(
            true_result(), mesh=replace(capture.mesh, uv=uv), report={"schema_version": SCHEMA_VERSION, **report}
        )
        save_result(result, out)
        return result

    module = types.ModuleType("iris_addon.pipeline")
    module.solve = solve
    monkeypatch.setitem(sys.modules, "iris_addon.pipeline", module)


# ---- exit codes and messages ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "args",
    [
        (),
        ("bogus",),
        ("solve",),
        ("solve", "x", "--out", "y", "--preset", "best"),
        ("render", "r", "--samples", "0"),
        ("solve", "x", "--out", "y", "--atlas-size", "1000"),
        ("solve", "x", "--out", "y", "--texels-per-metre", "0"),
        ("inspect", "x", "--out", "y", "--atlas-size", "32768"),
    ],
)
def test_usage_errors_are_one_line_and_exit_2(args):
    done = run(*args)
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.startswith("error: ") and " — " in done.stderr and done.stderr.count("\n") == 1


def test_help_lists_the_commands():
    done = run("--help")
    assert done.returncode == 0
    assert all(name in done.stdout for name in environment.NEEDS)


def test_bad_input_is_one_line_and_exits_3(tmp_path):
    done = run("solve", tmp_path / "nothing", "--out", tmp_path / "out")
    assert done.returncode == 3
    assert done.stderr.startswith("error: ") and "nothing" in done.stderr and " — " in done.stderr
    assert done.stderr.count("\n") == 1 and not (tmp_path / "out").exists()


def test_output_that_is_redirected_on_windows_escapes_what_it_lacks(nerfstudio_room, tmp_path):
    """A code page of 256 characters has no Cyrillic: the work is done, and its summary is printed."""
    folder = nerfstudio_room.root.rename(nerfstudio_room.root.with_name("Кухня"))
    done = run("inspect", folder, "--out", tmp_path / "out", PYTHONIOENCODING="cp1252")
    assert done.returncode == 0, done.stderr
    assert "Looked at \\u041a" in done.stdout


def test_debug_adds_a_traceback(tmp_path):
    assert "Traceback" in run("solve", tmp_path / "nothing", "--out", tmp_path / "out", "--debug").stderr


def test_json_errors_are_lines_on_stdout(tmp_path):
    done = run("solve", tmp_path / "nothing", "--out", tmp_path / "out", "--json")
    last = json.loads(done.stdout.splitlines()[-1])
    assert done.returncode == 3
    assert last["type"] == "error" and last["exit_code"] == 3 and "nothing" in last["what"] and last["fix"]


BARE = (sys.executable, "-I", "-S")
"""A Python without any package."""


def test_missing_packages_exit_4_and_name_the_way_out(tmp_path):
    done = run("solve", tmp_path, "--out", tmp_path / "out", python=BARE)
    assert done.returncode == 4
    assert "torch" in done.stderr and "IRIS_PYTHON" in done.stderr and done.stderr.count("\n") == 1


@pytest.fixture
def no_blender(monkeypatch):
    monkeypatch.delitem(sys.modules, "bpy", raising=False)
    monkeypatch.delenv("IRIS_PYTHON", raising=False)
    monkeypatch.setattr(environment, "find_spec", lambda name: None if name == "bpy" else find_spec(name))


def test_commands_that_need_blender_name_its_package_where_it_is_missing(solved, no_blender, capsys):
    result, room_ = str(solved / "result"), str(solved / "room")
    for command in (["apply", result, "--blend", str(solved / "x.blend")], ["evaluate", result, "--gt", room_]):
        assert cli.main(command) == 4
        error = capsys.readouterr().err
        assert "pip install iris-blender[blender]" in error and "inside Blender" in error and error.count("\n") == 1


def test_evaluate_without_rendering_needs_no_blender_and_names_what_it_left_out(solved, no_blender, capsys):
    assert cli.main(["evaluate", str(solved / "result"), "--gt", str(solved / "room"), "--no-render"]) == 0
    assert "left out: relight_psnr (nothing was rendered)" in capsys.readouterr().out


IN_BLENDER = ("render", "apply", "probe")


@pytest.mark.parametrize("command", ["evaluate", *(pytest.param(name, marks=pytest.mark.bpy) for name in IN_BLENDER)])
def test_a_command_needs_no_more_packages_than_it_names(solved, command):
    """Else a Python that lacks one of the others would fail where it should hand over to IRIS_PYTHON."""
    if command in IN_BLENDER:
        pytest.importorskip("bpy")
    every = {name for needed in environment.NEEDS.values() for name in needed} - {"bpy"}  # its presence means Blender
    without = f"import sys, runpy; sys.modules.update(dict.fromkeys({every - {*environment.NEEDS[command]}}));"
    start = f"{without} sys.argv[:] = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    result, room_ = str(solved / "result"), str(solved / "room")
    more = ["--gt", room_, "--no-render"]
    if command == "render":
        more = ["--views", room_ + "/val", "--samples", "1", "--out", str(solved / "png")]
    if command == "apply":
        more = ["--blend", str(solved / "room.blend")]
    if command == "probe":
        more = ["--at", "2", "1.5", "1.25", "--width", "8", "--samples", "1", "--out", str(solved / "probe.exr")]
    done = run(command, result, *more, python=(sys.executable, "-c", start))
    assert done.returncode == 0, done.stderr


def test_iris_python_takes_over(tmp_path):
    done = run("solve", tmp_path / "nothing", "--out", tmp_path / "out", python=BARE, IRIS_PYTHON=sys.executable)
    assert done.returncode == 3 and "nothing" in done.stderr


def test_iris_python_that_does_not_start_exits_4(tmp_path):
    done = run("solve", tmp_path, "--out", tmp_path / "out", python=BARE, IRIS_PYTHON=str(tmp_path / "python"))
    assert done.returncode == 4 and "cannot be started" in done.stderr


def test_a_handler_that_is_not_pythons_becomes_the_default():
    """Blender sets its own for Ctrl-C, of which Python knows no more than that it is there."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        restore_handlers({signal.SIGTERM: None})
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        restore_handlers({signal.SIGTERM: before})
    assert signal.getsignal(signal.SIGTERM) == before


def test_arguments_inside_blender_stand_after_two_dashes(monkeypatch):
    monkeypatch.delitem(sys.modules, "bpy", raising=False)
    assert cli._own_arguments(["run.py", "solve", "--out", "x"]) == ["solve", "--out", "x"]
    monkeypatch.setitem(sys.modules, "bpy", types.ModuleType("bpy"))
    assert cli._own_arguments(["blender", "-b", "-P", "run.py", "--", "solve", "x"]) == ["solve", "x"]
    assert cli._own_arguments(["blender", "-b"]) == []


# ---- solve ---------------------------------------------------------------------------------------------------------


def test_solve_hands_its_options_on_and_writes_the_folder(fipt_room, tmp_path, stub_solve, capsys):
    out = tmp_path / "out"
    code = cli.main(["solve", str(fipt_room.root), "--out", str(out), "--preset", "draft", "--seed", "7", "--resume"])
    assert code == 0
    report = load_result(out).report
    assert (report["preset"], report["seed"], report["resume"]) == ("draft", 7, True)
    assert str(out) in capsys.readouterr().out


@pytest.mark.parametrize("options", [("--exclude", "a", "b"), ("--exclude", "a", "--exclude", "b")])
def test_photos_are_excluded_however_the_option_is_repeated(options):
    """The last one alone would count, and the others be solved from without a word."""
    args = cli.make_parser().parse_args(["solve", "room", "--out", "out", *options])
    assert list(args.exclude) == ["a", "b"]
    assert list(cli.make_parser().parse_args(["solve", "room", "--out", "out"]).exclude) == []


@pytest.mark.parametrize(
    ("options", "asked"),
    [
        ((), ["auto", "auto"]),
        (("--atlas-size", "auto", "--texels-per-metre", "auto"), ["auto", "auto"]),
        (("--atlas-size", "512", "--texels-per-metre", "37.5"), [512, 37.5]),
    ],
)
def test_the_size_of_textures_reaches_the_solve(fipt_room, tmp_path, stub_solve, options, asked):
    assert cli.main(["solve", str(fipt_room.root), "--out", str(tmp_path / "out"), *options]) == 0
    assert load_result(tmp_path / "out").report["asked"] == asked


def test_inspect_says_what_textures_will_take(fipt_room, tmp_path, capsys):
    command = ["inspect", str(fipt_room.root), "--out", str(tmp_path / "look")]
    for options, side, text in (
        ([], 2048, "up to 2048 x 2048, 0.1 GB in Blender"),
        (["--preset", "final"], 4096, "up to 4096 x 4096, 0.5 GB in Blender"),
        (["--preset", "draft", "--atlas-size", "8192"], 8192, "8192 x 8192, 1.9 GB in Blender"),
        (["--atlas-size", "8192", "--texels-per-metre", "9"], 8192, "up to 8192 x 8192, 1.9 GB in Blender"),
    ):
        assert cli.main([*command, *options]) == 0
        (line,) = [line for line in capsys.readouterr().out.splitlines() if line.strip().startswith("textures")]
        assert line.split(maxsplit=1)[1] == text
        textures = json.loads((tmp_path / "look" / "capture.json").read_text())["textures"]
        assert textures == {"side": side, "bytes_in_blender": 28 * side**2, "text": text}


def test_json_lines_end_with_the_result(fipt_room, tmp_path, stub_solve, capsys):
    assert cli.main(["solve", str(fipt_room.root), "--out", str(tmp_path / "out"), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["type"] for line in lines[:-1]] == ["progress"] * (len(lines) - 1) and len(lines) > 2
    assert lines[-1]["type"] == "done" and lines[-1]["result"]["lights"] == 1


def test_an_unforeseen_failure_is_one_line_and_exits_1(fipt_room, tmp_path, stub_solve, capsys):
    fipt_room.root.rename(tmp_path / "broken")
    assert cli.main(["solve", str(tmp_path / "broken"), "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: ValueError: no light at all — ")


def test_a_path_that_is_in_the_way_is_named(fipt_room, tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    assert cli.main(["inspect", str(fipt_room.root), "--out", str(tmp_path / "file")]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"error: {tmp_path / 'file'}: cannot be used") and "check the path" in error
    assert (tmp_path / "file").read_text() == "mine"


def test_a_worker_of_blender_is_mended_in_blender(tmp_path):
    bare = (sys.executable, "-S")
    by_hand = run("inspect", tmp_path, "--out", tmp_path, python=bare)
    in_blender = run("inspect", tmp_path, "--out", tmp_path, "--json", "--stop-with-stdin", python=bare)
    assert by_hand.returncode == in_blender.returncode == 4
    assert "make setup" in by_hand.stderr and "Create Environment" in in_blender.stderr


def test_the_test_of_an_environment_imports_all_that_a_solve_needs():
    assert {name.partition(".")[0] for name in make_environment.IMPORTS} == {*environment.NEEDS["solve"]}


def test_a_cancelled_command_speaks_of_resuming_only_if_it_can():
    def fix(*argv):
        return str(cli._cancelled(cli.make_parser().parse_args(argv)))

    assert "--resume" in fix("solve", "room", "--out", "out")
    assert "--resume" not in fix("inspect", "room", "--out", "out")


def test_interrupting_cancels_and_exits_130(fipt_room, tmp_path, stub_solve, capsys):
    fipt_room.root.rename(tmp_path / "interrupted")
    handler = signal.getsignal(signal.SIGINT)
    assert cli.main(["solve", str(tmp_path / "interrupted"), "--out", str(tmp_path / "out")]) == 130
    assert "error: cancelled — " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert signal.getsignal(signal.SIGINT) is handler


# ---- batch ---------------------------------------------------------------------------------------------------------


def write_jobs(path: Path, *jobs: dict[str, object]) -> Path:
    text = ["[[job]]\n" + "\n".join(f"{key} = {json.dumps(value)}" for key, value in job.items()) for job in jobs]
    path.write_text("\n".join(text))
    return path


def test_a_failing_job_is_reported_and_the_rest_go_on(tmp_path, stub_solve, capsys):
    write_truth_room(tmp_path / "good")
    write_truth_room(tmp_path / "broken")
    jobs = write_jobs(
        tmp_path / "jobs.toml",
        {"capture": "missing"},
        {"capture": "broken"},
        {"capture": "good", "preset": "draft", "evaluate": True},
        {"capture": "good", "name": "again", "out": "elsewhere"},
    )
    assert cli.main(["batch", str(jobs)]) == 1
    summary = json.loads((tmp_path / "jobs" / "summary.json").read_text())["jobs"]
    assert [(job["name"], job["status"]) for job in summary] == [
        ("missing", "failed"), ("broken", "failed"), ("good", "done"), ("again", "done")
    ]  # fmt: skip
    assert "no such capture" in summary[0]["error"] and "no light" in summary[1]["error"]
    assert summary[2]["metrics"]["emission_iou"] == 1.0 and summary[2]["figures"]["lights"] == 1
    with (tmp_path / "jobs" / "summary.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["status"] for row in table] == ["failed", "failed", "done", "done"]
    assert table[2]["emission_iou"] == "1.0" and table[3]["emission_iou"] == ""
    assert load_result(tmp_path / "jobs" / "good").report["preset"] == "draft"
    assert load_result(tmp_path / "elsewhere").report["preset"] == "balanced"
    out = capsys.readouterr().out
    assert all(word in out for word in ("again", "failed", "no light", "summary.csv"))


def test_a_traceback_that_cannot_be_written_does_not_stop_the_rest(tmp_path, stub_solve):
    for name in ("broken", "good"):
        write_truth_room(tmp_path / name)
    (tmp_path / "file").write_text("")
    jobs = write_jobs(tmp_path / "jobs.toml", {"capture": "broken", "out": "file/out"}, {"capture": "good"})
    assert cli.main(["batch", str(jobs)]) == 1
    failed, done = json.loads((tmp_path / "jobs" / "summary.json").read_text())["jobs"]
    assert "no light" in failed["error"] and "cannot be written" in failed["error"] and done["status"] == "done"


def test_batch_exits_0_when_all_is_done(fipt_room, tmp_path, stub_solve):
    assert cli.main(["batch", str(write_jobs(tmp_path / "jobs.toml", {"capture": fipt_room.root.name}))]) == 0


def test_a_cancelled_batch_keeps_its_summary(tmp_path, stub_solve):
    for name in ("good", "interrupted", "later"):
        write_truth_room(tmp_path / name)
    names = [{"capture": name} for name in ("good", "interrupted", "later")]
    assert cli.main(["batch", str(write_jobs(tmp_path / "jobs.toml", *names))]) == 130
    summary = json.loads((tmp_path / "jobs" / "summary.json").read_text())["jobs"]
    assert [job["status"] for job in summary] == ["done", "cancelled", "cancelled"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[job]", "not valid TOML"),
        ("", "no [[job]]"),
        ("x = 1\n[[job]]\ncapture = 'a'", "something else"),
        ("[[job]]\nname = 'a'", "no capture"),
        ("[[job]]\ncapture = 'a'\nspeed = 3", "unknown key 'speed'"),
        ("[[job]]\ncapture = 'a'\npreset = 'best'", "preset"),
        ("[[job]]\ncapture = 'a'\nseed = 'x'", "seed"),
        ("[[job]]\ncapture = 'a'\nexclude = 'b'", "exclude is 'b'"),
        ("[[job]]\ncapture = 'a'\nexclude = ['b', 3]", "exclude is ['b', 3]"),
        ("[[job]]\ncapture = 'a'\nmetres_per_unit = 0", "metres_per_unit is 0"),
        ("[[job]]\ncapture = 'a'\ncamera_height = true", "camera_height is True"),
        ("[[job]]\ncapture = 'a'\ncamera_height = 1.5\nmetres_per_unit = 2", "give one of them"),
        ("[[job]]\ncapture = 'a'\nname = '../a'", "name"),
        ("[[job]]\ncapture = 'a'\natlas_size = 1000", "job 1: atlas_size is 1000, neither auto nor a power of two"),
        ("[[job]]\ncapture = 'a'\natlas_size = true", "atlas_size is True"),
        ("[[job]]\ncapture = 'a'\ntexels_per_metre = nan", "texels_per_metre is nan"),
        ("[[job]]\ncapture = 'a'\ntexels_per_metre = [1]", "texels_per_metre is [1]"),
        ("[[job]]\ncapture = 'a'\n[[job]]\ncapture = 'a'", "two jobs"),
        ("[[job]]\ncapture = 'a'\n[[job.frames]]\nframes = '5-2'", "frames is '5-2'"),
        ("[[job]]\ncapture = 'a'\n[[job.frames]]\nframes = '1-2'\ncommand = 'paint'", "command is 'paint'"),
        ("[[job]]\ncapture = 'a'\n[[job.frames]]\nframes = '1-2'\ncommand = 'relight'", "lights is missing"),
        ("[[job]]\ncapture = 'a'\n[[job.frames]]\nframes = '1-2'\nlights = 'x'", "lights is not for render"),
        ("[[job]]\ncapture = 'a'\n[[job.frames]]\nframes = '1-2'\nsamples = -1", "samples is -1"),
    ],
)
def test_a_wrong_job_file_is_bad_input_before_anything_runs(tmp_path, text, says):
    path = tmp_path / "jobs.toml"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        read_jobs(path)
    assert says in str(caught.value) and str(path) in str(caught.value)


def test_paths_of_jobs_are_relative_to_their_file(tmp_path):
    path = write_jobs(
        tmp_path / "jobs.toml",
        {"capture": "a", "exposures": "times.csv", "response": "gamma", "hdr": "exr", "exclude": ["b", "c"]},
    )
    (job,) = read_jobs(path)
    assert job.exclude == ("b", "c")
    assert job.capture == tmp_path / "a" and job.out == tmp_path / "jobs" / "a"
    assert job.config.exposures == tmp_path / "times.csv" and job.config.hdr == tmp_path / "exr"
    assert job.config.response == "gamma"


def test_jobs_have_the_size_of_their_textures(tmp_path):
    path = write_jobs(
        tmp_path / "jobs.toml",
        {"capture": "a", "atlas_size": 4096, "texels_per_metre": 120},
        {"capture": "b", "atlas_size": "auto", "texels_per_metre": 0.5},
    )
    both, density = (job.config for job in read_jobs(path))
    assert (both.atlas_size, both.texels_per_metre) == (4096, 120)
    assert (density.atlas_size, density.texels_per_metre) == ("auto", 0.5)


def test_a_job_has_the_unit_of_its_file(fipt_room, tmp_path, stub_solve):
    jobs = [{"capture": str(fipt_room.root), "name": name} for name in ("given", "scaled")]
    jobs[1]["metres_per_unit"] = 0.5
    assert cli.main(["batch", str(write_jobs(tmp_path / "jobs.toml", *jobs))]) == 0
    given, scaled = (load_result(tmp_path / "jobs" / job["name"]).mesh.vertices for job in jobs)
    np.testing.assert_allclose(scaled, 0.5 * given, atol=1e-6)


# ---- pictures ------------------------------------------------------------------------------------------------------


@pytest.fixture
def solved(tmp_path):
    write_truth_room(tmp_path / "room")
    save_result(true_result(), tmp_path / "result")
    return tmp_path


def test_evaluate_writes_its_file(solved, capsys):
    args = ["evaluate", str(solved / "result"), "--gt", str(solved / "room"), "--no-render"]
    assert cli.main([*args, "--json", str(solved / "scores.json")]) == 0
    scores = json.loads((solved / "scores.json").read_text())
    assert scores["kd_psnr"] > 60 and "lpips" in scores["left_out"]
    assert "left out: lpips" in capsys.readouterr().out
    assert cli.main([*args, "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["result"]["emission_iou"] == 1.0


@pytest.mark.bpy
def test_views_are_rendered_relit_and_filled(solved):
    pytest.importorskip("bpy")
    result, views = str(solved / "result"), str(solved / "room" / "val")
    few = ["--views", views, "--samples", "4"]
    assert cli.main(["render", result, *few, "--out", str(solved / "png")]) == 0
    assert cli.main(["render", result, *few, "--out", str(solved / "exr"), "--linear"]) == 0
    png, exr = read_image(solved / "png" / "000_0001.png"), read_exr(solved / "exr" / "000_0001.exr")
    expected = true_result().response.apply(exr * 0.5) * 255  # the exposure the capture records for that view
    assert np.abs(png - expected).max() < 1

    job = solved / "lights.json"
    job.write_text('{"recovered": {"all": {"scale": 2.0}}}')
    assert cli.main(["relight", result, "--lights", str(job), *few, "--out", str(solved / "twice"), "--linear"]) == 0
    assert np.allclose(read_exr(solved / "twice" / "000_0001.exr"), 2 * exr, rtol=0.05, atol=0.01)
    job.write_text('{"recovered": {"17": {"off": true}}}')
    assert cli.main(["relight", result, "--lights", str(job), *few, "--out", str(solved / "none")]) == 3

    ball = {"shape": "sphere", "center": [2, 1.5, 1.25], "radius": 0.4}
    job.write_text(json.dumps({"views": [{"view": 1, "objects": [ball]}]}))
    assert cli.main(["insert", result, "--objects", str(job), *few, "--out", str(solved / "ball")]) == 0
    assert [path.name for path in (solved / "ball").iterdir()] == ["001_0001.png"]
    job.write_text(json.dumps({"views": [{"view": 9, "objects": [ball]}]}))
    assert cli.main(["insert", result, "--objects", str(job), *few, "--out", str(solved / "ball")]) == 3


@pytest.mark.bpy
def test_apply_writes_a_blend(solved):
    pytest.importorskip("bpy")
    blend = solved / "scene.blend"
    assert cli.main(["apply", str(solved / "result"), "--blend", str(blend)]) == 0
    assert blend.stat().st_size > 1000


@pytest.mark.bpy
def test_a_probe_is_written_of_a_result_and_of_a_blend(solved, capsys):
    """Both hold the same light; the .blend has its room turned upright."""
    pytest.importorskip("bpy")
    result, blend = str(solved / "result"), solved / "room.blend"
    few = ["--at", "2", "1.5", "1.25", "--width", "32", "--samples", "16", "--out"]
    assert cli.main(["probe", result, *few, str(solved / "a.exr")]) == 0
    assert cli.main(["apply", result, "--blend", str(blend)]) == 0
    assert cli.main(["probe", str(blend), *few, str(solved / "b.exr")]) == 0
    one, other = read_exr(solved / "a.exr"), read_exr(solved / "b.exr")
    assert one.shape == (16, 32, 3) and one.max() > 1
    assert np.allclose(one.mean((0, 1)), other.mean((0, 1)), rtol=0.1)
    assert cli.main(["probe", result, *few, str(solved / "aces.exr"), "--acescg"]) == 0
    with OpenEXR.File(str(solved / "aces.exr")) as file:
        assert np.allclose(file.header()["chromaticities"], ACESCG.chromaticities, atol=1e-6)
    assert np.allclose(read_exr(solved / "aces.exr"), one @ REC709.matrix_to(ACESCG).T, rtol=1e-3, atol=1e-4)

    (solved / "off.json").write_text('{"recovered": {"all": {"off": true}}, "outside": 0}')
    assert cli.main(["probe", result, *few, str(solved / "c.exr"), "--lights", str(solved / "off.json")]) == 0
    assert read_exr(solved / "c.exr").max() < 1e-3
    capsys.readouterr()
    for wrong, told in (([result, *few, str(solved / "x.png")], ".exr"), ([str(solved / "no"), *few, "x.exr"], "no")):
        assert cli.main(["probe", *wrong]) == 3
        assert told in capsys.readouterr().err
