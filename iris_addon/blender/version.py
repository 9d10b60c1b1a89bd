"""Differences between Blender 4.2 and 5.2, and capabilities of this build; no other module checks versions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.errors import IrisError


def node_tree(owner: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """The emptied shader node tree of a material or world, which has one from the start since 5.0."""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def set_corner_normals(data: bpy.types.Mesh, normals: NDArray[np.floating]) -> None:
    """Shade the corners of ``data`` by unit ``normals`` (L, 3) in its own space.

    Since 4.5 they are kept as they are; before, and for a million faces in three seconds, as angles to Blender's own.
    """
    data.shade_smooth()  # flat faces ignore normals of their own
    if bpy.app.version < (4, 5, 0):
        data.normals_split_custom_set(normals)
        return
    held = data.attributes.get("custom_normal")
    if held is not None:
        data.attributes.remove(held)
    held = data.attributes.new("custom_normal", "FLOAT_VECTOR", "CORNER")
    held.data.foreach_set("vector", np.ascontiguousarray(normals, np.float32).ravel())
    data.update()


@contextmanager
def multilayer_exr(settings: bpy.types.ImageFormatSettings) -> Iterator[None]:
    """Renders written inside hold every pass in one 32-bit EXR."""
    _exr(settings, "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER")
    try:
        yield
    finally:
        single_layer_exr(settings)


def single_layer_exr(settings: bpy.types.ImageFormatSettings) -> None:
    """Pictures are saved as a 32-bit EXR, whatever the artist's output was set to."""
    _exr(settings, "IMAGE", "OPEN_EXR")


def _exr(settings: bpy.types.ImageFormatSettings, media_type: str, file_format: str) -> None:
    if bpy.app.version >= (5, 0, 0):  # formats depend on the media type
        settings.media_type = media_type
    settings.file_format = file_format
    settings.color_depth, settings.exr_codec = "32", "NONE"


def set_panoramic(camera: bpy.types.Camera) -> None:
    """Let ``camera`` render equirectangular pictures of all directions; their lens was Cycles' own in some versions."""
    camera.type = "PANO"
    own = getattr(camera, "cycles", None)  # 4.5 has it, Debian's 4.3 and 5.0 do not
    owner = camera if own is None or not hasattr(own, "panorama_type") else own
    owner.panorama_type = "EQUIRECTANGULAR"
    owner.latitude_min, owner.latitude_max = -math.pi / 2, math.pi / 2
    owner.longitude_min, owner.longitude_max = -math.pi, math.pi


def compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """The node tree that renders of ``scene`` pass through, None where there is none."""
    name = "node_tree" if bpy.app.version < (5, 0, 0) else "compositing_node_group"
    return getattr(scene, name)


def remove_lightgroup(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, name: str) -> None:
    """Remove the light group ``name`` of a view layer of ``scene``; 4.3 has only an operator for it."""
    if hasattr(layer.lightgroups, "remove"):
        layer.lightgroups.remove(layer.lightgroups[name])
        return
    layer.active_lightgroup_index = layer.lightgroups.find(name)
    with bpy.context.temp_override(scene=scene, view_layer=layer):
        bpy.ops.scene.view_layer_remove_lightgroup()


EEVEE = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")
"""Two names of one engine: the second from 4.2 to 4.5."""


def set_engine(scene: bpy.types.Scene, engine: str) -> None:
    """Render ``scene`` with ``engine``, under its name in this release; does nothing where it is missing."""
    for name in EEVEE if engine in EEVEE else (engine,):
        try:
            scene.render.engine = name
        except TypeError:  # not an engine of this build, and there is no list of engines to ask
            continue
        return


def can_denoise() -> bool:
    """Whether Cycles of this build has OpenImageDenoise; builds from a distribution often lack it."""
    import _cycles  # the extension module exists only inside Blender

    return bool(_cycles.with_openimagedenoise)


def require_build_option(option: str, what: str) -> None:
    """Raise :class:`IrisError` unless ``bpy.app.build_options`` has ``option``; ``what`` needs it."""
    if not getattr(bpy.app.build_options, option, False):
        raise IrisError(
            f"{what} needs Blender built with {option}, and this build ({bpy.app.version_string}) has none",
            "use Blender from blender.org, or leave this output out",
        )


def usd_library() -> ModuleType | None:
    """Blender's own USD modules (``pxr``) with UsdGeom and UsdLux loaded; None in a build without them.

    The bpy package has them among Blender's bundled modules, which must be exposed since 4.4.
    """
    if not bpy.app.build_options.usd:
        return None
    if hasattr(bpy.utils, "expose_bundled_modules"):
        bpy.utils.expose_bundled_modules()
    try:
        import_module("pxr.UsdGeom")
        import_module("pxr.UsdLux")
        return import_module("pxr")
    except ModuleNotFoundError:
        return None


def require_gltf() -> None:
    """Raise :class:`IrisError` unless Blender's own glTF add-on is enabled."""
    if not hasattr(bpy.types, "IMPORT_SCENE_OT_gltf"):
        raise IrisError(
            "Blender's add-on for glTF files is switched off",
            "enable 'glTF 2.0 format' under Preferences > Add-ons, or leave .glb files out",
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


# ---- compositor: a tree of the scene up to 4.5, a node group with shader nodes for arithmetic since 5.0 --------------


def own_compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The compositing tree of ``scene``, created and switched on where there is none."""
    if bpy.app.version < (5, 0, 0):
        new, scene.use_nodes = scene.node_tree is None, True
        if new:
            scene.node_tree.nodes.clear()  # a new tree has nodes that render the open scene
        return scene.node_tree
    if scene.compositing_node_group is None:
        scene.compositing_node_group = bpy.data.node_groups.new(f"{scene.name} Compositing", "CompositorNodeTree")
    return scene.compositing_node_group


def composites(scene: bpy.types.Scene) -> bool:
    """Whether renders of ``scene`` pass through a compositing tree."""
    return compositor_tree(scene) is not None and (bpy.app.version >= (5, 0, 0) or scene.use_nodes)


def leave_compositor_tree(scene: bpy.types.Scene) -> None:
    """Detach the compositing tree of ``scene``; a tree without nodes is removed."""
    tree = compositor_tree(scene)
    if bpy.app.version < (5, 0, 0):  # the tree belongs to the scene
        scene.use_nodes = False
        return
    scene.compositing_node_group = None
    if tree is not None and not tree.users and not tree.nodes:
        bpy.data.node_groups.remove(tree)


def compositor_output(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """The socket of ``tree`` for the finished picture, created where there is none."""
    old = bpy.app.version < (5, 0, 0)
    kind = "CompositorNodeComposite" if old else "NodeGroupOutput"
    if not old and not any(i.item_type == "SOCKET" and i.in_out == "OUTPUT" for i in tree.interface.items_tree):
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    node = next((node for node in tree.nodes if node.bl_idname == kind), None) or tree.nodes.new(kind)
    return node.inputs[0]


def compositor_math(tree: bpy.types.NodeTree, operation: str) -> bpy.types.Node:
    """A node for arithmetic on one channel: inputs 0 and 1, output 0."""
    node = tree.nodes.new("CompositorNodeMath" if bpy.app.version < (5, 0, 0) else "ShaderNodeMath")
    node.operation = operation
    return node


def compositor_mix(
    tree: bpy.types.NodeTree, blend_type: str
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """A node that combines two colours ("ADD", "MULTIPLY") in full: its sockets A, B and result."""
    if bpy.app.version < (5, 0, 0):
        node = tree.nodes.new("CompositorNodeMixRGB")
        node.inputs[0].default_value = 1.0
        a, b, result = node.inputs[1], node.inputs[2], node.outputs[0]
    else:
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type, node.clamp_result = "RGBA", False
        node.inputs[0].default_value = 1.0
        a, b = (socket for socket in node.inputs if socket.type == "RGBA")
        result = next(socket for socket in node.outputs if socket.type == "RGBA")
    node.blend_type = blend_type
    return a, b, result


def compositor_denoise(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """A denoising node that prefilters its guides fast: accurate prefiltering leaks one picture per render (5.0)."""
    node = tree.nodes.new("CompositorNodeDenoise")
    if bpy.app.version < (5, 0, 0):
        node.prefilter = "FAST"
    else:
        node.inputs["Prefilter"].default_value = "Fast"
    return node
