"""Lights in Blender: those an edit adds, and the recovered lamps switched, dimmed and tinted.

Added quads are one-sided emissive meshes, other added lights are Blender's own. The energy E of a point or spot light
is the power that would leave in all directions, whatever the cone: its radiant intensity is E / 4π. The energy of a sun
is its irradiance.

A recovered lamp is an emissive material; switching, dimming and tinting it changes two sockets of that material. The
functions do nothing where the artist has rebuilt it with other nodes. Where lights of Blender shine in place of the
lamp (:mod:`iris_addon.blender.apply.area_lamps`), the material is what cameras see, and the lights follow it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector
from numpy.typing import NDArray

from ...edits.scene_edit import SUN, Light, Quad, SpotLight, SunLight
from ...model.recovered import Sunlight
from .materials import LAMP_ID, RECOVERED, black_material, emission_color, one_sided_lamp_material

ENERGY_PER_INTENSITY = 4 * np.pi
RECOVERED_TURN = "iris_recovered_turn"
"""Custom property of the recovered sun: its rotation within its parent, a quaternion."""


def add_light(light: Light, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """An object named ``name`` that emits ``light``."""
    if isinstance(light, Quad):
        return add_quad(light, name, collection)
    if isinstance(light, SunLight):
        data = _light_data(name, "SUN", light.irradiance, 1.0)
        data.angle = np.radians(light.angle)
        matrix = _aimed(light.direction)
    elif isinstance(light, SpotLight):
        data = _light_data(name, "SPOT", light.intensity, ENERGY_PER_INTENSITY)
        data.spot_size, data.spot_blend, data.shadow_soft_size = np.radians(light.angle), light.blend, light.radius
        matrix = Matrix.Translation(tuple(light.position)) @ _aimed(light.direction)
    else:
        data = _light_data(name, "POINT", light.intensity, ENERGY_PER_INTENSITY)
        data.shadow_soft_size = light.radius
        matrix = Matrix.Translation(tuple(light.position))
    thing = bpy.data.objects.new(name, data)
    thing.matrix_world = matrix
    collection.objects.link(thing)
    return thing


def add_sun(
    recovered: Sunlight | None, collection: bpy.types.Collection, changed: SunLight | None = None
) -> bpy.types.Object | None:
    """The sun of a result as Blender's light "IRIS Sun", or ``changed`` in its place; None where neither shines.

    It keeps what was recovered in custom properties, for :func:`as_recovered`.
    """
    sun = changed
    if sun is None and recovered is not None:
        sun = SunLight(-recovered.direction, recovered.irradiance)
    if sun is None or not np.max(sun.irradiance) > 0:
        return None
    thing = add_light(sun, SUN, collection)
    if recovered is not None:
        recover_sun(thing, recovered)
    return thing


def is_recovered_sun(thing: bpy.types.Object) -> bool:
    """Whether ``thing`` is the sun of a result, changed since or not."""
    return thing.type == "LIGHT" and RECOVERED in thing


def recover_sun(thing: bpy.types.Object, sun: Sunlight | None) -> None:
    """Keep ``sun``, in the axes of the scene, as what was recovered of the sun ``thing``; None is one that does not
    shine, where it was."""
    thing[RECOVERED] = [0.0] * 3 if sun is None else [float(value) for value in sun.irradiance]
    if sun is not None:
        thing[RECOVERED_TURN] = [float(value) for value in _aimed(-sun.direction).to_quaternion()]


def set_sun(thing: bpy.types.Object, share: float) -> None:
    """Let the recovered sun ``thing`` shine with a share of what was recovered, from where it stands; 0 hides it."""
    thing.hide_render = thing.hide_viewport = not share
    _set_power(thing.data, np.array(thing[RECOVERED], float) * (share or 1.0))


def add_quad(quad: Quad, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """A one-sided rectangular light, wound to agree with ``quad.normal``."""
    corners = np.asarray(quad.corners, float)
    if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ quad.normal < 0:
        corners = corners[::-1]
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners.tolist(), [], [(0, 1, 2, 3)])
    if np.max(quad.radiance) > 0:
        data.materials.append(one_sided_lamp_material(name, quad.radiance))
    else:
        data.materials.append(black_material(name))
    light = bpy.data.objects.new(name, data)
    collection.objects.link(light)
    return light


def _light_data(name: str, kind: str, power: NDArray[np.floating], factor: float) -> bpy.types.Light:
    """Blender's light whose colour times energy is ``power`` (3,) times ``factor``."""
    data = bpy.data.lights.new(name, kind)
    _set_power(data, np.asarray(power) * factor)
    return data


def _set_power(data: bpy.types.Light, power: NDArray[np.floating]) -> None:
    peak = float(np.max(power))
    data.energy = peak
    data.color = tuple(np.asarray(power) / peak) if peak > 0 else (0.0, 0.0, 0.0)


def _aimed(direction: NDArray[np.floating]) -> Matrix:
    """Blender's lights shine along their -Z."""
    return Vector(tuple(direction)).to_track_quat("-Z", "Y").to_matrix().to_4x4()


# ---- recovered lamps -----------------------------------------------------------------------------------------------

OFF_STRENGTH = "iris_strength"
"""Custom property of a lamp that is switched off: its strength."""


STAND_INS = ("iris_light_0", "iris_light_1")
"""Custom properties of a lamp's material: the lights that shine in its place."""
STANDS_FOR, ENERGY_PER_RADIANCE = "iris_stands_for", "iris_energy_per_radiance"
"""Custom properties of such a light: the material of its lamp, and its energy at a radiance of 1."""
CAMERA_ONLY = ("IRIS Camera Only", "IRIS Light Path", "IRIS See Through")
"""Names of the nodes that show a material to cameras alone."""


def lamp_materials(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Material]:
    """The materials of lamps on ``objects``, by the id of their emitter."""
    used = {slot.material for thing in objects for slot in thing.material_slots if slot.material is not None}
    lamps = [material for material in used if LAMP_ID in material]
    return sorted(lamps, key=lambda material: (material[LAMP_ID], material.name))


def is_plain(material: bpy.types.Material | None) -> bool:
    """Whether the material still has the nodes it was made with."""
    return _shader(material) is not None


def is_on(material: bpy.types.Material | None) -> bool:
    """Whether the lamp is switched on."""
    return material is not None and OFF_STRENGTH not in material


def switch(material: bpy.types.Material | None, on: bool) -> None:
    """Switch the lamp on, with the strength it had, or off."""
    shader = _shader(material)
    if material is None or shader is None or on == is_on(material):
        return
    _take_from_stand_ins(material)
    socket = shader.inputs["Emission Strength"]
    if on:
        socket.default_value = material[OFF_STRENGTH]
        del material[OFF_STRENGTH]
    else:
        material[OFF_STRENGTH] = socket.default_value
        socket.default_value = 0.0
    _let_stand_ins_follow(material)


def strength(material: bpy.types.Material | None) -> float:
    """Radiance of the brightest channel; of a lamp that is off, the radiance it would have."""
    shader = _shader(material)
    if material is None or shader is None:
        return 0.0
    lights = stand_ins(material)
    if lights and OFF_STRENGTH not in material:  # the artist may have changed the light itself
        return float(lights[0].data.energy / lights[0][ENERGY_PER_RADIANCE])
    return float(material.get(OFF_STRENGTH, shader.inputs["Emission Strength"].default_value))


def set_strength(material: bpy.types.Material | None, value: float) -> None:
    """Set the radiance of the brightest channel; a lamp that is off stays off."""
    shader = _shader(material)
    if material is None or shader is None:
        return
    _take_from_stand_ins(material)
    if OFF_STRENGTH in material:
        material[OFF_STRENGTH] = value
    else:
        shader.inputs["Emission Strength"].default_value = value
    _let_stand_ins_follow(material)


def color(material: bpy.types.Material | None) -> tuple[float, float, float]:
    """Linear colour of the light."""
    shader = _shader(material)
    if material is None or shader is None:
        return (0.0, 0.0, 0.0)
    if lights := stand_ins(material):
        red, green, blue = lights[0].data.color
        return (red, green, blue)
    red, green, blue, _ = emission_color(shader).default_value
    return (red, green, blue)


def set_color(material: bpy.types.Material | None, value: Sequence[float]) -> None:
    """Set the linear colour of the light."""
    shader = _shader(material)
    if material is None or shader is None:
        return
    _take_from_stand_ins(material)
    emission_color(shader).default_value = (*value, 1.0)
    _let_stand_ins_follow(material)


def emitted(material: bpy.types.Material | None) -> NDArray[np.float64]:
    """(3,) radiance of the lamp; 0 where it is off."""
    return strength(material) * np.array(color(material)) if is_on(material) else np.zeros(3)


LampSetting = tuple[bool, float, tuple[float, float, float]]
"""Whether a lamp shines, its strength and its colour."""


def lamp_setting(material: bpy.types.Material) -> LampSetting:
    """How the lamp is set."""
    return is_on(material), strength(material), color(material)


def set_lamp(material: bpy.types.Material, setting: LampSetting) -> None:
    """Set the lamp; does nothing where the artist has rebuilt it."""
    on, level, tint = setting
    switch(material, True)
    set_strength(material, level)
    set_color(material, tint)
    switch(material, on)


def reset(material: bpy.types.Material) -> None:
    """Let a lamp emit what was recovered; does nothing where the artist has rebuilt it."""
    shader = _shader(material)
    if shader is None or RECOVERED not in material:
        return
    _emit_recovered(shader, material)
    _let_stand_ins_follow(material)


def _emit_recovered(shader: bpy.types.Node, material: bpy.types.Material) -> None:
    radiance = [float(value) for value in material[RECOVERED]]
    shader.inputs["Emission Strength"].default_value = max(radiance)
    if max(radiance) > 0:  # a lamp that is off in the first light state keeps its colour
        emission_color(shader).default_value = (*(value / max(radiance) for value in radiance), 1.0)


@contextmanager
def as_recovered(materials: Iterable[bpy.types.Material], objects: Iterable[bpy.types.Object] = ()) -> Iterator[None]:
    """Inside, lamps emit what was recovered, and the sun among ``objects`` shines from where it was found; materials
    that the artist has rebuilt stay as they are. Lamps that lights stand in for emit, and these lights are hidden."""
    materials = list(materials)
    replaced = [(material, mode) for material in materials if (mode := camera_only_mode(material))]
    lights = [thing for material, _ in replaced for thing in stand_ins(material) if not thing.hide_render]
    before, suns = [], [thing for thing in objects if is_recovered_sun(thing)]
    shone = [
        (thing.hide_render, thing.data.energy, tuple(thing.data.color), thing.matrix_basis.copy()) for thing in suns
    ]
    for thing in suns:
        thing.hide_render = False
        _set_power(thing.data, np.array(thing[RECOVERED], float))
        thing.matrix_basis = Quaternion(thing[RECOVERED_TURN]).to_matrix().to_4x4()
    for material in materials:
        shader = _shader(material)
        if shader is None or RECOVERED not in material:
            continue
        tint, level = emission_color(shader), shader.inputs["Emission Strength"]
        before.append((tint, tuple(tint.default_value), level, level.default_value))
        _emit_recovered(shader, material)
    for material, _ in replaced:
        show_to_all(material)
    for thing in lights:
        thing.hide_render = True
    try:
        yield
    finally:
        for thing in lights:
            thing.hide_render = False
        for material, mode in replaced:
            show_to_cameras_only(material, see_through=mode == "see through")
        for thing, (hidden, energy, tint_of_sun, basis) in zip(suns, shone, strict=True):
            thing.hide_render, thing.data.energy = hidden, energy
            thing.data.color, thing.matrix_basis = tint_of_sun, basis
        for tint, color_before, level, strength_before in before:
            tint.default_value, level.default_value = color_before, strength_before


def _shader(material: bpy.types.Material | None) -> bpy.types.Node | None:
    """The Principled BSDF; None without a material, and where the artist has rebuilt it."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else ()
    return next((node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"), None)


# ---- lights in place of lamps --------------------------------------------------------------------------------------


def stand_ins(material: bpy.types.Material | None) -> list[bpy.types.Object]:
    """The lights in a scene that shine in place of the lamp; those that the artist has deleted are not among them."""
    lights = [] if material is None else [material.get(key) for key in STAND_INS]
    return [thing for thing in lights if thing is not None and thing.users_collection]


def _let_stand_ins_follow(material: bpy.types.Material) -> None:
    """Give the lights in place of a lamp the colour and the radiance of its material."""
    shader = _shader(material)
    assert shader is not None  # callers have looked
    for thing in stand_ins(material):
        thing.data.color = tuple(emission_color(shader).default_value)[:3]
        thing.data.energy = shader.inputs["Emission Strength"].default_value * thing[ENERGY_PER_RADIANCE]


def _take_from_stand_ins(material: bpy.types.Material) -> None:
    """Give the material what the artist has changed at the light in its place."""
    shader, level, tint = _shader(material), strength(material), color(material)
    assert shader is not None  # callers have looked
    if stand_ins(material):
        emission_color(shader).default_value = (*tint, 1.0)
        if OFF_STRENGTH not in material:
            shader.inputs["Emission Strength"].default_value = level


def camera_only_mode(material: bpy.types.Material) -> str:
    """How :func:`show_to_cameras_only` has changed ``material``: "black", "see through", or "" where it has not."""
    nodes = material.node_tree.nodes if material.node_tree is not None else {}
    return "" if CAMERA_ONLY[0] not in nodes else "see through" if CAMERA_ONLY[2] in nodes else "black"


def show_to_cameras_only(material: bpy.types.Material, *, see_through: bool) -> None:
    """Keep the look of a lamp, but let it light nothing: all rays but those from cameras find it black or, with
    ``see_through``, pass."""
    shader = _shader(material)
    if shader is None or camera_only_mode(material):
        return
    tree = material.node_tree
    mix, path = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeLightPath")
    mix.name, path.name = CAMERA_ONLY[:2]
    mix.location, path.location = (180, 150), (-50, 450)
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs["Fac"])
    if see_through:
        passing = tree.nodes.new("ShaderNodeBsdfTransparent")
        passing.name, passing.location = CAMERA_ONLY[2], (-50, 250)
        tree.links.new(passing.outputs["BSDF"], mix.inputs[1])
    for link in list(shader.outputs["BSDF"].links):
        tree.links.new(mix.outputs["Shader"], link.to_socket)
    tree.links.new(shader.outputs["BSDF"], mix.inputs[2])
    material.cycles.emission_sampling = "NONE"


def show_to_all(material: bpy.types.Material) -> None:
    """Undo :func:`show_to_cameras_only`."""
    shader = _shader(material)
    if shader is None or not camera_only_mode(material):
        return
    tree = material.node_tree
    for link in list(tree.nodes[CAMERA_ONLY[0]].outputs["Shader"].links):
        tree.links.new(shader.outputs["BSDF"], link.to_socket)
    for name in CAMERA_ONLY:
        if name in tree.nodes:
            tree.nodes.remove(tree.nodes[name])
    material.cycles.emission_sampling = "FRONT_BACK"
