"""The result folder: saved by a solve, loaded by every later command.

::

    report.json      schema_version and Result.report
    response.json    family, coefficients, samples, exposures and white balance per photo
    emitters.json    id, faces, radiance, area, confidence, patterned; harmonics of light from outside; sun; shell of
                     the backdrop; faces of panes; light states, if there were several
    backdrop.exr     what cameras see through holes of the mesh, if it has any; backdrop_albedo.exr, if that reflects
    materials/       base_color.exr, roughness.png, metallic.png, confidence.png, coverage.png, emission.exr, mesh.glb;
                     lamp_pattern.exr, if a lamp has one

A saving process may be killed at any point and another may read meanwhile: the folder then holds the old result or the
new one, never a mixture (:mod:`.files`). Loading writes nothing and checks all it reads. Given a reader of images it
needs numpy alone, since Blender's Python has no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.image_headers import announced_size
from ..base.untrusted import MAX_NUMBER, MEND, decoding
from ..model.capture import Mesh
from ..model.recovered import Backdrop, Textures
from ..model.texture_size import LARGEST_SIDE
from .files import BACKDROP, BACKDROP_ALBEDO, BASE_COLOR, COVERAGE, FILES, LAMP_PATTERN, MAPS, MESH, REPORT, result_file
from .glb import read_glb
from .records import StoredShell, read_emitters, read_report, read_response
from .result import Result
from .saving import SCHEMA_VERSION, save_result

__all__ = ["SCHEMA_VERSION", "ReadImage", "load_result", "save_result"]

MAX_BACKDROP_HEIGHT = 4096
LOAD_ATTEMPTS = 10
"""Times that loading is attempted while the result is being replaced."""

ReadImage = Callable[[Path], NDArray[np.floating]]
"""(H, W) or (H, W, C) of an image file: floats of an EXR, PNG code values divided by their maximum; row 0 on top."""


def load_result(folder: Path | str, read_image: ReadImage | None = None) -> Result:
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
    report = read_report(folder)
    if report.get("schema_version") != SCHEMA_VERSION:
        raise BadInput(
            f"has schema_version {report.get('schema_version')!r}, this program reads {SCHEMA_VERSION}",
            "solve again, or use the version of the program that wrote it",
            path,
        )
    mesh, regions, up = read_glb(result_file(folder, MESH))
    camera = read_response(folder)
    emitters, outside, sun, shell, panes, states = read_emitters(folder, mesh)
    textures = _read_textures(folder, read)
    if any(emitter.patterned for emitter in emitters):
        textures = replace(textures, lamp_pattern=_read_pattern(folder, len(textures.base_color), read))
    backdrop = None if shell is None else _painted(shell, folder, read)
    result = Result(
        mesh=mesh,
        regions=regions,
        textures=textures,
        emitters=emitters,
        outside=outside,
        sun=sun,
        response=camera.response,
        exposures=camera.exposures,
        report=report,
        up=up,
        local=camera.local,
        devices=camera.devices,
        backdrop=backdrop,
        panes=panes,
        light_states=states,
    )
    with decoding(path, "'model.camera' holds no corrections of cameras", MEND):
        result.as_taken([])  # so that a damaged report is reported here
    return result


def _read_textures(folder: Path, read_image: ReadImage) -> Textures:
    path = result_file(folder, BASE_COLOR)
    base_color = _read_texture(path, read_image)
    if base_color.ndim != 3 or base_color.shape[2] < 3:
        raise BadInput("has no RGB", MEND, path)
    maps = {name: _read_map(result_file(folder, file), len(base_color), read_image) for name, file in MAPS.items()}
    coverage = result_file(folder, COVERAGE)
    if coverage.is_file():  # results of earlier versions have none
        maps["coverage"] = _read_map(coverage, len(base_color), read_image)
    return Textures(np.ascontiguousarray(base_color[..., :3]), **maps)


def _read_pattern(folder: Path, size: int, read_image: ReadImage) -> NDArray[np.float32]:
    path = result_file(folder, LAMP_PATTERN)
    pattern = _read_texture(path, read_image)
    if pattern.shape[:2] != (size, size) or pattern.ndim != 3 or pattern.shape[2] < 3 or pattern.min() < 0:
        raise BadInput(f"is no RGB picture of {size}×{size} texels without negative ones", MEND, path)
    return np.ascontiguousarray(pattern[..., :3])


def read_coverage(folder: Path, read_image: ReadImage) -> tuple[Mesh, NDArray[np.float32], tuple[float, float, float]]:
    """Mesh without its panes, coverage (N, N) and up vector of the result in ``folder``, without its other textures.

    Where it has no coverage, the confidence of single texels stands for it.

    Raises:
        BadInput: the files are damaged or not there.
    """
    path = result_file(folder, COVERAGE)
    if not path.is_file():
        path = result_file(folder, MAPS["confidence"])
    mesh, _, up = read_glb(result_file(folder, MESH))
    return mesh.without(read_emitters(folder, mesh).panes), _read_map(path, None, read_image), up


def _read_map(path: Path, side: int | None, read_image: ReadImage) -> NDArray[np.float32]:
    values = _read_texture(path, read_image)
    if side is not None and len(values) != side:
        raise BadInput(f"is {values.shape[1]}x{values.shape[0]}, unlike base_color.exr", MEND, path)
    return np.ascontiguousarray(values if values.ndim == 2 else values[..., 0])


def _read_texture(path: Path, read_image: ReadImage) -> NDArray[np.float32]:
    width, height = announced_size(path)
    if width != height or not 0 < width <= LARGEST_SIDE:
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
    width, height = announced_size(path)
    if width != 2 * height or not 0 < height <= MAX_BACKDROP_HEIGHT:
        raise BadInput(f"is {width}x{height} pixels, no panorama twice as wide as high, or too large", MEND, path)
    values = _read_finite(path, (height, width), read_image)
    if values.ndim != 3 or values.shape[2] < 3 or values.min() < 0:
        raise BadInput("has no RGB or is negative", MEND, path)
    return np.ascontiguousarray(values[..., :3])


def _read_finite(path: Path, size: tuple[int, int], read_image: ReadImage) -> NDArray[np.float32]:
    values = np.asarray(read_image(path), dtype=np.float32)
    if values.shape[:2] != size or not (np.abs(values) <= MAX_NUMBER).all():
        raise BadInput("does not have the size of its header, or is not finite", MEND, path)
    return values


def _read_image(path: Path) -> NDArray[np.floating]:
    from ..base.images import read_exr, read_map

    if path.suffix == ".exr":
        return read_exr(path)
    codes = read_map(path)
    return codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
