"""Lamps of an exported room as UsdLux lights: meshes that shine as their material glows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from .version import usd_library


class LampsAsLights(bpy.types.USDHook):
    """Applies MeshLightAPI to what Blender exports as emissive meshes, so that renderers sample them as lights."""

    bl_idname = "iris_lamps_as_lights"
    bl_label = "IRIS lamps as lights"

    @staticmethod
    def on_export(context: Any) -> bool:
        """Called by Blender with the stage before it is saved."""
        library = usd_library()
        assert library is not None  # registered only where there is one
        for prim in context.get_stage().Traverse():
            if prim.IsA(library.UsdGeom.Mesh) and prim.GetParent().GetName().startswith("IRIS_Lamp"):
                library.UsdLux.MeshLightAPI.Apply(prim)
                light = library.UsdLux.LightAPI(prim)
                # What the material emits, neither tinted nor scaled: radiance, whatever the area.
                light.CreateMaterialSyncModeAttr(library.UsdLux.Tokens.materialGlowTintsLight)
                light.CreateIntensityAttr(1.0)
                light.CreateNormalizeAttr(False)
        return True


@contextmanager
def lamps_as_lights() -> Iterator[None]:
    """USD files written inside have lamps as lights; without USD's Python modules they stay emissive meshes."""
    if usd_library() is None:
        yield
        return
    bpy.utils.register_class(LampsAsLights)
    try:
        yield
    finally:
        bpy.utils.unregister_class(LampsAsLights)
