"""From a path to a checked :class:`Capture`.

The format is recognised by its files. Photos must open and fit their cameras; mesh and poses must share one frame and
one unit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..base.images import HDR_SUFFIXES
from ..base.untrusted import floats
from ..model.camera_height import CameraHeight
from ..model.capture import Capture, FloatArray, Mesh, View, in_metres, moved_by
from ..model.device import devices_of
from ..rays.tracer import Tracer
from .assumed_scale import height_over_floor
from .colmap import colmap_model, read_colmap, read_colmap_views
from .common_frame import OURS, Together, bring_together, extent
from .exposures import apply_file, from_exif, with_device
from .fipt import PhotoSet, fipt_root, read_fipt, read_fipt_views
from .listing import FUSED_MESH, Listing, axis_near, mean_up, up_axis, upright
from .map_coordinates import map_origin, off_the_map
from .mended_poses import has_pose_of, mend_record, mended_like
from .mesh_files import read_mesh
from .mesh_from_depth import depth_without_mesh, keep_fused
from .nerfstudio import read_nerfstudio, read_nerfstudio_views
from .phone_exports import refuse_recording
from .photo_contents import showing_something
from .photo_files import SIDEWAYS, UPRIGHT, check_photo, read_orientation
from .photos import check_photo_size
from .pose_folders import scannetpp_scene
from .programs import find_program, read_program, read_program_views

Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""glTF is y up by its standard; exporters that comply turn a z-up room on its side."""
GLB_TURN_GAIN = 0.3
"""Share of rays that must newly meet the mesh for a GLB to be turned."""
SEEN_GRID = 16
"""Rays in a row and in a column through each view that measure how much of the mesh it sees."""
MIN_SEEN_SHARE = 0.05
"""Of those rays that meet the mesh; a photo below is warned about."""
MAX_LOST_SHARE = 1 / 3
"""Of the photos, that may be missing or without a pose."""
MAX_UNIT_RATIO = 100.0
"""Between the extents of mesh and camera path; beyond, they are in different units."""


def read_capture(
    path: Path | str,
    *,
    exposures: str | Path = "auto",
    hdr: Path | None = None,
    photos: PhotoSet = "Image",
    strict: bool = False,
    metres_per_unit: float | CameraHeight | None = None,
    exclude: Collection[str] = (),
    check: Callable[[], None] = lambda: None,
) -> Capture:
    """Read and check a capture.

    Photos and mesh are brought into one frame where the mend is clear, which a warning then says. Where they do not fit
    and no mend is clear, the capture has a ``mismatch``: it can be inspected and not solved.

    Args:
        path: a nerfstudio transforms.json or its folder, a folder in FIPT layout, or one with a COLMAP model.
        exposures: "auto" takes what the capture records, else EXIF; "none" withholds the exposures of the training
            photos; anything else is a JSON, CSV or .npy file.
        hdr: folder with an EXR of linear radiance for each training photo, matched by file name.
        photos: which set of a FIPT-layout capture, varying or constant exposure.
        strict: refuse a capture that lacks photos or poses; otherwise up to a third of them are left out and listed.
        metres_per_unit: what poses and mesh are multiplied by, in whatever unit they are; without, a unit that the
            files do not tell is taken as one metre, which a warning says. A height of the cameras gives that unit, and
            no other.
        exclude: names of training photos to leave out, blurred ones say.
        check: called often; may raise, as for a cancel.

    Raises:
        BadInput: the capture cannot be used as it is.
    """
    path = scannetpp_scene(Path(path))
    if maps := depth_without_mesh(path):
        keep_fused(path, maps, lambda _: check())
    listing = _list(path, photos)
    if not listing.views:
        raise BadInput("has no training photos", 'give some frames the split "train"', listing.source)
    views, val_views = _without(listing, exclude), list(listing.val_views)
    warnings = list(listing.warnings)
    fused = listing.mesh_file.name == FUSED_MESH
    if fused:
        warnings.append(f"the capture has no mesh: one was fused from its depth ({FUSED_MESH})")
    if hdr is None:
        views, skipped = _photographed(views, listing, strict)
        warnings += skipped
    if hdr is not None:
        views = _with_radiance(views, Path(hdr))
    views, turned = check_photos(views)
    views, val_views = ([with_device(view) for view in group] for group in (views, val_views))
    warnings += [*turned, *_two_devices(views)]
    views, val_views = _with_exposures(views, val_views, exposures)
    views, empty = showing_something(views, strict, check)
    warnings += empty
    unknown = sum(view.exposure is None for view in views)
    if 0 < unknown < len(views):
        warnings.append(f"{unknown} of {len(views)} photos have no exposure time: all exposures are estimated")

    mesh, mesh_warnings = read_mesh(listing.mesh_file)
    origin = map_origin(views, mesh, listing.mesh_file)
    if listing.one_frame:
        origin.require_none(listing.mesh_file)
    views, val_views, mesh = origin.views(views), origin.views(val_views), origin.of_mesh(mesh)
    warnings += origin.warnings(listing.mesh_file)
    given = 1.0
    if isinstance(metres_per_unit, int | float):
        given = float(metres_per_unit)
        views, val_views = ([in_metres(view, given) for view in group] for group in (views, val_views))
        mesh = replace(mesh, vertices=mesh.vertices * given)
    mesh, turned = _turn_glb(mesh, views, listing)
    together = bring_together(
        views, val_views, mesh, check, may_mend=not (fused or listing.one_frame), points=origin.points(listing.points)
    )
    if origin.apart and together.similarity is None:
        raise _unseen(listing.mesh_file)
    up = up_direction(listing, together)
    unit, assumed = given, []
    if isinstance(metres_per_unit, CameraHeight) or metres_per_unit is None:
        unit, assumed = _assumed_unit(listing, together, up, metres_per_unit)
        if unit != 1:
            together = _scaled(together, unit)
    warnings += [*assumed, *mesh_warnings, *turned, *([together.warning] if together.warning else [])]
    mismatch = None if together.mismatch is None else BadInput(*together.mismatch, listing.mesh_file)
    if mismatch is not None and not (seen_shares(together.views, together.mesh) > 0).any():
        raise mismatch  # there is nothing to look at either
    check_units(together.views, together.mesh, listing.mesh_file)
    warnings += check_sees_mesh(together.views, together.mesh, listing.mesh_file)
    found = together.similarity
    return Capture(
        name=listing.name,
        root=listing.root,
        views=together.views,
        val_views=together.val_views,
        mesh=together.mesh,
        up=up,
        warnings=tuple(warnings),
        mismatch=mismatch,
        metres_per_unit=unit,
        poses_to_mesh=None if found is None else found.matrix(given),
        mended_poses=mend_record(
            together.mend.convention,
            together.pose_scale,
            found is not None,
            origin.views([*listing.views, *listing.val_views]),
        ),
        map_origin=origin.record(),
        excluded=tuple(sorted(set(exclude))),
    )


def up_direction(listing: Listing, together: Together) -> tuple[float, float, float]:
    """That of the files, unless the poses are no longer those of the files. How photos lie tells it only where the
    format does not: a phone that is held upright stores them on their side, often without EXIF."""
    if listing.up_is_stated:
        if together.similarity is None:
            return listing.up
        x, y, z = (together.similarity.rotation @ listing.up).tolist()
        return axis_near((x, y, z))
    if together.similarity is not None:
        mean = mean_up(together.views)
        return upright(together.views) if mean is None else axis_near(mean)
    if together.mend.convention is not OURS or together.views[0].orientation != UPRIGHT:
        return up_axis(listing.root, upright(together.views))
    return listing.up


def _assumed_unit(
    listing: Listing, together: Together, up: tuple[float, float, float], cameras: CameraHeight | None
) -> tuple[float, list[str]]:
    """Metres per unit where nobody gave it, and a warning that says what was assumed.

    Poses that were moved to the mesh have its unit, whatever theirs was.
    """
    moved = together.similarity is not None
    unknown = listing.unit or (f"{listing.mesh_file.name} tells no unit" if moved else "")
    if not unknown:
        unused = f"--camera-height is not used: {listing.source.name} is in meters"
        return 1.0, [] if cameras is None else [unused]
    height = None if cameras is None else height_over_floor(together.views, together.mesh, np.array(up))
    if cameras is not None and height is not None and height > 0:
        unit = cameras.metres / height
        said = f"the cameras are taken to be {cameras.metres:g} m over the floor in the middle, and a unit {unit:.4g} m"
        return unit, [f"{unknown}: {said}"]
    said = "the unit of the mesh" if moved else "one unit"
    said += " is taken as one meter; --metres-per-unit gives it another length"
    if cameras is not None:
        said += ". --camera-height is not used: no floor is seen below the cameras"
    return 1.0, [f"{unknown}: {said}"]


def _scaled(together: Together, unit: float) -> Together:
    return replace(
        together,
        views=tuple(in_metres(view, unit) for view in together.views),
        val_views=tuple(in_metres(view, unit) for view in together.val_views),
        mesh=replace(together.mesh, vertices=together.mesh.vertices * unit),
    )


def read_views(path: Path, report: Mapping[str, Any] | None = None) -> tuple[View, ...]:
    """Cameras to render from, out of a transforms.json of either layout or those of a program; photos need not exist.

    Args:
        report: of the result they are for. Where its solve moved the poses of its capture to the mesh, those of a
            program, as COLMAP, move with them; a transforms.json is in the frame of the mesh, unless it has one of the
            capture's poses. Where it took them in another convention, it takes those of a file with such poses
            likewise. Views in map coordinates follow where the capture was moved to the origin.

    Raises:
        BadInput: no cameras there, or unusable ones.
    """
    report = report or {}
    views, in_frame_of_mesh = _read_views(scannetpp_scene(Path(path)))
    views = tuple(with_device(view) for view in views)
    posed = off_the_map(report, views, frame="poses")
    of_capture = not in_frame_of_mesh or has_pose_of(report, posed)
    similarity = floats(report.get("poses_to_mesh"), (4, 4))
    if similarity is not None and of_capture:
        return tuple(moved_by(view, similarity) for view in posed)
    return mended_like(report, posed if of_capture else off_the_map(report, views, frame="mesh"))


def _read_views(path: Path) -> tuple[tuple[View, ...], bool]:
    """The views of ``path``, and whether its format has the frame of a mesh and none of its own."""
    transforms = path / "transforms.json" if path.is_dir() else path
    root = fipt_root(transforms)
    if root is None and not transforms.is_file() and (model := colmap_model(path)) is not None:
        return read_colmap_views(path, model), False
    if root is None and (path.is_file() or not transforms.is_file()) and (found := find_program(path)) is not None:
        return read_program_views(path, *found), False
    if root is None:
        return read_nerfstudio_views(transforms), True
    return read_fipt_views(root, "val" if transforms.parent.name == "val" else "train"), True


def _list(path: Path, photos: PhotoSet) -> Listing:
    if not path.exists():
        raise BadInput("no such capture", "give a folder or a transforms.json", path)
    if path.is_file():
        refuse_recording(path)
    root = fipt_root(path)
    if root is not None:
        return read_fipt(root, photos)
    transforms = path / "transforms.json" if path.is_dir() else path
    if transforms.is_file():
        found = None if path.is_dir() else find_program(path)
        return read_nerfstudio(transforms) if found is None else read_program(path, *found)
    model = colmap_model(path)
    if model is not None:
        return read_colmap(path, model)
    found = find_program(path)
    if found is None:
        refuse_recording(path)
        raise BadInput(
            "neither transforms.json nor train/transforms.json nor a COLMAP model in the folder, nor cameras of "
            "Metashape, Meshroom, RealityScan, OpenMVG, Bundler, Polycam, Record3D, ScanNet, ScanNet++, ARKitScenes, "
            "7-Scenes or TUM RGB-D",
            "export the poses in one of these formats, or name the file itself",
            path,
        )
    return read_program(path, *found)


def _without(listing: Listing, exclude: Collection[str]) -> list[View]:
    """The training photos of ``listing`` but those that ``exclude`` names.

    Raises:
        BadInput: there is no such photo, or no other.
    """
    names = [view.name for view in listing.views]
    unknown = sorted(set(exclude) - set(names))
    if unknown:
        alike = get_close_matches(unknown[0], names, 3, 0.0)
        raise BadInput(f"has no photo {unknown[0]!r} to leave out", f"try {', '.join(alike)}", listing.source)
    kept = [view for view in listing.views if view.name not in exclude]
    if not kept:
        raise BadInput("has no other photos than those left out", "leave out fewer", listing.source)
    return kept


def _photographed(views: Sequence[View], listing: Listing, strict: bool) -> tuple[list[View], list[str]]:
    """The views that have photos, and a warning that names the others and those without a pose.

    Raises:
        BadInput: more than a third is missing, or any and ``strict``.
    """
    missing = [view.name for view in views if view.photo is None]
    lost = [f"{name} (no photo)" for name in missing] + [f"{name} (no pose)" for name in listing.unposed]
    if not lost:
        return list(views), []
    names = ", ".join(lost[:5]) + (" …" if len(lost) > 5 else "")
    total = len(views) + len(listing.unposed)
    if strict or len(lost) > MAX_LOST_SHARE * total:
        raise BadInput(
            f"{len(lost)} of {total} photos are missing or have no pose: {names}",
            "put the photos into the folder, or take their entries out of the file",
            listing.source,
        )
    return [view for view in views if view.photo is not None], [f"{len(lost)} of {total} photos are left out: {names}"]


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
    """Views with the exposures that ``exposures`` chooses; those of held-out photos are never withheld."""
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
    """Whether the photo is EXR, which holds radiance itself whatever the exposure of its LDR version."""
    return view.photo is not None and view.photo.suffix.lower() in HDR_SUFFIXES


def _turn_glb(mesh: Mesh, views: Sequence[View], listing: Listing) -> tuple[Mesh, list[str]]:
    """Turn a y-up GLB into a z-up capture, when the photos clearly see it better that way."""
    if listing.mesh_file.suffix.lower() != ".glb" or listing.up != (0.0, 0.0, 1.0):
        return mesh, []
    turned = replace(mesh, vertices=mesh.vertices @ Y_UP_TO_Z_UP.T)
    gain = float(seen_shares(views, turned).mean() - seen_shares(views, mesh).mean())
    if gain < GLB_TURN_GAIN:
        return mesh, []
    return turned, [f"{listing.mesh_file.name}: turned from y up, as glTF has it, to the z up of the poses"]


# ---- Checks of the whole capture ------------------------------------------------------------------------------------


def check_photos(views: Sequence[View]) -> tuple[list[View], list[str]]:
    """Every photo opens, has the size of its camera, and all are LDR or all HDR.

    Returns:
        The views, with the orientation of those photos that have to be turned as EXIF says to fit their cameras, and a
        warning about them.

    Raises:
        BadInput: a photo that does not.
    """
    kinds: dict[bool, View] = {}
    fitting = []
    for given in views:
        view = given if given.photo is None else _turned_to_fit(given, check_photo(given.photo))
        fitting.append(view)
        if view.photo is None:
            continue
        kinds.setdefault(view.photo.suffix.lower() in HDR_SUFFIXES, view)
    if len(kinds) == 2:
        raise BadInput(
            f"is EXR while {kinds[False].photo} is not", "give all training photos as EXR or none", kinds[True].photo
        )
    turned = [view.name for view in fitting if view.orientation != UPRIGHT]
    if not turned:
        return fitting, []
    return fitting, [f"{len(turned)} photos are turned as their EXIF orientation says, to fit their intrinsics"]


def _turned_to_fit(view: View, size: tuple[int, int]) -> View:
    """The view, its photo turned by its EXIF orientation where only that gives it the size of its camera."""
    camera = view.camera
    if view.photo is not None and size != (camera.width, camera.height) and size[::-1] == (camera.width, camera.height):
        orientation = read_orientation(view.photo)
        if orientation in SIDEWAYS:
            return replace(view, orientation=orientation)
    check_photo_size(view, size)
    return view


def _two_devices(views: Sequence[View]) -> list[str]:
    """A warning where photos come from more cameras than get a curve of their own."""
    photos = Counter(view.device for view in views)
    found = devices_of(views)
    alone = [name for name in photos if found is None or name not in found.names]
    if len(photos) < 2 or not alone:
        return []
    names = ", ".join(f"{name or 'unknown'} ({photos[name]})" for name in alone[:5]) + (" …" if len(alone) > 5 else "")
    return [
        f"the photos come from {len(photos)} cameras, and {names} took too few to be told from the others. Colors "
        "suffer if these differ; leave those photos out, or take more"
    ]


def check_units(views: Sequence[View], mesh: Mesh, path: Path) -> None:
    """Raise BadInput when the mesh ``path`` and the poses cannot be in one unit. A camera path below half a metre
    counts as half a metre, because cameras that only turn on the spot have no path.
    """
    size = extent(mesh)
    positions = np.array([view.camera.position for view in views])
    spread = float(np.linalg.norm(np.ptp(positions, axis=0)))
    ratio = size / max(spread, 0.5)
    if ratio > MAX_UNIT_RATIO:
        raise BadInput(
            f"is {ratio:.0f} times as large as the path of the cameras: millimeters against meters?",
            f"scale the mesh to meters (by {_nearest_unit(1 / ratio):g}) or bring the poses to its unit",
            path,
        )
    if spread > MAX_UNIT_RATIO * max(size, 1e-9):
        raise BadInput(
            f"is {spread / max(size, 1e-9):.0f} times smaller than the path of the cameras: poses in millimeters?",
            "bring mesh and poses to meters",
            path,
        )


def _nearest_unit(scale: float) -> float:
    """The factor between usual units (mm, cm, m) nearest to ``scale``."""
    units = np.array([0.001, 0.01])
    return float(units[np.argmin(np.abs(np.log(units / scale)))])


def check_sees_mesh(views: Sequence[View], mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Raise BadInput when no photo sees the mesh ``path``; return a warning for photos that see little of it."""
    shares = seen_shares(views, mesh)
    if not (shares > 0).any():
        raise _unseen(path)
    blind = [view.name for view, share in zip(views, shares, strict=True) if share < MIN_SEEN_SHARE]
    if not blind:
        return ()
    names = ", ".join(blind[:5]) + (" …" if len(blind) > 5 else "")
    return (f"{len(blind)} of {len(views)} photos see less than {MIN_SEEN_SHARE:.0%} of the mesh: {names}",)


def _unseen(mesh_file: Path) -> BadInput:
    mend = "bring mesh and poses into one frame (axes, unit, origin) and one capture"
    return BadInput("no photo sees the mesh", mend, mesh_file)


def seen_shares(views: Sequence[View], mesh: Mesh) -> FloatArray:
    """(n,) share of a grid of rays through each view that hits the mesh."""
    rays = [view.camera.resized(SEEN_GRID, SEEN_GRID).rays() for view in views]
    hits = Tracer(mesh).closest(np.concatenate([o for o, _ in rays]), np.concatenate([d for _, d in rays]))
    return (hits.face >= 0).reshape(len(views), -1).mean(1)
