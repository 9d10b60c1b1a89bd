"""IRIS for Blender: the extension's entry. Everything is imported on registration, so that other tools may import
nothing."""


def register() -> None:
    """Called by Blender when the extension is enabled."""
    from . import operators

    operators.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    from . import operators

    operators.unregister()
