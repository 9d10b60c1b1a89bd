"""A copy of a scene for other machines: the files that it links to lie beside it, under paths relative to it.

They keep their places to each other, so that a linked .blend finds its own pictures where it left them. What cannot be
moved, as caches of simulations, is named.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from ...base.files import atomic_write, files_beside, is_own_file, require_own_folder
from ..apply.scene_files import write_whole

KINDS = ("images", "movieclips", "sounds", "fonts", "volumes", "cache_files", "libraries")
"""Collections of bpy.data whose items have a file."""
SAME_TIME = 1e-3
"""Seconds between the times of a file and its copy; file systems that keep whole seconds get it again."""
MAX_NAMED = 5
"""Files that one warning lists."""
_UDIM = re.compile(r"<(UDIM|UVTILE)>")


@dataclass(frozen=True)
class PortableCopy:
    """What was written.

    Attributes:
        blend: the copy.
        files: what it links to, beside it.
        warnings: files that hosts must find where they lie, or that are missing.
    """

    blend: Path
    files: tuple[Path, ...]
    warnings: tuple[str, ...]


_Named = tuple[bpy.types.bpy_struct, str, bpy.types.Library | None]
"""What has a path, the name of the property, and the library that it comes from."""


@dataclass
class _Links:
    """Files of the datablocks of a scene.

    Attributes:
        direct: by datablock of the scene itself its path, which for tiles is no file.
        all: every file, also those of linked libraries and the others of a sequence.
        missing: files that are not there.
        fixed: those that a library names absolutely.
    """

    direct: dict[bpy.types.ID, Path] = field(default_factory=dict)
    all: set[Path] = field(default_factory=set)
    missing: set[Path] = field(default_factory=set)
    fixed: set[Path] = field(default_factory=set)


def write_portable(scene: bpy.types.Scene, blend: Path) -> PortableCopy:
    """Write ``scene`` as ``blend`` for the command ``composite`` on another machine.

    Raises:
        BadInput: the folder of its files, or one in it, is a link.
        IrisError: a file cannot be written.
    """
    links, folder = _links(scene), files_beside(blend)
    placed = _mirrored(links.all | set(links.direct.values()))
    for inside in sorted({folder, *(folder / above for path in placed.values() for above in path.parents)}):
        require_own_folder(inside)
    copied = {source: folder / placed[source] for source in sorted(links.all)}
    for source, target in copied.items():
        _copy(source, target)
    relative = {thing: f"//{folder.name}/{placed[path].as_posix()}" for thing, path in links.direct.items()}
    others = _others(scene)
    with _paths(relative, others):
        # Kept as they are: those below are relative to the copy, and others were made absolute.
        write_whole(blend, lambda part: bpy.data.libraries.write(str(part), {scene}, path_remap="NONE", compress=True))
    warnings = _said("are missing, and hosts will miss them", links.missing)
    warnings += _said(
        "are read where they lie: hosts must find them under the same path",
        links.fixed | {_absolute(*each) for each in others},
    )
    return PortableCopy(blend, tuple(copied.values()), tuple(warnings))


def _links(scene: bpy.types.Scene) -> _Links:
    found, used = _Links(), _used_by(scene)
    libraries = {thing.library for thing in used if thing.library is not None}
    for kind in KINDS:
        for thing in getattr(bpy.data, kind):
            if (thing not in used and thing not in libraries) or _is_inside(thing):
                continue
            own = thing.parent if isinstance(thing, bpy.types.Library) else thing.library
            path = Path(os.path.normpath(bpy.path.abspath(thing.filepath, library=own)))
            files = _files_of(thing, path)
            if not files:
                found.missing.add(path)
                continue
            found.all |= files
            if own is None:
                found.direct[thing] = path
            elif not thing.filepath.startswith("//"):
                found.fixed.add(path)
    return found


def _used_by(scene: bpy.types.Scene) -> set[bpy.types.ID]:
    """The datablocks that a copy of ``scene`` has."""
    uses: dict[bpy.types.ID, set[bpy.types.ID]] = {}
    for thing, users in bpy.data.user_map().items():
        for user in users:
            uses.setdefault(user, set()).add(thing)
    found, queue = {scene}, [scene]
    while queue:
        new = uses.get(queue.pop(), set()) - found
        found |= new
        queue += new
    return found


def _is_inside(thing: bpy.types.ID) -> bool:
    """Whether the .blend has the content itself, or there is none."""
    if getattr(thing, "packed_file", None) is not None or len(getattr(thing, "packed_files", ())):
        return True
    return (
        not thing.filepath or thing.filepath == "<builtin>" or getattr(thing, "source", "") in ("GENERATED", "VIEWER")
    )


def _files_of(thing: bpy.types.ID, path: Path) -> set[Path]:
    """The files of a datablock whose path is ``path``: one, or those of a sequence; none where they are missing."""
    several = getattr(thing, "source", "") == "SEQUENCE" or getattr(thing, "is_sequence", False)
    if getattr(thing, "source", "") == "TILED":
        before, _, after = _UDIM.sub("\0", path.name).partition("\0")
        return _numbered(path.parent, before, after)
    number = re.search(r"\d+(?=\D*$)", path.stem) if several else None
    if number is None:
        return {path} if path.is_file() else set()
    return _numbered(path.parent, path.stem[: number.start()], path.stem[number.end() :] + path.suffix)


def _numbered(folder: Path, before: str, after: str) -> set[Path]:
    names = re.compile(rf"{re.escape(before)}(\d+|u\d+_v\d+){re.escape(after)}")
    return {path for path in folder.iterdir() if names.fullmatch(path.name)} if folder.is_dir() else set()


def _mirrored(files: Iterable[Path]) -> dict[Path, Path]:
    """A relative path for each file, by which they lie to each other as before, a folder for each drive of Windows."""
    by_drive: dict[str, list[Path]] = {}
    for path in sorted(files):
        by_drive.setdefault(path.anchor, []).append(path)
    placed = {}
    for anchor, own in by_drive.items():
        common = os.path.commonpath([path.parent for path in own])
        placed |= {path: Path(re.sub(r"\W+", "", anchor), path.relative_to(common)) for path in own}
    return placed


def _copy(source: Path, target: Path) -> None:
    """Copy a file, unless it is there already, of the same size and time."""
    if is_own_file(target):
        given, there = source.stat(), target.stat()
        if given.st_size == there.st_size and abs(given.st_mtime - there.st_mtime) < SAME_TIME:
            return
    atomic_write(target, lambda part: shutil.copy2(source, part))


@contextmanager
def _paths(relative: Mapping[bpy.types.ID, str], others: Iterable[_Named]) -> Iterator[None]:
    """Inside, datablocks have the paths ``relative``, and all ``others`` absolute ones."""
    before: list[tuple[bpy.types.bpy_struct, str, str]] = []
    try:
        for kind in KINDS:
            for thing in getattr(bpy.data, kind):
                name = "filepath_raw" if isinstance(thing, bpy.types.Image) else "filepath"  # that reads no file
                given = getattr(thing, name)
                wanted = relative.get(thing)
                if wanted is None and thing.library is None and given.startswith("//"):
                    wanted = bpy.path.abspath(given)
                if wanted is not None and wanted != given:
                    before.append((thing, name, given))
                    setattr(thing, name, wanted)
        for thing, name, library in others:
            given = getattr(thing, name)
            if library is None and given.startswith("//"):
                before.append((thing, name, given))
                setattr(thing, name, bpy.path.abspath(given))
        yield
    finally:
        for thing, name, given in before:
            setattr(thing, name, given)


def _others(scene: bpy.types.Scene) -> list[_Named]:
    """What names files otherwise among all that the scene uses: caches of simulations and of modifiers, and
    photometric files of lamps."""
    named: list[_Named] = []
    for thing in _used_by(scene):
        tree = getattr(thing, "node_tree", None) or thing
        named += [
            (node, "filepath", tree.library)
            for node in getattr(tree, "nodes", ())
            if getattr(node, "mode", "") == "EXTERNAL"
        ]
        for modifier in getattr(thing, "modifiers", ()) if isinstance(thing, bpy.types.Object) else ():
            domain = getattr(modifier, "domain_settings", None)
            named += [(modifier, "filepath", thing.library), (modifier, "bake_directory", thing.library)]
            named += [] if domain is None else [(domain, "cache_directory", thing.library)]
    return [each for each in named if getattr(each[0], each[1], "")]


def _absolute(thing: bpy.types.bpy_struct, name: str, library: bpy.types.Library | None) -> Path:
    return Path(bpy.path.abspath(getattr(thing, name), library=library))


def _said(what: str, paths: Iterable[Path]) -> list[str]:
    names = sorted(str(path) for path in paths)
    if not names:
        return []
    return [
        f"{len(names)} linked files {what}: {', '.join(names[:MAX_NAMED])}" + (" …" if len(names) > MAX_NAMED else "")
    ]
