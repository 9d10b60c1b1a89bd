"""The solved demo room that comes with the add-on, laid out in a folder of the user as if solved there."""

from __future__ import annotations

import filecmp
import shutil
from pathlib import Path

from ...base.errors import IrisError
from ...base.files import require_own_folder, write_arrays, write_json
from ...base.untrusted import read_json
from ...results.folder import load_result
from ..images import read_image
from ..worker.process import ADDON

CAPTURE, SOLVED = ADDON / "assets" / "demo_room", ADDON / "assets" / "demo_solved"
INSPECTION = "inspection"


def unpack_solved_demo(folder: Path) -> None:
    """Make ``folder`` the result folder of the demo, with the check of its photos.

    Files that are there already as they come with the add-on are left, so that a scene with this result finds it again;
    whatever else has their names is replaced.

    Raises:
        BadInput: a file of the add-on is missing or damaged, or a folder of the result is a link.
        IrisError: the folder cannot be written.
    """
    for name in ("materials", "report", INSPECTION):
        require_own_folder(folder / name)
    try:
        for source in sorted(SOLVED.rglob("*"), key=lambda path: path.name == "report.json"):  # what is whole has that
            target = folder / source.relative_to(SOLVED)
            if source.is_dir() or source.parent.name == INSPECTION or _same(source, target):
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
    except OSError as error:
        fix = "free some disk space, or check the permissions of the folder"
        raise IrisError(f"the demo cannot be written ({error.strerror})", fix, folder) from error
    mesh = load_result(folder, read_image).mesh
    (folder / INSPECTION).mkdir(exist_ok=True)
    write_arrays(folder / INSPECTION / "mesh.npz", {"vertices": mesh.vertices, "faces": mesh.faces})
    content = read_json(SOLVED / INSPECTION / "capture.json")
    photos = CAPTURE / "train" / "Image"
    rows = [{**row, "photo": photos / Path(str(row["photo"])).name} for row in content["views"]]
    write_json(folder / INSPECTION / "capture.json", {**content, "root": CAPTURE, "views": rows})


def _same(source: Path, target: Path) -> bool:
    return target.is_file() and filecmp.cmp(source, target, shallow=False)
