"""The result folder: saved by a solve, loaded by every later command.

::

    report.json      schema_version and Result.report
    response.json    family, coefficients, samples, exposures and white balance per photo
    emitters.json    id, faces, radiance, area, confidence; light from outside, spherical harmonics; backdrop, its shell
    backdrop.exr     what cameras see through holes of the mesh, if it has any; backdrop_albedo.exr, if that reflects
    materials/       base_color.exr, roughness.png, metallic.png, confidence.png, emission.exr, mesh.glb

A saving process may be killed at any point and another may read meanwhile: the folder then holds the old result or the
new one, never a mixture (:mod:`.files`). Loading writes nothing and checks all it reads. Given a reader of images it
needs numpy alone, since Blender's Python has no more.
"""

from __future__ import annotations

import errno
import os
import shutil
import struct
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput, IrisError
from ..base.files import MEND, dump_json, read_json
from ..base.parallel import cores
from ..model.recovered import Backdrop, Textures
from .files import (
    BACKDROP,
    BACKDROP_ALBEDO,
    BASE_COLOR,
    EMISSION,
    EMITTERS,
    FILES,
    MAPS,
    MATERIALS,
    MESH,
    REPORT,
    RESPONSE,
    WHOLE,
    complete_save,
    require_no_links,
    result_file,
)
from .glb import encode_glb, read_glb
from .records import StoredShell, emitters_json, read_emitters, read_response, response_json
from .result import Result

SCHEMA_VERSION = 2
MAX_TEXTURE_SIDE = 16384
MAX_BACKDROP_HEIGHT = 4096
LOAD_ATTEMPTS = 10
"""Times that loading is attempted while the result is being replaced."""
EMISSION_SIDE = 1024
"""Greatest side of the emission picture in texels; emitters.json has the exact faces."""

ReadImage = Callable[[Path], NDArray[np.floating]]
"""(H, W) or (H, W, C) of an image file: floats of an EXR, PNG code values divided by their maximum; row 0 on top."""


# ---- saving --------------------------------------------------------------------------------------------------------


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
        for abandoned in folder.glob(".tmp-*"):  # of a process that was killed
            shutil.rmtree(abandoned, ignore_errors=True)
        staging = Path(tempfile.mkdtemp(prefix=".tmp-", dir=folder))
        _write_all(result, staging)
        os.replace(staging, folder / WHOLE)
        complete_save(folder)
    except OSError as error:
        fix = "free some space and run again" if error.errno == errno.ENOSPC else "check the folder and its permissions"
        raise IrisError(f"the result cannot be written ({error.strerror or error})", fix, folder) from error
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)


def _write_all(result: Result, folder: Path) -> None:
    from ..base.images import write_exr, write_png  # not needed to load, and missing in Blender

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
    """(N, N, 3) radiance on the atlas, N at most EMISSION_SIDE: a picture of the lights for other programs."""
    from PIL import Image, ImageDraw

    side = min(EMISSION_SIDE, len(result.textures.base_color))
    emission = np.zeros((side, side, 3), np.float32)
    uv = result.mesh.uv
    assert uv is not None
    for emitter in result.emitters:
        mask = Image.new("1", (side, side))
        draw = ImageDraw.Draw(mask)
        for corners in uv[emitter.faces]:
            # ImageDraw has pixel centres at integers.
            draw.polygon([(u * side - 0.5, (1 - v) * side - 0.5) for u, v in corners.tolist()], fill=1, outline=1)
        emission[np.asarray(mask)] = emitter.radiance
    return emission


# ---- loading -------------------------------------------------------------------------------------------------------


def load_result(folder: Path, read_image: ReadImage | None = None) -> Result:
    """Read a result folder.

    Args:
        read_image: reader for EXR and PNG (see :data:`ReadImage`); None uses OpenEXR and Pillow.

    Raises:
        BadInput: no result there, made by another version, or a file of it is missing, damaged or contradicts itself.
    """
    folder = Path(folder)
    for _ in range(LOAD_ATTEMPTS):
        version, places = _version(folder), _places(folder)
        try:
            result = _load(folder, read_image or _read_image)
        except BadInput:
            if _places(folder) == places and _version(folder) == version:
                raise
            continue  # a file was moved before it was opened
        if _version(folder) == version:
            return result
    raise BadInput("is being replaced all the time", "wait until nothing writes it any more", folder)


def _version(folder: Path) -> tuple[int, ...]:
    """Identifies the result that :func:`result_file` finds now; the same before and after its files are moved."""
    try:
        report = result_file(folder, REPORT).stat()
    except OSError:
        return ()
    return report.st_ino, report.st_mtime_ns, report.st_size


def _places(folder: Path) -> list[Path]:
    return [result_file(folder, name) for name in FILES]


def _load(folder: Path, read: ReadImage) -> Result:
    path = result_file(folder, REPORT)
    if not path.is_file():
        raise BadInput("is not a finished result (it has no report.json)", "give the folder that solve wrote", folder)
    report = read_json(path)
    if report.get("schema_version") != SCHEMA_VERSION:
        raise BadInput(
            f"has schema_version {report.get('schema_version')!r}, this program reads {SCHEMA_VERSION}",
            "solve again, or use the version of the program that wrote it",
            path,
        )
    mesh, regions, up = read_glb(result_file(folder, MESH))
    response, exposures, local = read_response(folder)
    emitters, outside, shell = read_emitters(folder, mesh)
    textures = _read_textures(folder, read)
    backdrop = None if shell is None else _painted(shell, folder, read)
    result = Result(
        mesh=mesh,
        regions=regions,
        textures=textures,
        emitters=emitters,
        outside=outside,
        response=response,
        exposures=exposures,
        report=report,
        up=up,
        local=local,
        backdrop=backdrop,
    )
    try:
        result.as_taken([])  # so that a damaged report is reported here
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput("'model.camera' holds no corrections of cameras", MEND, path) from error
    return result


def _read_textures(folder: Path, read_image: ReadImage) -> Textures:
    path = result_file(folder, BASE_COLOR)
    base_color = _read_texture(path, read_image)
    if base_color.ndim != 3 or base_color.shape[2] < 3:
        raise BadInput("has no RGB", MEND, path)
    maps = {}
    for name, file in MAPS.items():
        path = result_file(folder, file)
        values = _read_texture(path, read_image)
        maps[name] = np.ascontiguousarray(values if values.ndim == 2 else values[..., 0])
        if maps[name].shape != base_color.shape[:2]:
            raise BadInput(f"is {values.shape[1]}x{values.shape[0]}, unlike base_color.exr", MEND, path)
    return Textures(np.ascontiguousarray(base_color[..., :3]), **maps)


def _read_texture(path: Path, read_image: ReadImage) -> NDArray[np.float32]:
    width, height = _image_size(path)
    if width != height or not 0 < width <= MAX_TEXTURE_SIDE:
        raise BadInput(f"is {width}x{height} pixels, not square or too large", MEND, path)
    return _read_finite(path, (height, width), read_image)


def _painted(shell: StoredShell, folder: Path, read_image: ReadImage) -> Backdrop:
    picture, albedo = _read_panorama(result_file(folder, BACKDROP), read_image), None
    if shell.reflects:
        path = result_file(folder, BACKDROP_ALBEDO)
        albedo = _read_panorama(path, read_image)
        if albedo.shape != picture.shape or albedo.max() > 1:
            raise BadInput(f"is no albedo, or not of the size of {BACKDROP}", MEND, path)
    return Backdrop(shell.vertices, shell.faces, picture, albedo)


def _read_panorama(path: Path, read_image: ReadImage) -> NDArray[np.float32]:
    width, height = _image_size(path)
    if width != 2 * height or not 0 < height <= MAX_BACKDROP_HEIGHT:
        raise BadInput(f"is {width}x{height} pixels, no panorama twice as wide as high, or too large", MEND, path)
    values = _read_finite(path, (height, width), read_image)
    if values.ndim != 3 or values.shape[2] < 3 or values.min() < 0:
        raise BadInput("has no RGB or is negative", MEND, path)
    return np.ascontiguousarray(values[..., :3])


def _read_finite(path: Path, size: tuple[int, int], read_image: ReadImage) -> NDArray[np.float32]:
    values = np.asarray(read_image(path), dtype=np.float32)
    if values.shape[:2] != size or not np.isfinite(values).all():
        raise BadInput("does not have the size of its header, or is not finite", MEND, path)
    return values


def _image_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header of a PNG or EXR file, before its pixels are allocated."""
    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", MEND, path) from error
    try:
        if path.suffix == ".png" and head[:8] == b"\x89PNG\r\n\x1a\n":
            return struct.unpack_from(">II", head, 16)
        tag = b"dataWindow\0box2i\0\x10\0\0\0"
        if path.suffix == ".exr" and head[:4] == b"v/1\x01" and tag in head:
            x0, y0, x1, y1 = struct.unpack_from("<4i", head, head.index(tag) + len(tag))
            return x1 - x0 + 1, y1 - y0 + 1
    except struct.error as error:
        raise BadInput("is truncated", MEND, path) from error
    raise BadInput(f"is not a {path.suffix[1:].upper()} file", MEND, path)


def _read_image(path: Path) -> NDArray[np.floating]:
    from ..base.images import read_exr, read_map

    if path.suffix == ".exr":
        return read_exr(path)
    codes = read_map(path)
    return codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
