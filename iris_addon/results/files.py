"""The files of a result folder: their names, where each lies, and how a save replaces them. Imports nothing heavy.

A save is written into a temporary folder that is renamed to WHOLE in one step. From then on the result is the new one:
:func:`result_file` finds its files there, and :func:`complete_save` moves them to their places, report.json last.
Readers move nothing: the folder may be read-only or foreign, and a solve may be moving the same files.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from ..base.files import flush_to_disk, is_own_file, is_own_folder, replace_when_free, require_own_folder
from ..base.untrusted import require_inside

WHOLE = ".whole"
"""Folder of a result that is completely written and not yet moved in place."""
MATERIALS = "materials"
REPORT, RESPONSE, EMITTERS = "report.json", "response.json", "emitters.json"
BACKDROP, BACKDROP_ALBEDO = "backdrop.exr", "backdrop_albedo.exr"
BASE_COLOR, EMISSION, MESH = (f"{MATERIALS}/{name}" for name in ("base_color.exr", "emission.exr", "mesh.glb"))
MAPS = {name: f"{MATERIALS}/{name}.png" for name in ("roughness", "metallic", "confidence")}
COVERAGE = f"{MATERIALS}/coverage.png"
LAMP_PATTERN = f"{MATERIALS}/lamp_pattern.exr"
MATERIAL_FILES = (BASE_COLOR, EMISSION, MESH, *MAPS.values())
REPORT_PAGE, PICTURES = "report.html", "report"
"""The page that people look at, and the folder of its pictures."""
FILES = (EMITTERS, RESPONSE, BACKDROP, BACKDROP_ALBEDO, *MATERIAL_FILES, COVERAGE, LAMP_PATTERN, REPORT)
"""All files of a result, in the order in which they are moved."""
PREVIEWS = ("albedo", "light", "error")
"""Kinds of previews of a solve in progress."""


def result_file(folder: Path, name: str) -> Path:
    """Path of the file ``name`` of the result in ``folder``, whether it exists or not.

    Args:
        name: one of FILES.

    Raises:
        BadInput: it is a link that leads out of ``folder``.
    """
    path = folder / WHOLE / name if _waits(folder, name) else folder / name
    require_inside(path, folder)
    return path


def complete_save(folder: Path) -> None:
    """Move the files of a completed save to their places; also completes a save that was killed while moving.

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
    for name in (BACKDROP, BACKDROP_ALBEDO, COVERAGE, LAMP_PATTERN):
        if EMITTERS in waiting and name not in waiting:
            (folder / name).unlink(missing_ok=True)  # of the previous result
    for name in waiting:
        replace_when_free(folder / WHOLE / name, folder / name)
    for changed in (folder / MATERIALS, folder):
        flush_to_disk(changed)
    shutil.rmtree(folder / WHOLE)


def require_no_links(folder: Path) -> None:
    """Check that a save into ``folder`` writes nowhere else.

    Raises:
        BadInput: where a folder of the result belongs, there is a link or a file.
    """
    for name in (WHOLE, MATERIALS):
        require_own_folder(folder / name)


def _waits(folder: Path, name: str) -> bool:
    waiting = folder / WHOLE / name
    return is_own_folder(folder / WHOLE) and is_own_folder(waiting.parent) and is_own_file(waiting)


def preview_path(folder: Path, kind: str) -> Path:
    """Path of the preview ``kind``, one of PREVIEWS, of a solve in progress into the result folder ``folder``."""
    return folder / "checkpoints" / f"preview-{kind}.png"


def lamp_picture(folder: Path, number: int) -> Path:
    """Path of the picture of the lamp with the id ``number`` of the result in ``folder``, whether it exists or not."""
    return folder / PICTURES / f"lamp-{number:02d}.png"
