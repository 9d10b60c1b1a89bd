"""The one place that knows how Blender 4.2 to 5.2 differ, and what this build of it can do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..errors import IrisError


def node_tree(owner: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """The emptied shader node tree of a material or world; since 5.0 each is born with one and ``use_nodes`` warns."""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


@contextmanager
def multilayer_exr(settings: bpy.types.ImageFormatSettings) -> Iterator[None]:
    """Renders written inside hold every pass in one 32-bit EXR; since 5.0 that is a media type besides a format."""
    typed = bpy.app.version >= (5, 0, 0)
    if typed:
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth, settings.exr_codec = "32", "NONE"
    try:
        yield
    finally:
        if typed:
            settings.media_type = "IMAGE"
        settings.file_format = "OPEN_EXR"


def can_denoise() -> bool:
    """Whether Cycles of this build has OpenImageDenoise; builds from a distribution often lack it."""
    import _cycles  # the extension module exists only inside Blender

    return bool(_cycles.with_openimagedenoise)


def require_build_option(option: str, what: str) -> None:
    """Raise :class:`IrisError` unless ``bpy.app.build_options`` has ``option``; ``what`` names what needs it."""
    if not getattr(bpy.app.build_options, option, False):
        raise IrisError(
            f"{what} needs Blender built with {option}, and this build ({bpy.app.version_string}) has none",
            "use Blender from blender.org, or leave this output out",
        )


def enable_gpu() -> bool:
    """Let Cycles use the fastest kind of GPU at hand; False where there is none."""
    addon = bpy.context.preferences.addons.get("cycles")
    if addon is None:
        return False
    preferences = addon.preferences
    available = {kind[0] for kind in preferences.get_device_types(bpy.context)}
    for kind in ("OPTIX", "CUDA", "HIP", "METAL", "ONEAPI"):
        if kind not in available:
            continue
        preferences.compute_device_type = kind
        preferences.refresh_devices()
        devices = [device for device in preferences.devices if device.type == kind]
        for device in devices:
            device.use = True
        if devices:
            return True
    preferences.compute_device_type = "NONE"
    return False
