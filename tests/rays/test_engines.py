"""What rays run on: Warp where a solve has a GPU and Warp works, else Embree, and a word on why."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from iris_addon.rays.engines import EMBREE, choose_engine, warp_engine


def test_rays_run_by_embree_on_a_cpu() -> None:
    assert choose_engine("cpu") is EMBREE
    assert EMBREE.warning == ""


def test_without_warp_rays_run_by_embree_and_the_user_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "warp", None)
    monkeypatch.delitem(sys.modules, "iris_addon.rays.warp_mesh", raising=False)
    engine = choose_engine("cuda")
    assert (engine.name, engine.intersector) == (EMBREE.name, EMBREE.intersector)
    assert "rays run on the CPU" in engine.warning and "install warp-lang" in engine.warning


def test_another_package_of_that_name_is_not_warp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "warp", ModuleType("warp"))
    monkeypatch.delitem(sys.modules, "iris_addon.rays.warp_mesh", raising=False)
    engine = choose_engine("cuda")
    assert engine.name == EMBREE.name and "install warp-lang 1.19.0" in engine.warning


def test_without_a_card_warp_is_not_used_for_one() -> None:
    wp = pytest.importorskip("warp", reason="Warp is not installed: the extra cuda of pyproject.toml")
    engine = warp_engine("cpu")
    assert engine.name == "warp-cpu"
    if wp.is_cuda_available():
        pytest.skip("there is a card")
    engine = warp_engine("cuda")
    assert engine.name == EMBREE.name and "no CUDA device" in engine.warning


def test_warp_is_imported_only_where_it_is_asked_for() -> None:
    script = (
        "import sys, iris_addon.pipeline; from iris_addon.rays.engines import choose_engine;"
        "choose_engine('cpu'); sys.exit('warp' in sys.modules)"
    )
    root = Path(__file__).resolve().parents[2]
    assert subprocess.run([sys.executable, "-c", script], cwd=root, check=False).returncode == 0
