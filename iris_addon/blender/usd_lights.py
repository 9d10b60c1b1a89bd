"""Lamps of an exported room as UsdLux lights: meshes that shine as their material glows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import bpy

from .version import usd_library


@contextmanager
def lamps_as_lights() -> Iterator[None]:
    """USD files written inside have lamps as lights; without USD's Python modules they stay emissive meshes."""
    library = usd_library()
    if library is None:
        yield
        return
    hook = _hook(library)
    bpy.utils.register_class(hook)
    try:
        yield
    finally:
        bpy.utils.unregister_class(hook)


def _hook(library: ModuleType) -> type:
    """The class that Blender calls; a build without USD has no base for it."""

    class LampsAsLights(bpy.types.USDHook):
        """Applies MeshLightAPI to lamps, so that renderers sample them as lights."""

        bl_idname = "iris_lamps_as_lights"
        bl_label = "IRIS lamps as lights"

        @staticmethod
        def on_export(context: Any) -> bool:
            """Called by Blender with the stage before it is saved."""
            for prim in context.get_stage().Traverse():
                if prim.IsA(library.UsdGeom.Mesh) and prim.GetParent().GetName().startswith("IRIS_Lamp"):
                    library.UsdLux.MeshLightAPI.Apply(prim)
                    light = library.UsdLux.LightAPI(prim)
                    # What the material emits, neither tinted nor scaled: radiance, whatever the area.
                    light.CreateMaterialSyncModeAttr(library.UsdLux.Tokens.materialGlowTintsLight)
                    light.CreateIntensityAttr(1.0)
                    light.CreateNormalizeAttr(False)
            return True

    return LampsAsLights
