"""Where the photos of the demo room are taken from: (position, point looked at), metres."""

from __future__ import annotations

import math

import bpy
from mathutils import Vector

FIELD_OF_VIEW = math.radians(70)

TRAIN = [
    ((4.60, 0.45, 1.55), (1.20, 2.60, 0.70)),
    ((4.70, 1.70, 1.35), (0.40, 2.20, 1.00)),
    ((4.45, 3.55, 1.60), (1.20, 1.00, 1.35)),
    ((3.00, 3.60, 1.50), (2.10, 0.20, 0.75)),
    ((1.00, 3.55, 1.55), (3.60, 0.50, 1.40)),
    ((1.15, 0.40, 1.60), (3.90, 3.20, 0.75)),
    ((0.45, 0.95, 1.65), (4.30, 2.70, 1.30)),
    ((0.50, 2.00, 1.50), (4.80, 1.50, 1.65)),
    ((0.70, 3.20, 1.60), (4.20, 1.20, 1.30)),
    ((3.00, 0.60, 1.20), (2.50, 4.00, 1.30)),
    ((2.90, 1.60, 1.30), (0.20, 2.10, 1.05)),
    ((2.80, 2.60, 1.25), (0.40, 0.90, 0.60)),
    ((2.60, 1.10, 1.50), (0.60, 3.60, 0.95)),
    ((2.30, 3.20, 1.45), (1.60, 1.60, 0.30)),
    ((2.20, 2.90, 1.10), (2.20, 0.10, 0.85)),
    ((3.00, 1.30, 1.40), (3.90, 2.90, 0.70)),
    ((4.50, 1.55, 1.55), (3.50, 3.10, 0.60)),
    ((2.90, 3.30, 1.55), (4.20, 2.30, 0.65)),
    ((3.60, 1.35, 1.25), (4.95, 0.70, 1.05)),
    ((2.80, 2.10, 1.45), (3.90, 0.10, 0.60)),
    ((3.10, 2.20, 0.85), (2.50, 0.10, 1.55)),
    ((1.30, 2.95, 1.00), (2.60, 1.90, 2.70)),
    ((3.30, 0.80, 0.95), (3.40, 2.90, 2.50)),
    ((4.60, 2.10, 1.10), (2.20, 3.70, 1.80)),
    ((1.15, 1.05, 0.90), (3.90, 2.40, 2.30)),
    ((3.20, 1.60, 2.10), (1.50, 1.90, 0.10)),
    ((3.10, 3.30, 2.20), (4.10, 1.60, 0.10)),
    ((1.30, 0.60, 1.30), (0.30, 1.40, 0.50)),
]

VALIDATION = [
    ((4.40, 1.05, 1.60), (1.00, 1.90, 0.75)),
    ((0.80, 1.40, 1.55), (4.00, 3.00, 0.80)),
    ((2.70, 3.45, 1.50), (3.10, 0.30, 0.75)),
    ((2.40, 0.75, 1.45), (2.90, 3.70, 1.00)),
    ((3.00, 2.50, 1.45), (0.50, 1.70, 0.80)),
    ((1.20, 3.20, 1.45), (1.80, 0.60, 0.60)),
]


def build() -> None:
    """One camera object per view: 'photo 00' … and 'val 00' …"""
    for prefix, views in (("photo", TRAIN), ("val", VALIDATION)):
        for k, (position, target) in enumerate(views):
            data = bpy.data.cameras.new(f"{prefix} {k:02d}")
            data.sensor_fit = "HORIZONTAL"
            data.angle = FIELD_OF_VIEW
            data.clip_start = 0.01
            camera = bpy.data.objects.new(data.name, data)
            bpy.context.scene.collection.objects.link(camera)
            forward = Vector(target) - Vector(position)
            camera.location = position
            camera.rotation_euler = forward.to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.camera = bpy.data.objects["photo 00"]
