"""Linear renders in Cycles: of a solved room, of a scene as it stands, and pictures denoised by OpenImageDenoise."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import IrisError
from ...edits.scene_edit import SceneEdit
from ...model.capture import Camera
from ...model.render_settings import RenderSettings
from ...results.result import Result
from ..camera import add_camera, look_through
from ..images import DATA, image_from_array, read_pixels
from ..scene_out.build import BuiltScene, build_scene
from ..version import (
    can_denoise,
    compositor_denoise,
    compositor_output,
    enable_gpu,
    own_compositor_tree,
    single_layer_exr,
)

PIXEL_FILTER = "BOX"  # one pixel wide, like a sensor: neighbouring pixels stay independent

OnView = Callable[[int, NDArray[np.float32]], None]


def render_views(
    result: Result,
    cameras: Sequence[Camera],
    *,
    edit: SceneEdit | None = None,
    settings: RenderSettings | None = None,
    on_view: OnView | None = None,
) -> list[NDArray[np.float32]]:
    """Path-trace ``result`` as changed by ``edit`` from ``cameras``.

    Images are denoised by OpenImageDenoise guided by albedo and normal, where the build has it
    (:func:`iris_addon.blender.version.can_denoise`).

    Args:
        cameras: in the capture's axes; each image has its camera's size.
        settings: None for the defaults.
        on_view: called with the index and the image after each view; may raise to stop.

    Returns:
        One (H, W, 3) float32 image per camera: radiance, scene-linear Rec.709, the pixel grid of ``Camera.rays()``.
    """
    built = build_scene(result, edit)
    try:
        set_cycles(built.scene, settings or RenderSettings())
        images = []
        for index, camera in enumerate(cameras):
            images.append(render_camera(built, camera))
            if on_view is not None:
                on_view(index, images[-1])
        return images
    finally:
        built.free()


def set_cycles(scene: bpy.types.Scene, settings: RenderSettings) -> None:
    """Make renders unbiased and repeatable: no clamping, no glossy blur, no light skipped, a fixed sample count."""
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True  # one BVH for all views
    scene.render.use_compositing = scene.render.use_sequencer = False
    cycles = scene.cycles
    cycles.device = "GPU" if settings.gpu and enable_gpu() else "CPU"
    cycles.samples, cycles.seed = settings.samples, settings.seed
    cycles.use_adaptive_sampling = False
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, f"{kind}_bounces", settings.max_bounces)
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.use_light_tree = True
    cycles.film_exposure = 1.0
    cycles.pixel_filter_type = PIXEL_FILTER
    cycles.use_denoising = settings.denoise and can_denoise()
    if cycles.use_denoising:
        cycles.denoiser = "OPENIMAGEDENOISE"
        cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
        cycles.denoising_prefilter = "ACCURATE"


def render_camera(built: BuiltScene, camera: Camera) -> NDArray[np.float32]:
    """(H, W, 3) linear radiance of the built scene from ``camera``, with its current settings."""
    aim(built, camera)
    return render_linear(built.scene)


def aim(built: BuiltScene, camera: Camera) -> None:
    """Add ``camera`` to the built scene and make it the active one."""
    camera_object = add_camera(camera, "IRIS View", built.scene.collection)
    built.owned |= {camera_object, camera_object.data}
    look_through(built.scene, camera, camera_object)


def render_linear(scene: bpy.types.Scene) -> NDArray[np.float32]:
    """(H, W, 3) linear radiance of ``scene`` from its active camera."""
    return np.ascontiguousarray(_render(scene, "RGB")[..., :3])


def render_coverage(scene: bpy.types.Scene) -> NDArray[np.float32]:
    """(H, W) alpha of ``scene`` from its active camera: the covered share of each pixel if the film is transparent."""
    return np.ascontiguousarray(_render(scene, "RGBA")[..., 3])


def _render(scene: bpy.types.Scene, color_mode: str) -> NDArray[np.float32]:
    single_layer_exr(scene.render.image_settings)
    scene.render.image_settings.color_mode = color_mode
    with tempfile.TemporaryDirectory(prefix="iris-") as folder:
        path = Path(folder) / "render.exr"
        render_exr(scene, path)
        return read_pixels(path)


def render_exr(scene: bpy.types.Scene, path: Path) -> None:
    """Render ``scene`` from its active camera into ``path``, in the EXR format its output is set to."""
    # A 32-bit EXR is free of the view transform, and works alike in background and with a window.
    bpy.ops.render.render(scene=scene.name)
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)
    if not path.is_file():
        raise IrisError("Cycles gave no image", "look at Blender's console for the reason, often memory")


# ---- denoising -----------------------------------------------------------------------------------------------------

Picture = NDArray[np.float32]


def denoise_pictures(pictures: Mapping[str, Picture], albedo: Picture, normal: Picture) -> dict[str, Picture]:
    """Denoise ``pictures`` (H, W, 3) of linear radiance, guided by the albedo and normals of the same view.

    By the compositor's node, because Cycles denoises only its combined pass.
    """
    before = {kind: set(getattr(bpy.data, kind)) for kind in ("scenes", "cameras", "objects", "images", "node_groups")}
    try:
        scene = empty_scene(albedo.shape[1], albedo.shape[0])
        tree = own_compositor_tree(scene)
        clean = compositor_denoise(tree)
        source = _image_node(tree, "picture", albedo)
        for socket, node in (
            ("Image", source),
            ("Albedo", _image_node(tree, "albedo", albedo)),
            ("Normal", _image_node(tree, "normal", normal)),
        ):
            tree.links.new(node.outputs["Image"], clean.inputs[socket])
        tree.links.new(clean.outputs["Image"], compositor_output(tree))
        done = {}
        for name, pixels in pictures.items():
            _set_pixels(source.image, pixels)  # one image for all, because the compositor caches each
            done[name] = render_linear(scene)
        return done
    finally:
        for kind, kept in before.items():
            bpy.data.batch_remove(set(getattr(bpy.data, kind)) - kept - {bpy.data.images.get("Render Result")})


def empty_scene(width: int, height: int) -> bpy.types.Scene:
    """A scene with nothing but a camera, whose renders are what its compositing tree makes."""
    scene = bpy.data.scenes.new("IRIS Denoise")
    eye = bpy.data.objects.new("IRIS Denoise", bpy.data.cameras.new("IRIS Denoise"))
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.use_compositing = True
    return scene


def _image_node(tree: bpy.types.NodeTree, name: str, pixels: Picture) -> bpy.types.Node:
    node = tree.nodes.new("CompositorNodeImage")
    node.image = _float_image(name, pixels)
    return node


def _float_image(name: str, pixels: Picture) -> bpy.types.Image:
    image = image_from_array(f"IRIS {name}", pixels, colorspace=DATA, float_buffer=True)
    image.use_half_precision = False
    return image


def _set_pixels(image: bpy.types.Image, pixels: Picture) -> None:
    opaque = np.ones((*pixels.shape[:2], 4), np.float32)
    opaque[..., :3] = pixels[::-1]
    image.pixels.foreach_set(opaque.ravel())
    image.update()
