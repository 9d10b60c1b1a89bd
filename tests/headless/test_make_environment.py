"""What is checked before an environment is downloaded, for systems that are not at hand."""

from __future__ import annotations

import json
import sys
from pathlib import PureWindowsPath
from types import SimpleNamespace

import pytest

from headless import make_environment

BLENDER = r"C:\Users\username\AppData\Roaming\Blender Foundation\Blender\5.0"
EXTENSION = BLENDER + r"\extensions\.user\user_default\iris\environment\venv"
LOCAL = r"C:\Users\username\AppData\Local\iris\environment\venv"


def error(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_a_folder_too_deep_for_windows_is_refused_before_the_download(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        make_environment.check_length(PureWindowsPath(EXTENSION))
    said = error(capsys)
    assert "too long a path" in said["what"] and "LongPathsEnabled" in said["fix"]


def test_the_folder_used_on_windows_is_short_enough() -> None:
    make_environment.check_length(PureWindowsPath(LOCAL))


def test_an_intel_mac_is_told_plainly(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        make_environment.check_platform("darwin", "x86_64")
    assert "Intel Macs" in error(capsys)["what"]
    for system, machine in (("darwin", "arm64"), ("linux", "x86_64"), ("win32", "AMD64")):
        make_environment.check_platform(system, machine)


@pytest.mark.parametrize(
    ("card", "warp", "said"),
    [(None, True, "CPU"), ("Card", True, "Card with Warp"), ("Card", False, "Card without Warp, rays on the CPU")],
)
def test_a_python_says_what_a_solve_will_run_on(
    card: str | None, warp: bool, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cuda = SimpleNamespace(is_available=lambda: card is not None, get_device_name=lambda: card)
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(cuda=cuda, __version__="2.13.0+cu130"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object() if warp and name == "warp" else None)
    exec(make_environment.FOUND, {})
    assert capsys.readouterr().out.rstrip().endswith(f", torch 2.13.0, {said}")
