"""The transport cache: the same transport from disk, and no harm from a bad file or a full disk."""

from __future__ import annotations

import os
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from iris_addon.base.errors import IrisError
from iris_addon.base.progress import Progress
from iris_addon.config import preset
from iris_addon.model.capture import Capture
from iris_addon.rays.engines import EMBREE
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.patches import Surface, build_surface
from iris_addon.surface.primary_rays import trace_pixels
from iris_addon.surface.traced_room import TracedRoom
from iris_addon.transport import cache
from iris_addon.transport.transport import Transport
from tests.engine_room import Room, cameras, furnished_room


class Scene:
    def __init__(self, folder: Path) -> None:
        self.room: Room = furnished_room(np.inf)
        self.capture = Capture(name="room", root=folder, views=(), val_views=(), mesh=self.room.mesh)
        self.tracer = Tracer(self.room.mesh)
        samples = trace_pixels(self.tracer, cameras(4, 20, 15), Progress())
        self.surface: Surface = build_surface(self.room.mesh, samples, self.room.regions, 500, np.random.default_rng(0))

    def transport(self, n_rays: int = 16, seed: int = 0) -> Transport:
        regions = SimpleNamespace(of_face=self.room.regions)
        room = SimpleNamespace(capture=self.capture, tracer=self.tracer, patches=self.surface, regions=regions)
        config = preset("draft", gather_rays=n_rays, seed=seed, device="cpu")
        return cache.cached_transport(cast(TracedRoom, room), config, np.random.default_rng(seed), Progress())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def scene(folder: Path) -> Scene:
    return Scene(folder)


def same(a: object, b: object) -> bool:
    if is_dataclass(a):
        return all(same(getattr(a, field.name), getattr(b, field.name)) for field in fields(a))
    if isinstance(a, tuple):
        return all(same(x, y) for x, y in zip(a, b, strict=True))  # type: ignore[arg-type]
    return np.array_equal(a, b) and getattr(a, "dtype", None) == getattr(b, "dtype", None)  # type: ignore[arg-type]


def test_a_cached_transport_is_read_back_without_tracing(scene: Scene) -> None:
    first = scene.transport()
    traced = scene.tracer.rays_traced
    assert same(first, scene.transport())
    assert scene.tracer.rays_traced == traced


def test_other_rays_or_seeds_are_other_entries(scene: Scene, folder: Path) -> None:
    scene.transport()
    scene.transport(seed=1)
    scene.transport(n_rays=17)
    assert len(list(folder.glob("*.npz"))) == 3


def test_rays_of_another_engine_are_another_entry(scene: Scene, folder: Path) -> None:
    """Their last digits differ, and a solve repeats to the byte."""
    scene.transport()
    scene.tracer = Tracer(scene.room.mesh, engine=replace(EMBREE, name="other"))
    scene.transport()
    assert scene.tracer.rays_traced > 0 and len(list(folder.glob("*.npz"))) == 2


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 not an archive", None])
def test_a_damaged_entry_is_traced_again(scene: Scene, folder: Path, content: bytes | None) -> None:
    first = scene.transport()
    path = next(folder.glob("*.npz"))
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    assert same(first, scene.transport())
    assert path.stat().st_size > 1000


def test_a_disk_that_is_full_costs_only_the_cache(scene: Scene, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, _write: object) -> None:
        raise IrisError("cannot be written (No space left on device)", "free some space and run again", path)

    monkeypatch.setattr(cache, "write_arrays", full)
    assert scene.transport().n_seen == len(scene.surface.region)
    assert not list(folder.glob("*"))


def test_the_entries_used_last_are_kept(scene: Scene, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MAX_ENTRIES", 2)
    scene.transport(seed=0)
    first = next(folder.glob("*.npz"))
    scene.transport(seed=1)
    for path in folder.glob("*.npz"):
        os.utime(path, (1e9 - (path == first), 1e9 - (path == first)))
    scene.transport(seed=0)  # the older one, used again
    scene.transport(seed=2)
    assert first.exists()
    assert len(list(folder.glob("*.npz"))) == 2
    monkeypatch.setattr(cache, "MAX_BYTES", 1)
    scene.transport(seed=3)
    assert len(list(folder.glob("*.npz"))) == 1  # the newest always
