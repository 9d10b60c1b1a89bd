"""What a command returns to the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from iris_addon.base.errors import one_line
from iris_addon.model.texture_size import in_blender
from iris_addon.results.result import Result


@dataclass(frozen=True)
class Outcome:
    """Text for a person, data for a program, and the exit code."""

    text: str
    data: Mapping[str, Any]
    exit_code: int = 0

    @classmethod
    def of(cls, title: str, data: Mapping[str, Any]) -> Outcome:
        """An outcome whose text lists ``data`` under ``title``."""
        return cls("\n".join([one_line(title), *rows(data)]), data)


def rows(data: Mapping[str, Any]) -> list[str]:
    """One indented line per entry, of a list one per item; numbers have four digits, nested objects are omitted."""
    width = max((len(key) for key in data), default=0)
    lines = []
    for key, value in data.items():
        if isinstance(value, Mapping) or value is None:
            continue
        items = value if isinstance(value, list | tuple) else [value]
        for number, item in enumerate(items):
            shown = f"{item:.4g}" if isinstance(item, float) else one_line(str(item))
            lines.append(f"  {key if number == 0 else '':<{width}}  {shown}")
    return lines


def summarise(result: Result) -> dict[str, Any]:
    """The figures of a solve that fit on a few lines."""
    report = result.report
    seconds, atlas = report.get("seconds"), report.get("atlas")
    size = atlas and in_blender(atlas["side"], atlas["bytes_in_blender"])
    return {
        "preset": report.get("preset"),
        "lights": len(result.emitters),
        "holdout_psnr": report.get("holdout_psnr"),
        "seconds": float(sum(seconds.values())) if isinstance(seconds, dict) else None,
        "rays_traced": report.get("rays_traced"),
        "n_patches": report.get("n_patches"),
        "atlas": atlas and f"{size} in Blender, {atlas['texels_per_metre']:.0f} texels per metre",
        "warnings": report.get("warnings") or None,
    }
