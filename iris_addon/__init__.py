"""IRIS as a Python library: materials, lights and the camera response of a room from photos and a mesh.

Arrays are numpy's. Lengths are metres, colours and radiance scene-linear Rec.709, poses camera-to-world with x right,
y up and z backward.

Example:
    >>> import iris_addon as iris
    >>> capture = iris.read_capture("assets/demo_room")
    >>> result = iris.solve(capture, iris.preset("draft"))
    >>> len(result.emitters), result.emitters[0].radiance.shape
    (4, (3,))
    >>> maps = result.render_maps(capture.views[0].camera)
    >>> maps.base_color.shape
    (240, 320, 3)
    >>> result.with_emitter(0, radiance=0.0).save("out/lamp_0_off")

Importing this package imports nothing else: Blender's Python, which has neither torch nor scipy, uses parts of it. What
is not a function below is imported when it is first asked for.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base.errors import BadInput, Cancelled, IrisError, SolverEnvironmentMissing
    from .base.progress import Progress
    from .capture.reader import read_capture
    from .config import SolveConfig, preset
    from .evaluate.evaluation import evaluate
    from .model.capture import Camera, Capture, Mesh, View
    from .model.recovered import Backdrop, Emitter, OutsideLight, Textures
    from .results.folder import load_result
    from .results.maps import ViewMaps
    from .results.result import Result

__version__ = "0.1.0"

__all__ = [
    "Backdrop",
    "BadInput",
    "Camera",
    "Cancelled",
    "Capture",
    "Emitter",
    "IrisError",
    "Mesh",
    "OutsideLight",
    "Progress",
    "Result",
    "SolveConfig",
    "SolverEnvironmentMissing",
    "Textures",
    "View",
    "ViewMaps",
    "evaluate",
    "inspect",
    "load_result",
    "preset",
    "read_capture",
    "solve",
]

_HOME = {
    "base.errors": ("BadInput", "Cancelled", "IrisError", "SolverEnvironmentMissing"),
    "base.progress": ("Progress",),
    "capture.reader": ("read_capture",),
    "config": ("SolveConfig", "preset"),
    "evaluate.evaluation": ("evaluate",),
    "model.capture": ("Camera", "Capture", "Mesh", "View"),
    "model.recovered": ("Backdrop", "Emitter", "OutsideLight", "Textures"),
    "results.folder": ("load_result",),
    "results.maps": ("ViewMaps",),
    "results.result": ("Result",),
}
"""Module to the names of the API that it defines."""


def solve(
    capture: Capture,
    config: SolveConfig | None = None,
    out: Path | str | None = None,
    *,
    resume: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Recover the response, the exposures, the lights and the materials of a capture.

    Ctrl-C stops the solve at its next progress update, about a tenth of a second later; a second Ctrl-C interrupts
    Python at once.

    Args:
        capture: what :func:`read_capture` read.
        config: a :func:`preset`, with fields replaced as needed; ``balanced`` without it.
        out: the result folder, which gets the result, its report and, until these are there, finished stages. Without
            it the result is in memory alone; :meth:`Result.save` writes it.
        resume: go on from the finished stages in ``out``.
        progress: receives updates and can cancel. Without it a line on the terminal or in the notebook shows the stage
            and the time left, and nothing is shown where there is neither.

    Raises:
        BadInput: a photo cannot be read, the photos determine nothing, or another process is solving into ``out``.
        Cancelled: by Ctrl-C or ``progress.cancel()``.
        IrisError: the disk is full.

    Example:
        >>> import iris_addon as iris
        >>> capture = iris.read_capture("assets/demo_room")
        >>> result = iris.solve(capture, iris.preset("draft", seed=1), "out/room")
        >>> result.textures.base_color.shape
        (1024, 1024, 3)
    """
    from .pipeline import solve as run

    with _folder(out) as folder, _cancelled_by_interrupt(progress or _shown_progress()) as reported:
        return run(capture, config or _balanced(), folder, reported, resume=resume)


def inspect(
    capture: Capture,
    out: Path | str | None = None,
    *,
    config: SolveConfig | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure a capture before it is solved: clipping, exposures, alignment of photos and mesh.

    Args:
        out: folder for what Blender's panel shows (photos without distortion, the mesh); without it nothing is kept.
        config: of the solve to come; ``balanced`` without it.
        progress: as for :func:`solve`.

    Returns:
        The content of ``capture.json``: ``warnings``, a list of sentences; ``textures``, the most texels and bytes in
        Blender's memory that a solve with ``config`` gives; and ``views``, which has for each photo its shares of
        ``saturated`` and ``black`` pixels and its ``alignment``.

    Raises:
        BadInput: a photo cannot be read.
        Cancelled: by Ctrl-C or ``progress.cancel()``.

    Example:
        >>> import iris_addon as iris
        >>> report = iris.inspect(iris.read_capture("assets/demo_room"))
        >>> report["warnings"]
        []
    """
    from .capture.inspection import inspect as run

    with _folder(out) as folder, _cancelled_by_interrupt(progress or _shown_progress()) as reported:
        return run(capture, folder, reported, config or _balanced())


def _balanced() -> SolveConfig:
    from .config import preset

    return preset("balanced")


@contextmanager
def _folder(given: Path | str | None) -> Iterator[Path]:
    """The folder ``given``, or a temporary one that is gone afterwards."""
    if given is not None:
        yield Path(given)
        return
    import tempfile

    with tempfile.TemporaryDirectory(prefix="iris-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


@contextmanager
def _cancelled_by_interrupt(progress: Progress) -> Iterator[Progress]:
    """Let the first Ctrl-C cancel ``progress``. Only the main thread can: in another one Ctrl-C stays as it is."""
    import signal
    import threading

    def cancel(number: int, frame: Any) -> None:
        signal.signal(signal.SIGINT, before)
        progress.cancel()

    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield progress
        return
    signal.signal(signal.SIGINT, cancel)
    try:
        yield progress
    finally:
        signal.signal(signal.SIGINT, before)


def _shown_progress() -> Progress:
    """Progress that shows itself where somebody is looking."""
    from .base.progress import Progress, console

    if "ipykernel" in sys.modules:
        from .base.notebook import notebook_line

        return Progress(notebook_line())
    return Progress(console(sys.stderr)) if sys.stderr is not None and sys.stderr.isatty() else Progress()


# ---- names that are imported when they are first asked for ----------------------------------------------------------


class _Package(ModuleType):
    """This package. The import system would put the room ``evaluate`` over the function of that name; here the function
    stays, and the room is reached as ``from iris_addon.evaluate import …``."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (isinstance(value, ModuleType) and name in __all__):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f".{module}", __name__), name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
