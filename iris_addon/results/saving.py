"""A result written as a folder, whole or not at all; :mod:`.folder` says what lies in it and reads it back."""

from __future__ import annotations

import errno
import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..base.errors import IrisError
from ..base.files import dump_json, flush_to_disk, replace_when_free
from ..base.parallel import cores
from .files import (
    BACKDROP,
    BACKDROP_ALBEDO,
    BASE_COLOR,
    COVERAGE,
    EMISSION,
    EMITTERS,
    LAMP_PATTERN,
    MAPS,
    MATERIALS,
    MESH,
    REPORT,
    RESPONSE,
    WHOLE,
    complete_save,
    require_no_links,
)
from .glb import encode_glb
from .records import emitters_json, response_json

if TYPE_CHECKING:
    from .result import Result  # which imports this file, for Result.save

SCHEMA_VERSION = 2
EMISSION_SIDE = 1024
"""Side of the emission picture in texels; what emits is said exactly by emitters.json."""


def save_result(result: Result, folder: Path) -> None:
    """Write ``result`` as the result folder ``folder``.

    Base colour keeps half precision, the other textures 16 bit; everything else is exact.

    Raises:
        BadInput: where a folder of the result belongs, there is a link or a file.
        IrisError: the disk is full or the folder not writable. What was in the folder before is untouched.
    """
    folder = Path(folder)
    require_no_links(folder)
    staging: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        complete_save(folder)
        for abandoned in folder.glob(".tmp-*"):  # by a process that was killed
            shutil.rmtree(abandoned, ignore_errors=True)
        staging = Path(tempfile.mkdtemp(prefix=".tmp-", dir=folder))
        _write_all(result, staging)
        for path in (*staging.rglob("*"), staging):
            flush_to_disk(path)
        replace_when_free(staging, folder / WHOLE)
        flush_to_disk(folder)
        complete_save(folder)
    except OSError as error:
        fix = "free some space and run again" if error.errno == errno.ENOSPC else "check the folder and its permissions"
        raise IrisError(f"the result cannot be written ({error.strerror or error})", fix, folder) from error
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)


def _write_all(result: Result, folder: Path) -> None:
    from ..base.images import write_exr, write_png  # not needed to load, and not there in Blender

    (folder / MATERIALS).mkdir()

    def write_map(name: str) -> None:
        values = np.clip(getattr(result.textures, name), 0.0, 1.0)
        write_png(folder / MAPS[name], np.round(values * 65535.0).astype(np.uint16))

    with ThreadPoolExecutor(cores()) as threads:
        jobs = [
            threads.submit(write_exr, folder / BASE_COLOR, result.textures.base_color, half=True),
            threads.submit(write_exr, folder / EMISSION, emission_texture(result), half=True),
            *(threads.submit(write_map, name) for name in MAPS),
        ]
        if result.textures.coverage is not None:  # a picture for people: 8 bits
            levels = np.round(np.clip(result.textures.coverage, 0.0, 1.0) * 255.0).astype(np.uint8)
            jobs.append(threads.submit(write_png, folder / COVERAGE, levels))
        if result.textures.lamp_pattern is not None:
            jobs.append(threads.submit(write_exr, folder / LAMP_PATTERN, result.textures.lamp_pattern, half=True))
    for job in jobs:
        job.result()
    (folder / MESH).write_bytes(encode_glb(result.mesh, result.regions, result.up))
    dump_json(folder / RESPONSE, response_json(result))
    if result.backdrop is not None:
        write_exr(folder / BACKDROP, result.backdrop.picture, half=True)
        if result.backdrop.albedo is not None:
            write_exr(folder / BACKDROP_ALBEDO, result.backdrop.albedo, half=True)
    dump_json(folder / EMITTERS, emitters_json(result))
    dump_json(folder / REPORT, {"schema_version": SCHEMA_VERSION, **result.report})


def emission_texture(result: Result) -> NDArray[np.float32]:
    """(N, N, 3) radiance on the atlas, N at most 1024: a picture of the lights for people and other programs."""
    from PIL import Image, ImageDraw

    side = min(EMISSION_SIDE, len(result.textures.base_color))
    emission = np.zeros((side, side, 3), np.float32)
    uv = result.mesh.uv
    assert uv is not None
    for emitter in result.emitters:
        mask = Image.new("1", (side, side))
        draw = ImageDraw.Draw(mask)
        for corners in uv[emitter.faces]:
            # Pixel centres stand at whole numbers for ImageDraw.
            draw.polygon([(u * side - 0.5, (1 - v) * side - 0.5) for u, v in corners.tolist()], fill=1, outline=1)
        on = np.asarray(mask)
        emission[on] = emitter.radiance
        if emitter.patterned and result.textures.lamp_pattern is not None:
            texel = ((np.arange(side) + 0.5) * len(result.textures.lamp_pattern) / side).astype(int)
            emission[on] *= result.textures.lamp_pattern[np.ix_(texel, texel)][on]
    return emission
