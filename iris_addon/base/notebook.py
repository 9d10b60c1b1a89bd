"""Progress in a Jupyter notebook: one line below the cell that is replaced as work goes on."""

from __future__ import annotations

from typing import Any

from .progress import ProgressEvent, Sink


def notebook_line() -> Sink:
    """Sink that keeps one line of output up to date. Needs IPython, which every notebook has."""
    from IPython.display import display  # pyright: ignore[reportMissingImports]

    shown: Any = None

    def write(event: ProgressEvent) -> None:
        nonlocal shown
        left = "" if event.seconds_left is None or event.overall >= 1 else f", about {event.seconds_left:.0f} s left"
        line = {"text/plain": f"{event.overall:4.0%}  {event.stage}{left}"}
        if shown is None:
            shown = display(line, raw=True, display_id=True)
        else:
            shown.update(line, raw=True)

    return write
