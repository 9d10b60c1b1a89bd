"""Preferences of the extension: the Python that solves."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

ROOT_PACKAGE = str(__package__).rpartition(".")[0]


class IrisPreferences(bpy.types.AddonPreferences):
    """Where the solver's Python is."""

    bl_idname = ROOT_PACKAGE

    python: bpy.props.StringProperty(
        name="Solver Python",
        description="Python with torch and the other packages of the solver; Blender's own has none of them",
        subtype="FILE_PATH",
    )

    def draw(self, _context: bpy.types.Context) -> None:
        """The preferences as Blender shows them."""
        self.layout.prop(self, "python")
        if not self.python:
            self.layout.label(text="Needed to solve; applying a finished result works without", icon="INFO")


def solver_python(context: bpy.types.Context) -> str:
    """Path of the solver's Python, empty where none is set."""
    return bpy.path.abspath(context.preferences.addons[ROOT_PACKAGE].preferences.python)
