"""What a scene remembers about its capture."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy


class IrisSettings(bpy.types.PropertyGroup):
    """Scene.iris: the capture to solve and how."""

    capture: bpy.props.StringProperty(
        name="Capture", description="Folder with photos, poses and mesh of the room", subtype="DIR_PATH"
    )
    result: bpy.props.StringProperty(
        name="Result", description="Folder for the result; empty: beside the capture", subtype="DIR_PATH"
    )
    preset: bpy.props.EnumProperty(
        name="Preset",
        items=(
            ("draft", "Draft", "Coarse patches, small textures: a first look"),
            ("balanced", "Balanced", "For most rooms"),
            ("final", "Final", "Fine patches, many rays, large textures"),
        ),
        default="balanced",
    )
