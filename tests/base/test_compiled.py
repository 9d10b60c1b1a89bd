"""Compiled loops: kept from one process to the next, and made anew when any of their sources changes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from iris_addon.base.compiled import rows_of

ROOT = Path(__file__).parents[2]
SUM = """
import sys
sys.path.insert(0, {root!r})
import numpy as np
from iris_addon.base.group_by import group_sums
print(group_sums(np.ones((4, 2), np.float32), np.array([0, 1, 1, 3]), 4)[:, 0])
"""


def run(cache: Path, root: Path = ROOT, before: str = "") -> None:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"XDG_CACHE_HOME": str(cache), "HOME": str(cache), "LOCALAPPDATA": str(cache)}
    code = before + SUM.format(root=str(root))
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[1. 2. 0. 1.]", done.stderr


def kept(cache: Path) -> set[Path]:
    return {path for path in cache.rglob("*") if path.suffix == ".nbc"}


def test_a_second_process_compiles_nothing(tmp_path):
    run(tmp_path)
    first = {path: path.stat().st_mtime_ns for path in kept(tmp_path)}
    run(tmp_path)
    assert first and {path: path.stat().st_mtime_ns for path in kept(tmp_path)} == first


def test_a_changed_kernel_is_compiled_anew_wherever_it_is_called_from(tmp_path):
    """Numba itself looks at the file of the caller alone."""
    root = tmp_path / "copy"
    for module in ("__init__", "compiled", "errors", "files", "group_by", "parallel", "untrusted"):
        name = f"base/{module}.py"
        (root / "iris_addon" / name).parent.mkdir(parents=True, exist_ok=True)
        (root / "iris_addon" / name).write_bytes((ROOT / "iris_addon" / name).read_bytes())
    (root / "iris_addon" / "__init__.py").touch()
    run(tmp_path / "cache", root)
    before = kept(tmp_path / "cache")
    source = ["from .compiled import inlined", "@inlined", "def one():", "    return 1"]
    (root / "iris_addon" / "base" / "called.py").write_text("\n".join(source))
    run(tmp_path / "cache", root)
    folders = {path.parents[1].name for path in kept(tmp_path / "cache") - before}
    assert len(folders) == 1 and folders.isdisjoint(path.parents[1].name for path in before)


def test_kernels_run_uncached_where_the_cache_folder_cannot_be_written(tmp_path):
    nowhere = tmp_path / "file"
    nowhere.touch()
    run(nowhere)


def test_rows_of_selects_rows_of_every_column():
    class Pair(NamedTuple):
        a: np.ndarray
        b: np.ndarray

    some = rows_of(Pair(np.arange(4), 10 * np.arange(4)), np.array([True, False, True, False]))
    assert isinstance(some, Pair) and some.a.tolist() == [0, 2] and some.b.tolist() == [0, 20]


def test_a_damaged_file_of_compiled_code_is_made_again(tmp_path):
    """Numba itself raises what unpickling does, in every later process."""
    run(tmp_path)
    for suffix, size in ((".nbi", 40), (".nbc", 40), (".nbi", 0)):
        damaged = [path for path in tmp_path.rglob("*") if path.suffix == suffix]
        for path in damaged:
            path.write_bytes(path.read_bytes()[:size])
        run(tmp_path)
        assert damaged and all(path.stat().st_size > 40 for path in damaged)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX limits and permissions")
def test_a_full_disk_costs_time_alone(tmp_path):
    begin = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    run(tmp_path, before=begin + "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))")
    assert not kept(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX limits and permissions")
def test_compiled_code_is_not_read_from_a_folder_that_others_write(tmp_path):
    """The files are pickles: reading one runs what it says."""
    run(tmp_path)
    (folder,) = (tmp_path / "iris" / "kernels").iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    files = kept(tmp_path)
    folder.chmod(0o777)
    for path in files:
        path.unlink()
    run(tmp_path)
    assert files and not kept(tmp_path)


@pytest.mark.parametrize("text", ["cache_dir: planted\n", "a: [\n", "disable_jit: 1\nopt: many\n"])
def test_a_configuration_in_the_current_folder_is_not_read(tmp_path, text):
    """It can name a folder of compiled code, which lies beside it and runs what it says."""
    pytest.importorskip("yaml", reason="Numba reads the file by PyYAML")
    foreign = tmp_path / "stranger"
    (foreign / "planted").mkdir(mode=0o700, parents=True)
    (foreign / ".numba_config.yaml").write_text(text)
    run(tmp_path, before=f"import os\nos.chdir({str(foreign)!r})\n")
    assert kept(tmp_path) and not kept(foreign) and not list((foreign / "planted").iterdir())
