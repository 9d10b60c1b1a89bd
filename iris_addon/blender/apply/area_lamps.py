"""A recovered lamp replaced by Blender's own light of the same place, size, colour and flux, and put back.

The mesh of the lamp keeps its look to cameras and lights nothing any more. A flat lamp becomes an area light, or two
back to back where it shines to both sides; a closed body becomes a point light of its size; anything else an area light
that faces its mean direction, which is an approximation. By choice it becomes a bulb that shines alike in all
directions, or a point with the lamp's photometric file, of the flux that these lights have together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...edits.light_units import area_light_energy
from ..render.light_mixing import MIXED
from ..scene_out.lights import (
    ENERGY_PER_RADIANCE,
    STAND_INS,
    STANDS_FOR,
    camera_only_mode,
    color,
    is_on,
    set_color,
    set_strength,
    show_to_all,
    show_to_cameras_only,
    stand_ins,
    strength,
)
from .ies_files import cycles_ies
from .lamp_faces import lamp_triangles
from .on_objects import MADE

FLAT_THICKNESS = 0.25
"""Largest thickness of a flat lamp, as a share of its width."""
FLAT_COSINE, FLAT_SHARE = 0.8, 0.7
"""Cosine to the normal of a flat lamp that this share of its area reaches; faces of scans lean by 20 degrees."""
CLOSED_SHARE = 0.35
"""Length of the mean normal below which a lamp is a closed body; that of half a ball is 0.5."""
ELLIPSE_SHARE = 0.97
"""Share of the area within the inscribed ellipse from which on a lamp is round; of a rectangle it is 0.785."""
SINGLE_LAYER = 0.9
"""Length of the mean normal above which a flat lamp has one layer; that of a slab is 0."""
CLEARANCE = 0.05
"""Metres: what is nearer than this before a face receives its light, and the room does not."""
SIDE_SHARE = 0.1
"""A side that shines with a smaller share of the other's area is left out."""
SAMPLES, EYES, SEEN_SAMPLES = 256, 32, 32
"""Points on a lamp; cameras, and points of these, for which is tested what they see."""
GAP = 1e-3
"""Metres from the outermost face to the light."""
BULB_RADIUS = 0.03
"""Metres: of a bulb in place of a lamp that is no closed body; E27 bulbs have 6 cm."""
KINDS = ("AREA", "POINT", "IES")
"""What a lamp is replaced by: a light of its shape, a bulb, or its photometric file."""


@dataclass(frozen=True)
class _Samples:
    """Points of equal area on a lamp, in the axes of the scene.

    Attributes:
        corners: (T, 3, 3) of all triangles.
        at: (K, 3) points.
        normals: (K, 3) of the triangles they lie on.
        area: of the lamp, square metres.
    """

    corners: NDArray[np.float64]
    at: NDArray[np.float64]
    normals: NDArray[np.float64]
    area: float


@dataclass(frozen=True)
class _Frame:
    """Right-handed axes of a lamp: ``axes`` (3, 3) holds width, height and normal in its rows."""

    axes: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def size(self) -> NDArray[np.float64]:
        """(3,) extent along each axis."""
        return self.high - self.low


def replace_lamp(
    scene: bpy.types.Scene, material: bpy.types.Material, eyes: Sequence[Vector], kind: str = "AREA"
) -> tuple[list[bpy.types.Object], bool]:
    """Let lights of Blender shine in place of the lamp of ``material``.

    Args:
        eyes: where the photos were taken, for which side of the lamp they show; may be empty.
        kind: of KINDS.

    Returns:
        The lights, and whether they have the lamp's shape (with its file, its directions) and not an approximation.

    Raises:
        BadInput: no face has the material, lights are being mixed, or the lamp is off or replaced already.
    """
    _require_unmixed(scene)
    if camera_only_mode(material):
        raise BadInput(f"{material.name} is replaced already", "edit its light, or put the lamp back")
    if not is_on(material) or strength(material) <= 0:
        raise BadInput(f"{material.name} is off", "switch it on first")
    samples = _sample(lamp_triangles(scene, material))
    if samples is None:
        raise BadInput(f"no face has the material {material.name}", "apply the result again")
    mean = samples.normals.mean(0)
    frame = _frame(samples, _flat_normal(samples))
    leaning = np.abs(samples.normals @ frame.axes[2])
    flat = bool(frame.size[2] <= FLAT_THICKNESS * frame.size[:2].min() and (leaning > FLAT_COSINE).mean() >= FLAT_SHARE)
    closed = not flat and float(np.linalg.norm(mean)) < CLOSED_SHARE
    if flat:
        lights = _flat_lights(scene, material.name, samples, frame, eyes)
    elif closed:
        lights = [_ball_light(material.name, samples)]
    else:
        frame = _frame(samples, mean / np.linalg.norm(mean))
        toward = _shown_sides(scene, samples, frame, eyes)
        lights = [_area_light(material.name, frame, 1 if toward[0] >= toward[1] else -1, samples)]
    faithful = flat or closed
    if kind == "IES" or (kind == "POINT" and not closed):
        faithful = kind == "IES"
        place = _middle(lights, GAP if faithful else BULB_RADIUS / scene.unit_settings.scale_length)
        energy = sum(energy for *_, energy in lights)
        bpy.data.batch_remove([data for data, *_ in lights])
        bulb = _photometric(scene, material) if faithful else _bulb(material.name, scene.unit_settings.scale_length)
        lights = [(bulb, place, energy)]
    for key, (data, matrix, energy) in zip(STAND_INS, lights, strict=False):
        thing = bpy.data.objects.new(data.name, data)
        thing.matrix_world = matrix
        thing[MADE] = data[MADE] = True
        thing[STANDS_FOR], thing[ENERGY_PER_RADIANCE] = material, energy
        data.color, data.energy = color(material), strength(material) * energy
        thing.visible_camera = False
        scene.collection.objects.link(thing)
        material[key] = thing
    # What stands for the light of more than one side may stand within the lamp.
    show_to_cameras_only(material, see_through=closed or kind != "AREA")
    return stand_ins(material), faithful


def put_lamp_back(scene: bpy.types.Scene, material: bpy.types.Material) -> None:
    """Undo :func:`replace_lamp`; colour and strength stay as they are now. Raises BadInput while lights are mixed."""
    _require_unmixed(scene)
    level, tint = strength(material), color(material)
    gone = [material[key] for key in STAND_INS if material.get(key) is not None]
    for key in STAND_INS:
        material.pop(key, None)
    data = [thing.data for thing in gone]
    texts = [node.ies for block in data for node in _ies_nodes(block) if node.ies is not None and MADE in node.ies]
    bpy.data.batch_remove(gone)
    bpy.data.batch_remove([block for block in data if not block.users])
    bpy.data.batch_remove([text for text in texts if not text.users])
    show_to_all(material)
    set_color(material, tint)
    set_strength(material, level)


def _require_unmixed(scene: bpy.types.Scene) -> None:
    if MIXED in scene:
        raise BadInput("the lights of this scene are being mixed", "switch Mix Lights off first")


# ---- the shape of a lamp -------------------------------------------------------------------------------------------


def _sample(corners: NDArray[np.float64]) -> _Samples | None:
    """Points on the triangles, spread evenly over their area; None where they have none."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normals, axis=1)
    corners, normals, double = corners[double > 0], normals[double > 0], double[double > 0]
    if not len(double):
        return None
    rng = np.random.default_rng(0)
    triangle = np.searchsorted(np.cumsum(double) / double.sum(), (np.arange(SAMPLES) + 0.5) / SAMPLES)
    u, v = rng.random((2, SAMPLES, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = corners[triangle].transpose(1, 0, 2)
    return _Samples(
        corners=corners,
        at=a + u * (b - a) + v * (c - a),
        normals=(normals / double[:, None])[triangle],
        area=float(double.sum() / 2),
    )


def _flat_normal(samples: _Samples) -> NDArray[np.float64]:
    """The axis along which most of the area faces, to either side."""
    return np.linalg.eigh(samples.normals.T @ samples.normals)[1][:, -1]


def _frame(samples: _Samples, normal: NDArray[np.float64]) -> _Frame:
    """Axes with the smallest rectangle around the lamp as seen along ``normal``."""
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first)
    plane = np.stack([first, np.cross(normal, first)])
    points = np.unique(samples.corners.reshape(-1, 3), axis=0)
    best = 0.0
    for degrees in (np.arange(0, 90, 0.5), np.arange(-0.5, 0.5, 0.01)):
        angles = best + np.radians(degrees)
        width = np.cos(angles)[:, None] * plane[0] + np.sin(angles)[:, None] * plane[1]
        area = np.ptp(points @ width.T, axis=0) * np.ptp(points @ np.cross(normal, width).T, axis=0)
        best = float(angles[np.argmin(area)])
    x = np.cos(best) * plane[0] + np.sin(best) * plane[1]
    axes = np.stack([x, np.cross(normal, x), normal])
    local = points @ axes.T
    return _Frame(axes, local.min(0), local.max(0))


# ---- lights --------------------------------------------------------------------------------------------------------

_Light = tuple[bpy.types.Light, Matrix, float]
"""A light, where it stands, and its energy at a radiance of 1."""


def _flat_lights(
    scene: bpy.types.Scene, name: str, samples: _Samples, frame: _Frame, eyes: Sequence[Vector]
) -> list[_Light]:
    """An area light for every side to which the lamp shines.

    A single layer shines to the sides that cameras see. Of several layers, a face that has room to one side alone, as
    those of a slab have, shines there; one that has it to both, to the sides that cameras see.
    """
    seen = _shown_sides(scene, samples, frame, eyes)
    front, back = (_free(scene, samples, side * frame.axes[2], CLEARANCE + frame.size[2]) for side in (1, -1))
    visible = [amount > SIDE_SHARE * max(seen) for amount in seen]
    shining = np.stack([front & (~back | visible[0]), back & (~front | visible[1])])
    rim = np.abs(samples.normals @ frame.axes[2]) < FLAT_COSINE  # has room to both sides and shines outward, once
    share = (shining * np.where(rim & shining.all(0), 0.5, 1.0)).mean(1).tolist()
    single = np.linalg.norm(samples.normals.mean(0)) > SINGLE_LAYER
    if single or not max(share):  # bars and curtains close before a window take no light from it that they do not block
        share = [float(side) for side in visible]
    kept = [index for index in (0, 1) if share[index] > SIDE_SHARE * max(share)]
    return [_area_light(name, frame, 1 - 2 * index, samples, share[index]) for index in kept]


def _area_light(name: str, frame: _Frame, side: int, samples: _Samples, share: float = 1.0) -> _Light:
    """A light before the outermost face of one ``side``, 1 along the normal and -1 against it."""
    data = bpy.data.lights.new(f"{name} Light", "AREA")
    width, height, _ = np.maximum(frame.size, 1e-4)
    middle = (frame.low + frame.high) / 2
    middle[2] = frame.high[2] + GAP if side > 0 else frame.low[2] - GAP
    inside = (((samples.at @ frame.axes.T - middle)[:, :2] / (width / 2, height / 2)) ** 2).sum(1) <= 1
    data.shape = "ELLIPSE" if inside.mean() >= ELLIPSE_SHARE else "RECTANGLE"
    data.size, data.size_y = float(width), float(height)
    x, y, z = frame.axes
    turned = np.eye(4)
    turned[:3, :3] = np.stack([x, -side * y, -side * z], 1)  # Blender's lights shine along their -Z
    turned[:3, 3] = middle @ frame.axes
    return data, Matrix(turned.tolist()), area_light_energy(samples.area * share)


def _ball_light(name: str, samples: _Samples) -> _Light:
    """A point light of the flux of a closed body, whose radius gives it that body's surface."""
    data = bpy.data.lights.new(f"{name} Light", "POINT")
    data.shadow_soft_size = float(np.sqrt(samples.area / (4 * np.pi)))
    points = samples.corners.reshape(-1, 3)
    matrix = Matrix.Translation(((points.min(0) + points.max(0)) / 2).tolist())
    return data, matrix, area_light_energy(samples.area)


def _bulb(name: str, metres_per_unit: float) -> bpy.types.Light:
    """A point light of the size of a bulb."""
    data = bpy.data.lights.new(f"{name} Light", "POINT")
    data.shadow_soft_size = BULB_RADIUS / metres_per_unit
    return data


def _photometric(scene: bpy.types.Scene, material: bpy.types.Material) -> bpy.types.Light:
    """A point light that shines as the photometric file of the lamp says.

    Raises:
        BadInput: nothing of the lamp is seen from anywhere.
    """
    content = cycles_ies(scene, material)
    if content is None:
        raise BadInput(f"{material.name} sends light nowhere", "replace it by an area light")
    data = bpy.data.lights.new(f"{material.name} Light", "POINT")
    data.shadow_soft_size = 0.0
    data.use_nodes = True
    text = bpy.data.texts.new(f"{material.name}.ies")
    text.use_fake_user = False
    text.from_string(content)
    text[MADE] = True
    tree = data.node_tree
    node = tree.nodes.new("ShaderNodeTexIES")
    node.mode, node.ies = "INTERNAL", text
    node.location = (-200.0, 300.0)
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    tree.links.new(node.outputs["Fac"], emission.inputs["Strength"])
    return data


def _middle(lights: Sequence[_Light], before: float) -> Matrix:
    """The middle of ``lights``, upright; of a single area light so many metres ``before`` it."""
    place = sum((matrix.translation for _, matrix, _ in lights), Vector()) / len(lights)
    if len(lights) == 1 and lights[0][0].type == "AREA":
        place += before * (lights[0][1].to_3x3() @ Vector((0.0, 0.0, -1.0)))
    return Matrix.Translation(place)


def _ies_nodes(data: bpy.types.Light) -> list[bpy.types.Node]:
    nodes = data.node_tree.nodes if data.node_tree is not None else ()
    return [node for node in nodes if node.bl_idname == "ShaderNodeTexIES"]


# ---- which side of a lamp is seen ----------------------------------------------------------------------------------


def _shown_sides(
    scene: bpy.types.Scene, samples: _Samples, frame: _Frame, eyes: Sequence[Vector]
) -> tuple[float, float]:
    """How much of a lamp cameras see from along its normal, and from against it.

    Without cameras, or where none sees it, the side of the middle of the scene counts.
    """
    seen = [0.0, 0.0]
    graph = _graph(scene)
    for eye in list(eyes)[:: max(1, -(-len(eyes) // EYES))]:
        for at in samples.at[:: SAMPLES // SEEN_SAMPLES]:
            to_lamp = Vector(at) - eye
            distance = to_lamp.length
            side = 0 if -(np.array(to_lamp) @ frame.axes[2]) > 0 else 1
            hit, place, *_ = scene.ray_cast(graph, eye, to_lamp, distance=distance + GAP)
            if not hit or (place - eye).length > distance - GAP - frame.size[2]:
                seen[side] += 1.0
    if not max(seen):
        corners = [thing.matrix_world @ Vector(corner) for thing in scene.objects for corner in thing.bound_box]
        points = np.array([tuple(corner) for corner in corners])
        middle = (points.min(0) + points.max(0)) / 2
        seen[0 if (middle - samples.at.mean(0)) @ frame.axes[2] > 0 else 1] = 1.0
    return seen[0], seen[1]


def _free(
    scene: bpy.types.Scene, samples: _Samples, direction: NDArray[np.float64], distance: float
) -> NDArray[np.bool_]:
    """(K,) whether nothing stands before a point on this side of the lamp."""
    graph, way = _graph(scene), Vector(direction)
    starts = samples.at + 1e-4 * direction
    # A ray along a face on the rim starts off it: from within the lamp it ends at once, from without it does not.
    aside = GAP * (samples.normals - (samples.normals @ direction)[:, None] * direction)
    free = [
        any(not scene.ray_cast(graph, Vector(start), way, distance=distance)[0] for start in (at + off, at - off))
        for at, off in zip(starts, aside, strict=True)
    ]
    return np.array(free)


def _graph(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """What rays into ``scene`` hit, evaluated."""
    if scene == bpy.context.scene:
        return bpy.context.evaluated_depsgraph_get()
    layer = scene.view_layers[0]
    layer.update()
    return layer.depsgraph
