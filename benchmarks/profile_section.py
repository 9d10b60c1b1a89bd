"""A solve against its floor as a table: every stage with its rays, its bytes and the seconds that these need."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from . import tables
from .records import Record, machine_of


@dataclass(frozen=True)
class Floors:
    """Measured limits of the machine on one room: rays and bytes per second."""

    closest: float
    occluded: float
    bandwidth: float


@dataclass
class Counts:
    """Work per stage."""

    closest: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    occluded: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    moved: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def floor(self, stage: str, floors: Floors) -> float:
        """Seconds that the counted work of ``stage`` needs at least."""
        rays = self.closest.get(stage, 0) / floors.closest + self.occluded.get(stage, 0) / floors.occluded
        return rays + self.moved.get(stage, 0) / floors.bandwidth


def describe(records: Sequence[Record], _images: Path | None = None) -> str:
    """A table per record of :func:`benchmarks.profile_floor.profile`."""
    return "\n".join(
        [machine_of(records) + "\n"]
        + [
            floor_table(
                record["seconds"],
                Counts(**record["counts"]),
                Floors(**record["floors"]),
                f"`{record['run']['preset']}` on {record['run']['capture']}",
            )
            for record in records
        ]
    )


def floor_table(seconds: dict[str, float], counts: Counts, floors: Floors, what: str) -> str:
    """Every stage against its floor, in the order of the solve, as Markdown."""
    from iris_addon.pipeline import STAGE_SECONDS

    body, total, total_floor = [], 0.0, 0.0
    for stage in sorted(seconds, key=list(STAGE_SECONDS).index):
        spent = seconds[stage]
        floor = counts.floor(stage, floors)
        total, total_floor = total + spent, total_floor + floor
        rays = (counts.closest.get(stage, 0) + counts.occluded.get(stage, 0)) / 1e6
        moved = counts.moved.get(stage, 0) / 1e9
        ratio = f"{spent / floor:.1f}" if floor > 1e-3 else "–"
        body.append([stage, f"{spent:.1f}", f"{rays:.2f}", f"{moved:.2f}", f"{floor:.2f}", ratio])
    ratio = f"{total / total_floor:.1f}" if total_floor > 0 else "–"
    body.append(["**all**", f"{total:.1f}", "", "", f"{total_floor:.2f}", ratio])
    header = ["stage", "seconds", "million rays", "GB moved", "floor, seconds", "ratio"]
    limits = (
        f"{floors.closest / 1e6:.2f} million closest hits, {floors.occluded / 1e6:.2f} million visibility tests and "
        f"{floors.bandwidth / 1e9:.1f} GB per second"
    )
    return f"{what}: {limits}.\n\n{tables.markdown(header, body)}"
