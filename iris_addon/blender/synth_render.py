"""Path-traced images of the scene itself, as it is or with its lamps changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..result.edits import Quad, Sphere
from .camera import add_camera, look_through
from .lights import add_quad
from .materials import black_material
from .render import render_linear, set_cycles
from .scene_out import add_sphere
from .synth_maps import Maps, render_maps
from .synth_scene import SceneEmitter
from .world import make_world

MAX_BOUNCES = 16


class Studio:
    """The scene with a camera that goes wherever a view is wanted."""

    def __init__(self, scene: bpy.types.Scene, samples: int, seed: int) -> None:
        self.scene, self.samples, self.seed = scene, samples, seed

    def radiance(self, camera: Camera) -> NDArray[np.float32]:
        """(H, W, 3) denoised linear radiance, scene-linear Rec.709."""
        set_cycles(self.scene, samples=self.samples, denoise=True, seed=self.seed, max_bounces=MAX_BOUNCES)
        with self._camera(camera) as thing:
            look_through(self.scene, camera, thing)
            return render_linear(self.scene)

    def maps(self, camera: Camera) -> Maps:
        """Ground-truth maps of the scene as it stands."""
        with self._camera(camera) as thing:
            return render_maps(self.scene, camera, thing)

    @contextmanager
    def _camera(self, camera: Camera) -> Iterator[bpy.types.Object]:
        thing = add_camera(camera, "synth view", self.scene.collection)
        data = thing.data
        try:
            yield thing
        finally:
            bpy.data.batch_remove([thing, data])

    @contextmanager
    def only_lit_by(
        self, kept: SceneEmitter | None, emitters: Sequence[SceneEmitter], lights: Sequence[Quad] = ()
    ) -> Iterator[None]:
        """Inside, every lamp but ``kept`` is black and off, as are lamp objects and the world; ``lights`` are added."""
        black = black_material("synth black")
        swapped = []
        for emitter in emitters:
            if emitter is kept:
                continue
            for slot in self.scene.objects[emitter.name].material_slots:
                if slot.material == emitter.material:
                    swapped.append((slot, slot.material))
                    slot.material = black
        lamps = [thing for thing in self.scene.objects if thing.type == "LIGHT" and not thing.hide_render]
        for lamp in lamps:
            lamp.hide_render = True
        world, self.scene.world = self.scene.world, make_world(None, 1.0, np.eye(3))
        added = [add_quad(quad, f"synth light {k}", self.scene.collection) for k, quad in enumerate(lights)]
        try:
            yield
        finally:
            _remove(added)
            for slot, material in swapped:
                slot.material = material
            for lamp in lamps:
                lamp.hide_render = False
            dark, self.scene.world = self.scene.world, world
            bpy.data.batch_remove([black, dark])

    @contextmanager
    def with_spheres(self, spheres: Sequence[Sphere]) -> Iterator[None]:
        """Inside, ``spheres`` are in the scene; their ``pass_index`` counts from 1, that of everything else is 0."""
        others = {thing: thing.pass_index for thing in self.scene.objects}
        for thing in others:
            thing.pass_index = 0
        added = [add_sphere(sphere, f"synth ball {k}", self.scene.collection) for k, sphere in enumerate(spheres)]
        for k, thing in enumerate(added):
            thing.pass_index = k + 1
        try:
            yield
        finally:
            _remove(added)
            for thing, index in others.items():
                thing.pass_index = index


def _remove(things: Sequence[bpy.types.Object]) -> None:
    meshes = [thing.data for thing in things]
    materials = [material for mesh in meshes for material in mesh.materials]
    bpy.data.batch_remove([*things, *meshes, *materials])
