"""Captures in nerfstudio's format: a transforms.json with poses, intrinsics and paths.

Format: https://docs.nerf.studio/quickstart/data_conventions.html. In addition "mesh" may name the mesh, and "one_frame"
tell that it is in the frame of the poses, so that no other is searched, and a frame may carry "split", "exposure" or
"exposure_time" (with "iso", "f_number"), and "light_state".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..base.untrusted import finite
from ..model.capture import Split, View
from .exposures import from_frame
from .listing import (
    FUSED_MESH,
    Listing,
    check_unique,
    find_image,
    find_mask,
    frames_of,
    has_pose,
    inside,
    is_point_cloud,
    light_states,
    number,
    only_mesh,
    read_camera,
    read_distortion,
    read_json_object,
    up_axis,
    upright,
    view_names,
)
from .photo_files import check_photo


def read_nerfstudio(transforms: Path) -> Listing:
    """List the capture around ``transforms``; raises BadInput."""
    meta, root = read_json_object(transforms), transforms.parent
    frames = frames_of(meta, transforms)
    listed, unposed = _views(meta, frames, root, transforms, photos=True)
    views = [view for view in listed if view is not None]
    warnings = []
    if len(views) < len(listed):
        warnings.append(f"{len(listed) - len(views)} frames are in no split and are left out")
    mesh_file, mesh_named = _mesh_file(meta, root, transforms)
    unit = _check_applied(meta, mesh_named, transforms)
    return Listing(
        name=root.resolve().name or "capture",
        root=root,
        source=transforms,
        views=tuple(view for view in views if view.split == "train"),
        val_views=tuple(view for view in views if view.split == "val"),
        mesh_file=mesh_file,
        up=up_axis(root, upright(views)),
        unposed=tuple(unposed),
        one_frame=meta.get("one_frame") is True,
        warnings=tuple(warnings),
        unit=unit,
    )


def read_nerfstudio_views(transforms: Path) -> tuple[View, ...]:
    """Every view of ``transforms``, whatever its split, photo or not: cameras to render from; raises BadInput."""
    meta = read_json_object(transforms)
    views, _ = _views(meta, frames_of(meta, transforms), transforms.parent, transforms, photos=False)
    return tuple(view for view in views if view is not None)


# ---- Frames ---------------------------------------------------------------------------------------------------------


def _views(
    meta: Mapping[str, Any], frames: Sequence[Mapping[str, Any]], root: Path, source: Path, *, photos: bool
) -> tuple[list[View | None], list[str]]:
    """One view per frame, None where the file's split lists leave it out; and frames without a pose.

    With ``photos`` these are left out, as recorders write them where they lost track; without, they are an error.
    """
    names = _view_names(frames, source)
    states = light_states(frames, names, source)
    split_of = _split_lists(meta, source)
    views: list[View | None] = []
    unposed: list[str] = []
    for frame, name, state in zip(frames, names, states, strict=True):
        split = _split(frame, name, split_of, source)
        photo = find_image(root, str(frame["file_path"]), source)
        if photos and not has_pose(frame.get("transform_matrix")):
            unposed.append(name)
            continue
        values = {**meta, **frame}
        sized = "w" in values and "h" in values
        view = View(
            name=name,
            camera=read_camera(values, None if sized or photo is None else check_photo(photo), name, source),
            photo=photo,
            exposure=from_frame(frame, name, source),
            distortion=read_distortion(values, name, source),
            split=split or "train",
            mask=find_mask(frame, name, root, source) if photos else None,
            device=frame["device"] if isinstance(frame.get("device"), str) else "",
            light_state=state,
        )
        views.append(view if split is not None else None)
    check_unique([view for view in views if view is not None], source)
    return views, unposed


def view_of_frame(meta: Mapping[str, Any], frame: Mapping[str, Any], source: Path) -> View:
    """The view of one posed frame, whatever its split; raises BadInput."""
    lists = [f"{key}_filenames" for key in _SPLITS]
    shared = {key: value for key, value in meta.items() if key not in lists}
    (view,), _ = _views(shared, [frame], source.parent, source, photos=False)
    assert view is not None
    return view


def _view_names(frames: Sequence[Mapping[str, Any]], source: Path) -> list[str]:
    """File stems where they are unique, otherwise whole paths."""
    for number_, frame in enumerate(frames):
        if not isinstance(frame.get("file_path"), str) or not frame["file_path"]:
            raise BadInput(f'frame {number_} has no "file_path"', "export the poses again", source)
    return view_names([frame["file_path"] for frame in frames])


_SPLITS: dict[str, Split] = {"train": "train", "val": "val", "test": "val"}


def _split_lists(meta: Mapping[str, Any], source: Path) -> dict[str, Split] | None:
    """Split by file_path from train_filenames, val_filenames, test_filenames; None when the file has none of them."""
    table: dict[str, Split] = {}
    for key, split in _SPLITS.items():
        listed = meta.get(f"{key}_filenames", [])
        if not isinstance(listed, list):
            raise BadInput(f'"{key}_filenames" is not a list', "export the splits again", source)
        table.update({str(name): split for name in listed})
    return table or None


def _split(frame: Mapping[str, Any], name: str, lists: Mapping[str, Split] | None, source: Path) -> Split | None:
    if "split" in frame:
        if not isinstance(frame["split"], str) or frame["split"] not in _SPLITS:
            raise BadInput(f"{name}: split {frame['split']!r}", "use train, val or test", source)
        return _SPLITS[frame["split"]]
    return "train" if lists is None else lists.get(str(frame["file_path"]))


# ---- Mesh and frame of reference ------------------------------------------------------------------------------------


def _mesh_file(meta: Mapping[str, Any], root: Path, source: Path) -> tuple[Path, bool]:
    """The mesh, and whether the file names it. nerfstudio's ply_file_path is mostly a point cloud, so not always it."""
    if "mesh" in meta:
        return inside(root, str(meta["mesh"]), source), True
    if "ply_file_path" in meta:
        named = inside(root, str(meta["ply_file_path"]), source)
        if named.is_file() and not is_point_cloud(named):
            return named, True
    found = only_mesh(root, source)
    return found, found.name == FUSED_MESH


def _check_applied(meta: Mapping[str, Any], mesh_named: bool, source: Path) -> str:
    """Refuse a capture whose poses were moved away from its mesh; why its unit may not be the metre, or "".

    "applied_transform" and "applied_scale" tell what was done to the poses in the file, and to the geometry it names.
    A mesh that merely lies in the folder may still be where it was before.
    """
    transform = np.eye(4)
    if "applied_transform" in meta:
        given = finite(meta["applied_transform"], (None, 4))
        if given is None or len(given) not in (3, 4):
            raise BadInput('"applied_transform" is not 3x4', "export the poses again", source)
        transform[: len(given)] = given
    scale = number(meta, "applied_scale", source) if "applied_scale" in meta else 1.0
    if not mesh_named and (scale != 1.0 or not np.allclose(transform, np.eye(4), atol=1e-6)):
        raise BadInput(
            '"applied_transform" or "applied_scale" moved the poses, and nothing says whether the mesh moved along',
            'bring the mesh into the frame of the poses and name it with "mesh"',
            source,
        )
    return "" if scale == 1.0 else f'"applied_scale" is {scale:g}'
