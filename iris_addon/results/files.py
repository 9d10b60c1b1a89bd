"""The files of a result folder: their names, where each lies, and how a save takes their place.

A save is written into a folder of its own that gets the name WHOLE in one step. From then on the result is the new one:
:func:`result_file` finds its files there, and :func:`complete_save` moves them to their places, report.json last. Who
reads moves nothing: the folder may be that of a stranger, and a solve may be moving the same files.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from ..base.files import is_own_file, is_own_folder, require_own_folder

WHOLE = ".whole"
"""Folder of a result that is written and not yet moved in place."""
MATERIALS = "materials"
REPORT, RESPONSE, EMITTERS = "report.json", "response.json", "emitters.json"
BACKDROP, BACKDROP_ALBEDO = "backdrop.exr", "backdrop_albedo.exr"
BASE_COLOR, EMISSION, MESH = (f"{MATERIALS}/{name}" for name in ("base_color.exr", "emission.exr", "mesh.glb"))
MAPS = {name: f"{MATERIALS}/{name}.png" for name in ("roughness", "metallic", "confidence")}
MATERIAL_FILES = (BASE_COLOR, EMISSION, MESH, *MAPS.values())
FILES = (EMITTERS, RESPONSE, BACKDROP, BACKDROP_ALBEDO, *MATERIAL_FILES, REPORT)
"""Everything a result consists of, in the order in which it is moved."""


def result_file(folder: Path, name: str) -> Path:
    """Where the file ``name`` of the result in ``folder`` lies, be it there or missing.

    Args:
        name: one of FILES.
    """
    return folder / WHOLE / name if _waits(folder, name) else folder / name


def complete_save(folder: Path) -> None:
    """Move what a save has written whole to its place, also for one that was killed while it did this itself.

    Only for the process that writes ``folder``. Nothing but FILES is moved, and nothing through a link.

    Raises:
        BadInput: where a folder of the result belongs, there is a link or a file.
        OSError: a file cannot be moved.
    """
    require_no_links(folder)
    if not (folder / WHOLE).is_dir():
        return
    (folder / MATERIALS).mkdir(exist_ok=True)
    waiting = [name for name in FILES if _waits(folder, name)]
    for name in (BACKDROP, BACKDROP_ALBEDO):
        if EMITTERS in waiting and name not in waiting:
            (folder / name).unlink(missing_ok=True)  # of the result before
    for name in waiting:
        os.replace(folder / WHOLE / name, folder / name)
    shutil.rmtree(folder / WHOLE)


def require_no_links(folder: Path) -> None:
    """Make sure that a save into ``folder`` stays in it.

    Raises:
        BadInput: where a folder of the result belongs, there is a link or a file.
    """
    for name in (WHOLE, MATERIALS):
        require_own_folder(folder / name)


def _waits(folder: Path, name: str) -> bool:
    waiting = folder / WHOLE / name
    return is_own_folder(folder / WHOLE) and is_own_folder(waiting.parent) and is_own_file(waiting)


# ---- Names of the previews of a solve, for those who write them and those who show them. Imports nothing heavy ------


KINDS = ("albedo", "light", "error")


def preview_path(folder: Path, kind: str) -> Path:
    """Where the preview ``kind`` of the solve into the result folder ``folder`` lies while it goes on."""
    return folder / "checkpoints" / f"preview-{kind}.png"
