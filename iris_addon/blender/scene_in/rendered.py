"""What of a scene renders: shown for a moment, whatever the viewport hides.

The viewport's dependency graph lacks what is hidden with H or disabled in viewports, while a render has it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import bpy

SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


@contextmanager
def as_rendered(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Iterator[Mapping[str, str]]:
    """Show in ``depsgraph`` what renders, and put the viewport back afterwards.

    Yields:
        Objects with a surface that are no part of the picture, and why.
    """
    layer = scene.view_layers.get(depsgraph.view_layer.name) or scene.view_layers[0]
    undo: list[Callable[[], None]] = []
    left_out = _left_out(scene, layer)
    try:
        for branch in _branches(layer.layer_collection):
            _show(branch, "hide_viewport", undo)
            _show(branch.collection, "hide_viewport", undo)
        for thing in scene.objects:
            if thing.name in left_out or thing.hide_render:
                continue
            _show(thing, "hide_viewport", undo)
            if thing.name in layer.objects and thing.hide_get(view_layer=layer):
                thing.hide_set(False, view_layer=layer)
                undo.append(lambda thing=thing: thing.hide_set(True, view_layer=layer))
        depsgraph.update()
        yield left_out
    finally:
        for step in reversed(undo):
            step()
        depsgraph.update()


def _show(holder: bpy.types.ID | bpy.types.LayerCollection, name: str, undo: list[Callable[[], None]]) -> None:
    if getattr(holder, name):
        setattr(holder, name, False)
        undo.append(lambda: setattr(holder, name, True))


def _left_out(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> dict[str, str]:
    """Why an object with a surface is no part of the room, by its name."""
    rendered: set[str] = set()
    held_out: set[str] = set()
    excluded: set[str] = set()

    def visit(branch: bpy.types.LayerCollection, renders: bool, holdout: bool) -> None:
        renders = renders and not branch.collection.hide_render
        holdout = holdout or branch.holdout
        names = {thing.name for thing in branch.collection.objects}
        if branch.exclude:
            excluded.update(names)
        elif renders:
            (held_out if holdout else rendered).update(names)
        for child in branch.children:
            visit(child, renders, holdout)

    visit(layer.layer_collection, True, False)
    reasons = {}
    for thing in scene.objects:
        if thing.type not in SURFACES:
            continue
        if thing.hide_render:
            reasons[thing.name] = "because they are disabled for renders"
        elif thing.is_holdout or (thing.name in held_out and thing.name not in rendered):
            reasons[thing.name] = "because they are a holdout"
        elif thing.name not in rendered:
            kind = "excluded from the view layer" if thing.name in excluded else "disabled for renders"
            reasons[thing.name] = f"because their collection is {kind}"
    return reasons


def _branches(branch: bpy.types.LayerCollection) -> Iterator[bpy.types.LayerCollection]:
    yield branch
    for child in branch.children:
        yield from _branches(child)
