"""Names of the previews of a solve, for those who write them and those who show them. Imports nothing heavy."""

from __future__ import annotations

from pathlib import Path

KINDS = ("albedo", "light", "error")


def preview_path(folder: Path, kind: str) -> Path:
    """Where the preview ``kind`` of the solve into the result folder ``folder`` lies while it goes on."""
    return folder / "checkpoints" / f"preview-{kind}.png"
