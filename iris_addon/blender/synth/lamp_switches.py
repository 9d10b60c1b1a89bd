"""Lamps that are switched from photo to photo, for captures of several light states.

A camera names the light state of its photo by the custom property ``iris_light_state``. A lamp whose object has the
custom property ``iris_on_in``, names of states separated by commas, shines in these alone; in others its object has the
material that its custom property ``iris_unlit`` is. A reference for insertion is rendered in the state of its view;
that of one lamp alone says in which state the lamp shines so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy

from ...base.errors import BadInput
from .scene import SceneEmitter

LIGHT_STATE, ON_IN, UNLIT = "iris_light_state", "iris_on_in", "iris_unlit"
"""Custom properties of a camera, and of a lamp's object."""


@dataclass(frozen=True)
class _Switched:
    """A lamp that shines in the states ``on_in`` alone: the slots of its object, with both materials."""

    on_in: frozenset[str]
    slots: tuple[bpy.types.MaterialSlot, ...]
    lit: bpy.types.Material
    unlit: bpy.types.Material


@dataclass(frozen=True)
class LampSwitches:
    """The lamps of a scene that are off in some light states."""

    lamps: tuple[_Switched, ...]

    @staticmethod
    def of(scene: bpy.types.Scene, emitters: Sequence[SceneEmitter]) -> LampSwitches:
        """The switches of ``emitters``.

        Raises:
            BadInput: the material of an unlit lamp is not there.
        """
        found = []
        for emitter in emitters:
            thing = scene.objects[emitter.name]
            if ON_IN not in thing:
                continue
            unlit = thing.get(UNLIT)
            if not isinstance(unlit, bpy.types.Material):
                raise BadInput(
                    f"the lamp '{thing.name}' has states in which it is off and no material for them",
                    f"give it one as its custom property {UNLIT}",
                    bpy.data.filepath or None,
                )
            states = frozenset(name.strip() for name in str(thing[ON_IN]).split(","))
            slots = tuple(slot for slot in thing.material_slots if slot.material == emitter.material)
            found.append(_Switched(states, slots, emitter.material, unlit))
        return LampSwitches(tuple(found))

    @property
    def unlit(self) -> list[bpy.types.Material]:
        """Materials of lamps that are off."""
        return [lamp.unlit for lamp in self.lamps]

    def shines_in(self, emitter: SceneEmitter, state: str) -> bool:
        """Whether ``emitter`` is on in the light state ``state``."""
        return all(state in lamp.on_in for lamp in self.lamps if lamp.lit == emitter.material) if state else True

    @contextmanager
    def in_state(self, name: str) -> Iterator[None]:
        """Inside, only the lamps of the light state ``name`` are on; with "" all are."""
        off = [lamp for lamp in self.lamps if name and name not in lamp.on_in]
        for lamp in off:
            for slot in lamp.slots:
                slot.material = lamp.unlit
        try:
            yield
        finally:
            for lamp in off:
                for slot in lamp.slots:
                    slot.material = lamp.lit
