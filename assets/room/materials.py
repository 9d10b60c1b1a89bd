"""Principled materials of the room. Roughness 1 for paint and cloth, 0.2 – 0.35 for varnish and metal."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np

from . import textures


def principled(
    name: str,
    color: tuple[float, float, float] | np.ndarray,
    roughness: float = 1.0,
    metallic: float = 0.0,
    *,
    repeat: float | None = None,
) -> bpy.types.Material:
    """One Principled BSDF. An (H, W, 3) ``color`` becomes an image texture that repeats every ``repeat`` UV units."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.distribution = "GGX"
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    if np.ndim(color) == 1:
        shader.inputs["Base Color"].default_value = (*color, 1.0)
        return material
    picture = nodes.new("ShaderNodeTexImage")
    picture.image = textures.to_image(name, np.asarray(color))
    links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    if repeat is not None:
        coordinates, scale = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeVectorMath")
        scale.operation = "SCALE"
        scale.inputs["Scale"].default_value = 1.0 / repeat
        links.new(coordinates.outputs["UV"], scale.inputs[0])
        links.new(scale.outputs["Vector"], picture.inputs["Vector"])
    return material


def light(name: str, radiance: tuple[float, float, float]) -> bpy.types.Material:
    """A black surface that emits ``radiance`` (linear Rec.709) from both sides."""
    material = principled(name, (0.0, 0.0, 0.0), 1.0)
    shader = material.node_tree.nodes["Principled BSDF"]
    strength = max(radiance)
    shader.inputs["Specular IOR Level"].default_value = 0.0
    shader.inputs["Emission Color"].default_value = (*(c / strength for c in radiance), 1.0)
    shader.inputs["Emission Strength"].default_value = strength
    return material


def palette() -> SimpleNamespace:
    """Every material of the room, created in the current file."""
    oak = textures.wood([0.44, 0.27, 0.14], [0.27, 0.145, 0.066], 50)
    walnut = textures.wood([0.20, 0.105, 0.055], [0.085, 0.053, 0.05], 60)
    return SimpleNamespace(
        plaster=principled("plaster", (0.73, 0.70, 0.645)),
        sage=principled("sage paint", (0.235, 0.315, 0.245)),
        ceiling=principled("ceiling paint", (0.79, 0.785, 0.77)),
        trim=principled("white lacquer", (0.72, 0.71, 0.68), 0.35),
        floor=principled("oak floor", textures.planks(), 0.3),
        oak=principled("oak veneer", oak, 0.32, repeat=1.0),
        walnut=principled("walnut veneer", walnut, 0.22, repeat=1.0),
        rug=principled("rug", textures.rug()),
        picture=principled("landscape", textures.landscape()),
        linen=principled("linen", textures.weave([0.40, 0.385, 0.36], 70), repeat=0.5),
        mustard=principled("mustard wool", textures.weave([0.56, 0.33, 0.06], 72), repeat=0.5),
        teal=principled("striped cotton", textures.stripes([0.06, 0.22, 0.25], [0.60, 0.57, 0.49]), repeat=0.5),
        terracotta=principled("terracotta felt", textures.weave([0.42, 0.145, 0.075], 74), repeat=0.5),
        curtain=principled("curtain", (0.58, 0.50, 0.40)),
        brass=principled("brass", (0.80, 0.56, 0.25), 0.25, 1.0),
        copper=principled("copper", (0.78, 0.42, 0.29), 0.22, 1.0),
        steel=principled("brushed steel", (0.56, 0.55, 0.53), 0.3, 1.0),
        graphite=principled("graphite lacquer", (0.055, 0.056, 0.06), 0.35),
        clay=principled("glazed clay", (0.11, 0.21, 0.30), 0.2),
        cream=principled("cream stoneware", (0.66, 0.60, 0.50), 0.4),
        leaf=principled("leaf", (0.075, 0.19, 0.055), 0.45),
        soil=principled("soil", (0.06, 0.05, 0.05)),
        lemon=principled("lemon", (0.72, 0.50, 0.055), 0.4),
        paper=principled("paper", (0.70, 0.67, 0.58)),
        books=[
            principled(f"book cover {k}", color, 0.6)
            for k, color in enumerate(
                [
                    (0.38, 0.07, 0.06),
                    (0.06, 0.14, 0.26),
                    (0.56, 0.42, 0.16),
                    (0.09, 0.20, 0.13),
                    (0.60, 0.55, 0.47),
                    (0.22, 0.10, 0.17),
                ]
            )
        ],
        window=light("window daylight", (5.6, 6.9, 8.4)),
        pendant=light("ceiling lamp", (26.0, 21.0, 15.0)),
        globe=light("opal globe", (17.0, 11.9, 6.8)),
    )
