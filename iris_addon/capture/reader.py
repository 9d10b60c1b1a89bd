"""From a path to a checked :class:`Capture`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.errors import BadInput
from ..base.images import HDR_SUFFIXES
from ..model.capture import Capture, Mesh, View
from .checks import check_photos, check_sees_mesh, check_units, seen_shares
from .colmap import colmap_model, read_colmap, read_colmap_views
from .exposures import apply_file, from_exif
from .fipt import PhotoSet, fipt_root, read_fipt, read_fipt_views
from .listing import Listing
from .mesh_files import read_mesh
from .nerfstudio import read_nerfstudio, read_nerfstudio_views

# glTF is y up by its standard; exporters that obey turn a z-up room on its side.
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_capture(
    path: Path | str, *, exposures: str | Path = "auto", hdr: Path | None = None, photos: PhotoSet = "Image"
) -> Capture:
    """Read and check a capture.

    Args:
        path: a nerfstudio transforms.json or its folder, a folder in FIPT layout, or one with a COLMAP model.
        exposures: "auto" takes what the capture records, else EXIF; "none" withholds the exposures of the training
            photos; anything else is a JSON, CSV or .npy file.
        hdr: folder with an EXR of linear radiance for each training photo, matched by file name.
        photos: which set of a FIPT-layout capture, varying or constant exposure.

    Raises:
        BadInput: the capture cannot be used as it is.
    """
    path = Path(path)
    listing = _list(path, photos)
    if not listing.views:
        raise BadInput("has no training photos", 'give some frames the split "train"', listing.source)
    views, val_views = list(listing.views), list(listing.val_views)
    warnings = list(listing.warnings)
    if hdr is not None:
        views = _with_radiance(views, Path(hdr))
    check_photos(views)
    views, val_views = _with_exposures(views, val_views, exposures)
    unknown = sum(view.exposure is None for view in views)
    if 0 < unknown < len(views):
        warnings.append(f"{unknown} of {len(views)} photos have no exposure time: all exposures are estimated")

    mesh, mesh_warnings = read_mesh(listing.mesh_file)
    check_units(views, mesh, listing.mesh_file)
    mesh, turned = _turn_glb(mesh, views, listing)
    warnings += [*mesh_warnings, *turned, *check_sees_mesh(views, mesh, listing.mesh_file)]
    return Capture(
        name=listing.name,
        root=listing.root,
        views=tuple(views),
        val_views=tuple(val_views),
        mesh=mesh,
        up=listing.up,
        warnings=tuple(warnings),
    )


def read_views(path: Path) -> tuple[View, ...]:
    """Cameras to render from, out of a transforms.json of either layout or a COLMAP model; photos need not exist.

    Raises:
        BadInput: no cameras there, or unusable ones.
    """
    path = Path(path)
    transforms = path / "transforms.json" if path.is_dir() else path
    root = fipt_root(transforms)
    if root is None and not transforms.is_file() and (model := colmap_model(path)) is not None:
        return read_colmap_views(path, model)
    if root is None:
        return read_nerfstudio_views(transforms)
    return read_fipt_views(root, "val" if transforms.parent.name == "val" else "train")


def _list(path: Path, photos: PhotoSet) -> Listing:
    if not path.exists():
        raise BadInput("no such capture", "give a folder or a transforms.json", path)
    root = fipt_root(path)
    if root is not None:
        return read_fipt(root, photos)
    transforms = path / "transforms.json" if path.is_dir() else path
    if transforms.is_file():
        return read_nerfstudio(transforms)
    model = colmap_model(path)
    if model is None:
        raise BadInput(
            "neither transforms.json nor train/transforms.json nor a COLMAP model in the folder",
            "export the poses in nerfstudio's format, or name the file itself",
            path,
        )
    return read_colmap(path, model)


def _with_radiance(views: Sequence[View], folder: Path) -> list[View]:
    """Views whose photos are the EXR files of ``folder`` with the same stems."""
    if not folder.is_dir():
        raise BadInput("no such folder of EXR photos", "check --hdr", folder)
    found = {path.stem: path for path in folder.iterdir() if path.suffix.lower() in HDR_SUFFIXES}
    radiance = []
    for view in views:
        stem = view.name if view.photo is None else view.photo.stem
        if stem not in found:
            raise BadInput(f"has no {stem}.exr", "give one EXR for every training photo", folder)
        radiance.append(replace(view, photo=found[stem]))
    return radiance


def _with_exposures(
    views: Sequence[View], val_views: Sequence[View], exposures: str | Path
) -> tuple[list[View], list[View]]:
    """Views with the exposures the caller asked for; those of held-out photos are never withheld."""
    if all(_is_radiance(view) for view in views):
        return [replace(view, exposure=1.0) for view in views], [
            replace(view, exposure=1.0) if _is_radiance(view) else view for view in val_views
        ]
    if exposures == "none":
        return [replace(view, exposure=None) for view in views], list(val_views)
    if exposures != "auto":
        return apply_file(Path(exposures), views, val_views)
    if any(view.exposure is not None for view in views):
        return list(views), list(val_views)
    both = [*views, *val_views]
    times = from_exif({f"{view.split}/{view.name}": view.photo for view in both if view.photo is not None})
    both = [replace(view, exposure=times.get(f"{view.split}/{view.name}", view.exposure)) for view in both]
    return both[: len(views)], both[len(views) :]


def _is_radiance(view: View) -> bool:
    """Whether the photo is EXR: it holds radiance itself, whatever its LDR version was exposed with."""
    return view.photo is not None and view.photo.suffix.lower() in HDR_SUFFIXES


def _turn_glb(mesh: Mesh, views: Sequence[View], listing: Listing) -> tuple[Mesh, list[str]]:
    """Turn a y-up GLB into a z-up capture, when the photos clearly see it better that way."""
    if listing.mesh_file.suffix.lower() != ".glb" or listing.up != (0.0, 0.0, 1.0):
        return mesh, []
    turned = replace(mesh, vertices=mesh.vertices @ Y_UP_TO_Z_UP.T)
    gain = float(seen_shares(views, turned).mean() - seen_shares(views, mesh).mean())
    if gain < 0.3:
        return mesh, []
    return turned, [f"{listing.mesh_file.name}: turned from y up, as glTF has it, to the z up of the poses"]
