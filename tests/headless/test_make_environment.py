"""What is checked before an environment is downloaded, for systems that are not at hand."""

from __future__ import annotations

import json
from pathlib import PureWindowsPath

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
