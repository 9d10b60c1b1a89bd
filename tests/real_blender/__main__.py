"""``python -m tests.real_blender [--suites trixie,sid] [--seconds N]``: set up, run everything, print a table.

Exit status: 1 something failed, else 0. What the machine cannot run, or what the time did not suffice for, is skipped
with that reason.
"""

from __future__ import annotations

import argparse
import re
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from . import failures, scenario, scenario_states
from .display import Display
from .root import REPOSITORY, SUITES, Root, Unavailable, set_up
from .session import Session
from .stage import Stage

OUT = REPOSITORY / "out" / "real_blender"
WORRIES = re.compile(r"warn|error|traceback|deprecat|leak|orphan", re.IGNORECASE)
# The picture of a review; and what Debian's Blender, which has no translations, says without the extension, too.
HARMLESS = re.compile(r"-error\.png$|'PreferencesView', '\(null\)', 'language'")


class OutOfTime(Exception):
    """The limit of --seconds."""


@dataclass
class Row:
    """One line of the table."""

    suite: str
    step: str
    verdict: str
    seconds: float
    says: str


class Table:
    """Runs steps, prints each as it ends, remembers whether all went well."""

    def __init__(self) -> None:
        self.rows: list[Row] = []

    def add(self, suite: str, step: str, verdict: str, began: float, says: str) -> None:
        """A row, printed at once."""
        row = Row(suite=suite, step=step, verdict=verdict, seconds=time.monotonic() - began, says=says)
        self.rows.append(row)
        print(f"{suite:7} {step:22} {verdict:7} {row.seconds:6.1f} s  {says}", flush=True)

    def run(self, suite: str, steps: Iterable[Callable[[Stage], str]], stage: Stage) -> bool:
        """Steps in order up to the first that fails, which leaves a picture; whether all passed."""
        for step in steps:
            began = time.monotonic()
            try:
                self.add(suite, step.__name__, "ok", began, step(stage))
            except OutOfTime:
                raise
            except Exception as error:
                stage.photograph_at_once(f"failed_{step.__name__}")
                (stage.pictures / f"failed_{step.__name__}.txt").write_text(traceback.format_exc())
                self.add(
                    suite,
                    step.__name__,
                    "FAILED",
                    began,
                    str(error).strip().splitlines()[0] if str(error) else repr(error),
                )
                return False
        return True

    @property
    def failed(self) -> bool:
        """Whether any step failed."""
        return any(row.verdict == "FAILED" for row in self.rows)


def run_suite(suite: str, table: Table) -> None:
    """Everything in one version of Blender."""
    folder = OUT / suite
    shutil.rmtree(folder, ignore_errors=True)
    home = folder / "home"
    home.mkdir(parents=True)
    began = time.monotonic()
    try:
        root = set_up(suite, home, folder / "set_up.log")
    except Unavailable as reason:
        table.add(suite, "set_up", "skipped", began, str(reason))
        return
    table.add(suite, "set_up", "ok", began, root.output("blender", "-b", "--version").splitlines()[0])
    began = time.monotonic()
    target = ("--output-filepath", f"{root.HOME}/iris.zip")
    root.output("blender", "--command", "extension", "build", "--source-dir", root.REPOSITORY, *target)
    root.output("blender", "--command", "extension", "validate", f"{root.HOME}/iris.zip")
    table.add(suite, "build_and_validate", "ok", began, f"{(home / 'iris.zip').stat().st_size / 1e6:.1f} MB")
    with Display(root, folder / "xvfb.log") as display:
        if scenes(suite, table, root, display, folder):
            began = time.monotonic()
            worries = console(folder)
            table.add(suite, "console", "FAILED" if worries else "ok", began, worries[0] if worries else "no warnings")


def scenes(suite: str, table: Table, root: Root, display: Display, folder: Path) -> bool:
    """The scenario in one Blender, and what goes wrong up to its violent end; the rest of that in a second one;
    and in a third one what needs no solver."""
    with Session(root, display, folder / "blender_1.log") as session:
        stage = Stage(session, folder)
        passed = table.run(suite, scenario.STEPS, stage)
        for name, figure in stage.figures.items():
            table.add(suite, name, "", time.monotonic(), figure)
        if not passed or not table.run(suite, failures.BEFORE_KILL, stage):
            return False
    with Session(root, display, folder / "blender_2.log", f"{root.HOME}/{failures.BLEND}") as session:
        if not table.run(suite, failures.AFTER_KILL, Stage(session, folder)):
            return False
    with Session(root, display, folder / "blender_3.log") as session:
        return table.run(suite, scenario_states.STEPS, Stage(session, folder))


def console(folder: Path) -> list[str]:
    """Lines in which Blender, or Python in it, complained."""
    lines = [line for log in sorted(folder.glob("blender_*.log")) for line in log.read_text().splitlines()]
    return [line for line in lines if WORRIES.search(line) and not HARMLESS.search(line)]


def main() -> int:
    """Run the suites and say how it went."""
    parser = argparse.ArgumentParser(prog="python -m tests.real_blender", description=__doc__)
    parser.add_argument("--suites", default=",".join(SUITES), help="Debian suites, separated by commas or spaces")
    parser.add_argument("--seconds", type=int, default=0, help="stop after so long; 0: never")
    arguments = parser.parse_args()

    def stop(*_ignored: object) -> None:
        raise OutOfTime

    signal.signal(signal.SIGALRM, stop)
    # Leave through the with statements, so that no Blender and no X server stays behind.
    signal.signal(signal.SIGTERM, lambda *_ignored: sys.exit(128 + signal.SIGTERM))
    signal.alarm(arguments.seconds)
    table = Table()
    try:
        for suite in arguments.suites.replace(",", " ").split():
            run_suite(suite, table)
    except OutOfTime:
        table.add(arguments.suites, "the rest", "skipped", time.monotonic(), f"{arguments.seconds} s are over")
    counts = {verdict: sum(row.verdict == verdict for row in table.rows) for verdict in ("ok", "FAILED", "skipped")}
    print(f"real Blender: {counts['ok']} ok, {counts['FAILED']} failed, {counts['skipped']} skipped; pictures in {OUT}")
    return int(table.failed)


if __name__ == "__main__":
    sys.exit(main())
