"""Cameras that photogrammetry programs and RGB-D data sets write, beside nerfstudio's, FIPT's and COLMAP's.

::

    Metashape       *.xml                     File > Export > Export Cameras, Agisoft XML
    Meshroom        *.sfm, sfm.json           node ConvertSfMFormat, views, intrinsics and extrinsics
    OpenMVG         sfm_data.json             openMVG_main_ConvertSfM_DataFormat, with views, intrinsics, extrinsics
    RealityScan     *.csv                     Export > Registration, Internal/External camera parameters
                    *.xmp beside the photos   Export > Registration, XMP
    Bundler         *.out with list.txt       many programs
    ScanNet         color/ pose/ intrinsic/   as SensReader extracts it
    7-Scenes        frame-*.color.png with frame-*.pose.txt
    TUM RGB-D       rgb.txt, groundtruth.txt, rgb/
    ScanNet++       dslr/nerfstudio/transforms.json, dslr/resized_images/, scans/
    Polycam         keyframes/ and raw.glb, as its raw data
    Record3D        metadata.json, rgb/, as "EXR + RGB"
    ARKitScenes     lowres_wide.traj, lowres_wide/, lowres_wide_intrinsics/

Each reader turns its file into frames with the keys of a transforms.json. Poses there are camera to world, x right, y
up, z backward; None where the program did not find one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.errors import BadInput
from ..base.untrusted import open_file
from ..model.capture import View
from .camera_tables import read_bundler, read_reality_scan
from .listing import (
    Y_UP,
    Z_UP,
    Listing,
    check_unique,
    find_image,
    find_mask,
    has_pose,
    inside,
    only_mesh,
    read_camera,
    read_distortion,
    up_axis,
    upright,
    view_names,
)
from .meshroom import read_meshroom
from .metashape import read_metashape
from .openmvg import read_openmvg
from .phone_exports import (
    find_arkit_scenes,
    find_polycam,
    find_record3d,
    read_arkit_scenes,
    read_polycam,
    read_record3d,
)
from .photo_files import PHOTO_SUFFIXES, check_photo
from .pose_folders import SCANNETPP_MESH, find_scannetpp, read_scannet, read_scannetpp, read_seven_scenes, read_tum
from .xmp_sidecars import is_sidecar, read_sidecars

Frame = Mapping[str, Any]


MAX_PROGRAM_BYTES = 8 << 30
PHOTO_FOLDERS = ("images", "photos", "color", "rgb")
"""Where photos lie beside the folder of the capture itself."""


@dataclass(frozen=True)
class Program:
    """A program whose cameras are read.

    Attributes:
        name: for messages.
        find: its file in a folder, or named itself; None where there is none.
        read: the frames of that file.
        has_unit: whether its poses are in metres.
        up: of the world of its poses where that is always the same; None where photos must tell it.
        mesh: where its mesh lies below the folder; "" where it is the only one in the folder.
        levels: how far its file lies below the folder of the capture, where the file may be named itself.
    """

    name: str
    find: Callable[[Path], Path | None]
    read: Callable[[Path], list[dict[str, Any]]]
    has_unit: bool = False
    up: tuple[float, float, float] | None = None
    mesh: str = ""
    levels: int = 1

    def root(self, path: Path) -> Path:
        """The folder of the capture whose folder, or file, is ``path``."""
        return path if path.is_dir() else path.parents[self.levels - 1]


def _file_that(*suffixes: str, begins: Sequence[bytes]) -> Callable[[Path], Path | None]:
    """Finds a file with one of ``suffixes`` and, in its first kilobytes, one of the texts ``begins``."""

    def fits(path: Path) -> bool:
        if not path.is_file() or not path.name.lower().endswith(suffixes):
            return False
        with open_file(path, MAX_PROGRAM_BYTES) as file:
            head = file.read(4096)
        return any(text in head for text in begins)

    def find(path: Path) -> Path | None:
        if path.is_file():
            return path if fits(path) else None
        found = [entry for entry in sorted(path.iterdir()) if fits(entry)] if path.is_dir() else []
        return found[0] if found else None

    return find


def _scannet(path: Path) -> Path | None:
    intrinsics = path / "intrinsic" / "intrinsic_color.txt"
    return intrinsics if intrinsics.is_file() and (path / "pose").is_dir() else None


def _seven_scenes(path: Path) -> Path | None:
    return next(iter(sorted(path.glob("frame-*.pose.txt"))), None) if path.is_dir() else None


def _tum(path: Path) -> Path | None:
    photos = path / "rgb.txt"
    return photos if photos.is_file() and (path / "groundtruth.txt").is_file() else None


def _sidecar(path: Path) -> Path | None:
    if path.is_file():
        return path if is_sidecar(path) else None
    for folder in (path, *(path / name for name in PHOTO_FOLDERS)):
        for entry in sorted(folder.iterdir()) if folder.is_dir() else ():
            if is_sidecar(entry):
                return entry
    return None


PROGRAMS = (
    Program("Metashape", _file_that(".xml", begins=(b"<chunk", b"<document")), read_metashape),
    Program("Meshroom", _file_that(".sfm", "sfm.json", begins=(b'"version"', b'"views"')), read_meshroom),
    Program("RealityScan", _file_that(".csv", begins=(b"heading,pitch,roll",)), read_reality_scan, has_unit=True),
    Program("RealityScan", _sidecar, read_sidecars),
    Program("OpenMVG", _file_that(".json", begins=(b'"sfm_data_version"',)), read_openmvg),
    Program("Bundler", _file_that(".out", begins=(b"# Bundle file",)), read_bundler),
    Program("ScanNet", _scannet, read_scannet, has_unit=True),
    Program("7-Scenes", _seven_scenes, read_seven_scenes, has_unit=True),
    Program("TUM RGB-D", _tum, read_tum, has_unit=True),
    Program("ScanNet++", find_scannetpp, read_scannetpp, has_unit=True, up=Z_UP, mesh=SCANNETPP_MESH, levels=3),
    Program("Polycam", find_polycam, read_polycam, has_unit=True, up=Y_UP),
    Program("Record3D", find_record3d, read_record3d, has_unit=True, up=Y_UP),
    Program("ARKitScenes", find_arkit_scenes, read_arkit_scenes, has_unit=True, up=Z_UP),
)


def find_program(path: Path) -> tuple[Program, Path] | None:
    """The program whose cameras lie in, or are, ``path``, and their file; None where there are none."""
    for program in PROGRAMS:
        source = program.find(path)
        if source is not None:
            return program, source
    return None


def read_program(path: Path, program: Program, source: Path) -> Listing:
    """List the capture in, or around, ``path``; raises BadInput."""
    root = program.root(path)
    views, unposed = _views(program.read(source), root, source, photos=True)
    if not views:
        raise BadInput("has no camera with a pose", "align the photos first, and export their cameras again", source)
    mesh = inside(root, program.mesh, source) if program.mesh else only_mesh(root, source, "leave one in the folder")
    return Listing(
        name=root.resolve().name or "capture",
        root=root,
        source=source,
        views=tuple(view for view in views if view.split == "train"),
        val_views=tuple(view for view in views if view.split == "val"),
        mesh_file=mesh,
        up=up_axis(root, upright(views) if program.up is None else program.up),
        up_is_stated=program.up is not None,
        unit="" if program.has_unit else f"{program.name}'s cameras have no unit",
        unposed=tuple(unposed),
    )


def read_program_views(path: Path, program: Program, source: Path) -> tuple[View, ...]:
    """Every view with a pose, photo or not: cameras to render from; raises BadInput."""
    return tuple(_views(program.read(source), program.root(path), source, photos=False)[0])


def _views(frames: Sequence[Frame], root: Path, source: Path, *, photos: bool) -> tuple[list[View], list[str]]:
    """The views, and names of photos without a pose; masks are looked for with ``photos`` only."""
    found = _Photos(root, source)
    names = view_names([str(frame["file_path"]) for frame in frames])
    views, unposed = [], []
    for frame, name in zip(frames, names, strict=True):
        if not has_pose(frame["transform_matrix"]):
            unposed.append(name)
            continue
        photo = found.find(str(frame["file_path"]))
        values = with_size(frame, None if photo is None else check_photo(photo))
        view = View(
            name=name,
            camera=read_camera(values, None, name, source),
            photo=photo,
            distortion=read_distortion(values, name, source),
            split=frame.get("split", "train"),
            mask=find_mask(frame, name, root, source) if photos else None,
            margins=frame.get("margins", (0, 0, 0, 0)),
        )
        views.append(view)
    check_unique(views, source)
    return views, unposed


def with_size(frame: Frame, size: tuple[int, int] | None) -> dict[str, Any]:
    """The frame in pixels; "relative" has a focal length and a principal point, from the middle, in longer sides."""
    values = dict(frame)
    if size is not None:
        values.setdefault("w", size[0])
        values.setdefault("h", size[1])
    relative = values.pop("relative", None)
    if relative is not None and "w" in values and "h" in values:
        side = max(values["w"], values["h"])
        focal, x, y = relative
        values |= {"fl_x": focal * side, "cx": values["w"] / 2 + x * side, "cy": values["h"] / 2 + y * side}
    return values


class _Photos:
    """Photos below a folder by what programs call them: a path of another computer, a name, a name without suffix."""

    def __init__(self, root: Path, source: Path) -> None:
        self._root, self._source = root, source
        self._by_name: dict[str, list[Path]] = {}
        for folder in (root, *(root / name for name in PHOTO_FOLDERS)):
            for path in sorted(folder.iterdir()) if folder.is_dir() else ():
                if path.suffix.lower() in PHOTO_SUFFIXES:
                    for key in {path.name.casefold(), path.stem.casefold()}:
                        self._by_name.setdefault(key, []).append(path)

    def find(self, named: str) -> Path | None:
        """The photo called ``named``, None where there is none or a choice."""
        name = named.replace("\\", "/")
        last = name.rpartition("/")[2].casefold()
        found = self._by_name.get(last, [])
        if len(found) == 1:
            return found[0]
        return None if Path(name).is_absolute() or ":" in name else find_image(self._root, name, self._source)
