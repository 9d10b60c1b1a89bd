"""Captures in the layout of FIPT (Wu et al. 2023, https://github.com/lwwu2/fipt) and of IRIS's LDR version of it.

``train/transforms.json`` with poses whose columns are x left, y up, z forward; ``train/Image/NNN_0001.png``;
``cam/exposure.npy``; ``scene.ply`` or ``scene.obj``. In FIPT's release ground-truth maps lie beside the photos; in
captures with a ``gt`` folder they lie in there, which nothing here ever names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..model.capture import Split, View
from .exposures import checked
from .listing import (
    LEFT_UP_FORWARD,
    Listing,
    check_unique,
    find_image,
    frames_of,
    inside,
    light_states,
    load_array,
    only_mesh,
    read_camera,
    read_distortion,
    read_json_object,
    read_pose,
    safe_name,
    up_axis,
)
from .photo_files import check_photo

UP = (0.0, 1.0, 0.0)

PhotoSet = Literal["Image", "Image_const"]


def fipt_root(path: Path) -> Path | None:
    """The folder of the FIPT-layout capture that ``path`` is, or is a transforms file of; None for other captures."""
    folder = path if path.is_dir() else path.parent
    for root in (folder, folder.parent):
        if root != folder and folder.name not in ("train", "val"):
            continue
        if (root / "train" / "transforms.json").is_file() and not (root / "transforms.json").is_file():
            return root
    return None


def read_fipt(root: Path, photos: PhotoSet = "Image") -> Listing:
    """List the capture in ``root``; ``photos`` picks the set with varying or constant exposure. Raises BadInput."""
    source = root / "train" / "transforms.json"
    views = read_fipt_views(root, "train", photos)
    has_val = (root / "val" / "transforms.json").is_file()
    named = [root / f"scene{suffix}" for suffix in (".ply", ".obj", ".glb")]
    mesh_file = next((path for path in named if path.is_file()), None)
    return Listing(
        name=root.resolve().name or "capture",
        root=root,
        source=source,
        views=views,
        val_views=read_fipt_views(root, "val", photos) if has_val else (),
        mesh_file=inside(root, mesh_file.name, source) if mesh_file else only_mesh(root, source),
        up=up_axis(root, UP),
    )


def read_fipt_views(root: Path, split: Split, photos: PhotoSet = "Image") -> tuple[View, ...]:
    """Views of ``root/split`` with recorded exposures; a view whose photo does not exist has None. Raises BadInput."""
    source = root / split / "transforms.json"
    meta = read_json_object(source)
    frames = frames_of(meta, source)
    exposures = _exposures(root, split, photos, len(frames))
    found = [_photo(frame, index, root, source, photos) for index, frame in enumerate(frames)]
    any_photo = next((photo for _, photo in found if photo is not None), None)
    states = light_states(frames, [name for name, _ in found], source)
    size: tuple[int, int] | None = None
    views = []
    for index, (frame, (name, photo)) in enumerate(zip(frames, found, strict=True)):
        values = {**meta, **frame}
        values["transform_matrix"] = read_pose(frame.get("transform_matrix"), name, source) @ LEFT_UP_FORWARD
        if size is None and not ("w" in values and "h" in values) and any_photo is not None:
            size = check_photo(any_photo)
        views.append(
            View(
                name=name,
                camera=read_camera(values, size, name, source),
                photo=photo,
                exposure=None if exposures is None else checked(exposures[index], name, source),
                distortion=read_distortion(values, name, source),
                split=split,
                light_state=states[index],
            )
        )
    check_unique(views, source)
    return tuple(views)


def _photo(frame: dict[str, Any], index: int, root: Path, source: Path, photos: str) -> tuple[str, Path | None]:
    """Name and file of a frame: by its file_path within the chosen set, else by its number as Blender numbers them."""
    numbered = f"{index:03d}_0001"
    given = frame.get("file_path")
    stem = Path(given.replace("\\", "/")).name if isinstance(given, str) and given else numbered
    folder = source.parent.name
    for candidate in dict.fromkeys((stem, numbered)):
        photo = find_image(root, f"{folder}/{photos}/{candidate}", source)
        if photo is not None:
            return safe_name(photo.stem), photo
    return safe_name(Path(stem).stem), None


def _exposures(root: Path, split: Split, photos: str, count: int) -> np.ndarray | None:
    kind = "exposure_const" if photos == "Image_const" else "exposure"
    path = root / "cam" / (f"{kind}.npy" if split == "train" else f"{kind}_{split}.npy")
    return load_array(path, count, "photo") if path.is_file() else None
