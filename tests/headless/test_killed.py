"""The real command killed, interrupted, refused and short of space: what it leaves behind, and --resume."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from iris_addon.model.response import gamma
from iris_addon.rays.tracer import Tracer
from iris_addon.results.files import FILES, result_file
from iris_addon.results.folder import load_result, save_result
from tests.engine_room import cameras, furnished_room, photograph, render, same_results, write_capture
from tests.result_room import room

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")

RUN = Path(__file__).resolve().parents[2] / "headless" / "run.py"
STAGES = ("photos", "surface", "transport", "response", "lights", "materials", "textures", "report")
KILL_AT_FILE = """
import os, runpy, signal, sys
event, pattern, run = sys.argv[1:4]
def hook(name, args):
    if name == event and pattern in " ".join(map(str, args[:2])):
        os.kill(os.getpid(), signal.SIGKILL)
sys.argv[:] = sys.argv[3:]
sys.addaudithook(hook)
runpy.run_path(run, run_name="__main__")
"""
"""Runs the command and kills it where Python opens or renames a file of that name."""
DEAF = """
import hashlib, os, signal, sys, types
sys.path.insert(0, sys.argv[1])
from headless import cli
def solve(*_args, **_more):
    os.kill(os.getpid(), signal.SIGINT)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
sys.modules["iris_addon.pipeline"] = types.ModuleType("iris_addon.pipeline")
sys.modules["iris_addon.pipeline"].solve = solve
sys.exit(cli.main(sys.argv[2:]))
"""
"""A solve that is in one call of C for half an hour when the signal comes."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny room on disk."""
    fine, views = furnished_room(), cameras(8, 32, 24)
    radiance = render(fine, Tracer(fine.mesh), views, 64)
    stops = 2.0 ** np.array([0, -3, 1, -2, -1, -4, 0.5, -1])
    exposures = 0.25 / np.median(radiance.mean(-1).reshape(8, -1), 1) * stops
    folder = tmp_path_factory.mktemp("capture") / "tiny"
    return write_capture(photograph(furnished_room(np.inf), views, radiance, exposures, gamma(), folder))


@pytest.fixture(scope="module")
def reference(capture: Path) -> Path:
    """A solve that nothing disturbed."""
    out = capture.parent / "reference"
    assert solve(capture, out).returncode == 0
    return out


def command(capture: Path, out: Path, *more: str) -> list[str]:
    return [str(RUN), "solve", str(capture), "--out", str(out), "--preset", "draft", "--response", "gamma", *more]


def environment(out: Path) -> dict[str, str]:
    """With a transport cache of its own, so that every run traces."""
    return {**os.environ, "IRIS_CACHE": str(out.with_name(out.name + " cache"))}


def solve(capture: Path, out: Path, *more: str) -> subprocess.CompletedProcess[str]:
    arguments = [sys.executable, *command(capture, out, *more)]
    return subprocess.run(arguments, capture_output=True, text=True, env=environment(out), check=False)


def signalled(capture: Path, out: Path, stage: str, number: signal.Signals) -> tuple[int, str]:
    """Exit code and stderr of a solve that gets a signal as soon as it says that it is in ``stage``."""
    arguments = [sys.executable, *command(capture, out, "--json")]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(out)
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if json.loads(line).get("stage") == stage:
                process.send_signal(number)
                break
        _, errors = process.communicate()
    return process.returncode, errors


def files_of(folder: Path) -> dict[str, bytes]:
    """What a result consists of; stage files and pictures come and go."""
    paths = [*folder.glob("*.json"), *(folder / "materials").iterdir()]
    return {path.name: path.read_bytes() for path in paths}


def as_read(out: Path) -> Path:
    """A copy of the files that whoever reads the result in ``out`` is given."""
    found = out.with_name(f"{out.name} as read")
    for name in FILES:
        source = result_file(out, name)
        if source.is_file():
            (found / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, found / name)
    return found


def visible(folder: Path) -> list[str]:
    """Names in a folder; a killed process may leave a temporary file, whose name begins with a dot."""
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder with an earlier result."""
    save_result(room(), tmp_path / "out")
    return tmp_path / "out"


# ---- stopped and resumed -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_stopped_in_a_stage_and_resumed(
    capture: Path, reference: Path, out: Path, stage: str, number: signal.Signals
) -> None:
    before = files_of(out)
    code, errors = signalled(capture, out, stage, number)
    assert files_of(out) == before
    if number == signal.SIGINT:
        assert code == 130
        assert errors.startswith("error: cancelled — ") and errors.count("\n") == 1
    else:
        assert code == -signal.SIGKILL
    assert solve(capture, out, "--resume").returncode == 0
    assert same_results(reference, out)
    assert visible(out) == visible(reference)


def test_a_folder_is_solved_by_one_process_until_that_ends(capture: Path, out: Path) -> None:
    """Another Blender on the same folder is told so and touches nothing; a killed one leaves the folder free."""
    holder = (
        "import sys; from pathlib import Path; from iris_addon.results.checkpoints import sole_writer\n"
        "with sole_writer(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    )
    before = files_of(out)
    process = subprocess.Popen(
        [sys.executable, "-c", holder, str(out)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=RUN.parents[1],
    )
    with process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        refused = solve(capture, out)
        process.kill()
    assert refused.returncode == 3
    assert refused.stderr.startswith(f"error: {out}: is being solved by another program — wait")
    assert files_of(out) == before
    assert solve(capture, out).returncode == 0


WRITES = {
    "transport opened": ("open", "/.transport-"),
    "transport written": ("os.rename", "/.transport-"),
    "stage opened": ("open", "/.lights-"),
    "stage written": ("os.rename", "/.lights-"),
    "texture opened": ("open", "/.roughness-"),
    "result begun": ("open", "/emitters.json"),
    "result written": ("os.rename", "/.whole"),
    "first file moved": ("os.rename", "/.whole/materials/mesh.glb"),
    "last file moved": ("os.rename", "/.whole/report.json"),
    "report": ("os.rename", "/report.html"),
}


@pytest.mark.slow
@pytest.mark.parametrize("moment", WRITES)
def test_killed_while_a_file_is_written_and_resumed(capture: Path, reference: Path, out: Path, moment: str) -> None:
    before = files_of(out)
    arguments = [sys.executable, "-c", KILL_AT_FILE, *WRITES[moment], *command(capture, out)]
    assert subprocess.run(arguments, env=environment(out), capture_output=True, check=False).returncode == -9
    load_result(out)
    found = as_read(out)
    assert files_of(found) == before or same_results(reference, found)
    assert solve(capture, out, "--resume").returncode == 0
    assert same_results(reference, out)
    assert visible(out) == visible(reference)


def test_interrupted_in_a_call_that_hears_nothing(capture: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", DEAF, str(RUN.parents[1]), *command(capture, tmp_path / "out", "--json")[1:]],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 130
    assert done.stderr.startswith("error: cancelled — ") and done.stderr.count("\n") == 1
    assert json.loads(done.stdout.splitlines()[-1])["exit_code"] == 130


# ---- refused -------------------------------------------------------------------------------------------------------


def change_frames(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def damage(capture: Path) -> None:
        meta = json.loads((capture / "transforms.json").read_text())
        change(meta)
        (capture / "transforms.json").write_text(json.dumps(meta))

    return damage


def truncated_jpeg(capture: Path) -> None:
    photo = capture / "002.jpg"
    Image.open(capture / "002.png").save(photo)
    photo.write_bytes(photo.read_bytes()[: photo.stat().st_size // 2])
    change_frames(lambda meta: meta["frames"][2].update(file_path=photo.name))(capture)


def move_mesh(move: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def damage(capture: Path) -> None:
        mesh = trimesh.load(capture / "mesh.obj", force="mesh", process=False)
        (capture / "mesh.obj").unlink()
        trimesh.Trimesh(move(mesh.vertices), mesh.faces, process=False).export(capture / "mesh.ply")

    return damage


BAD = {
    "truncated jpeg": (truncated_jpeg, "002.jpg"),
    "missing photo": (lambda capture: (capture / "003.png").unlink(), "003"),
    "nan pose": (change_frames(lambda meta: meta["frames"][1]["transform_matrix"][0].__setitem__(0, np.nan)), "001"),
    "empty mesh": (lambda capture: (capture / "mesh.obj").write_text(""), "mesh.obj"),
    "photo of another size": (lambda capture: Image.new("RGB", (64, 48)).save(capture / "001.png"), "001.png"),
    "mesh in millimetres": (move_mesh(lambda v: v * 1000), "mesh.ply"),
    "mesh that no photo sees": (move_mesh(lambda v: v + [500, 0, 0]), "mesh.ply"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_input_is_one_line_exits_3_and_touches_nothing(capture: Path, out: Path, kind: str) -> None:
    damaged = out.parent / "damaged"
    damaged.mkdir()
    for path in capture.iterdir():
        (damaged / path.name).write_bytes(path.read_bytes())
    damage, named = BAD[kind]
    damage(damaged)
    before, names = files_of(out), sorted(out.iterdir())
    done = solve(damaged, out, "--strict")
    assert done.returncode == 3 and not done.stdout
    assert done.stderr.startswith("error: ") and " — " in done.stderr and done.stderr.count("\n") == 1
    assert named in done.stderr
    assert files_of(out) == before and sorted(out.iterdir()) == names


FULL_DISK = 'mount -t tmpfs -o size=200k tmpfs "$1" && cp -r "$2"/. "$1" && shift 2 && exec "$@"'
"""In a mount namespace of its own: a disk that holds the earlier result and little more."""


def test_a_full_disk_is_one_line_exits_1_and_touches_nothing(capture: Path, out: Path) -> None:
    disk = out.parent / "disk"
    disk.mkdir()
    space = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", FULL_DISK, "sh", str(disk), str(out)]
    if subprocess.run([*space, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no small disk can be mounted here")
    script = '"$@"; code=$?; cp -r "$0"/. "$0"/../after; exit $code'
    run = ["sh", "-c", script, str(disk), sys.executable, *command(capture, disk)]
    done = subprocess.run([*space, *run], capture_output=True, text=True, env=environment(out), check=False)
    errors = [line for line in done.stderr.splitlines() if line not in STAGES]
    assert done.returncode == 1 and not done.stdout
    assert len(errors) == 1 and errors[0].startswith("error: ") and "free some space" in errors[0]
    assert files_of(out.parent / "after") == files_of(out)
