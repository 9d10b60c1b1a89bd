"""Charts and tables out of the committed records: ``python -m benchmarks.report``.

Nothing is measured. Charts go to docs/images/benchmarks, tables between the marks ``<!-- measured: NAME -->`` and
``<!-- end -->`` of docs/benchmarks.md and the README; what stands outside the marks is left alone.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from iris_addon.base.files import atomic_write

from . import (
    ablation_section,
    curves_section,
    farm_section,
    formats_section,
    made_rooms_section,
    profile_section,
    scaling_section,
    scans_section,
    speed_section,
    stability_section,
)
from .machine import ROOT
from .records import COMMITTED, IMAGES, Record, pack, unpack

PAGE, README = ROOT / "docs" / "benchmarks.md", ROOT / "README.md"
Section = Callable[[Sequence[Record], Path], str]
"""(records, folder for charts) to Markdown."""
SECTIONS: Mapping[str, Section] = {
    "bench": speed_section.describe,
    "stability": stability_section.describe,
    "curves": curves_section.describe,
    "ablation": ablation_section.describe,
    "scaling": scaling_section.describe,
    "profile": profile_section.describe,
    "farm": farm_section.describe,
    "scans": scans_section.describe,
    "formats": formats_section.describe,
    "sunlit": made_rooms_section.describe_sunlit,
    "mirrors": made_rooms_section.describe_mirrors,
    "patterns": made_rooms_section.describe_patterns,
    "profiles": made_rooms_section.describe_profiles,
    "states": made_rooms_section.describe_states,
}
NOT_MEASURED = "Not measured yet."


def fill(page: str, sections: Mapping[str, str]) -> str:
    """``page`` with the text between the marks of each section replaced; a section without marks is an error."""
    for name, text in sections.items():
        mark = re.compile(rf"(<!-- measured: {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
        if not mark.search(page):
            raise ValueError(f"the page has no place for {name!r}")
        page = mark.sub(lambda found, text=text: f"{found[1]}{text.strip()}\n{found[2]}", page)
    return page


def write(
    names: Sequence[str], committed: Path = COMMITTED, images: Path = IMAGES, page: Path = PAGE, readme: Path = README
) -> None:
    """Draw the charts of the sections ``names``, write their tables into ``page`` and one preset's into ``readme``."""
    texts = {}
    for name in names:
        records = unpack(name, committed)
        texts[name] = SECTIONS[name](records, images) if records else NOT_MEASURED
    _fill_file(page, texts)
    if "bench" in names and (records := unpack("bench", committed)):
        _fill_file(readme, {"balanced": speed_section.balanced_table(records)})


def publish(name: str, records: Iterable[Record]) -> None:
    """Commit what was measured for the section ``name``, and make its charts and tables anew."""
    pack(name, records)
    write([name])


def _fill_file(path: Path, texts: Mapping[str, str]) -> None:
    text = fill(path.read_text(encoding="utf-8"), texts)
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", choices=[*SECTIONS, []], default=[])
    write(parser.parse_args(arguments).sections or list(SECTIONS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
