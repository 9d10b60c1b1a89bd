"""Errors a user can act on, and the exit code each one maps to.

Every message has the form ``what is wrong — how to fix it`` and names the file it is about. It is shown unchanged, as
one line on stderr or in the panel, so texts out of files that it quotes lose their line breaks and control characters.
"""

from __future__ import annotations

from pathlib import Path

MAX_QUOTED = 500
"""Characters of a message without the path."""


def one_line(text: str, longest: int | None = None) -> str:
    """``text`` on one line: white space folded, what a terminal would obey or cannot show replaced, the end cut off."""
    folded = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in " ".join(text.split()))
    return folded if longest is None or len(folded) <= longest else f"{folded[: longest - 1]}…"


class IrisError(Exception):
    """Base of every error that is shown to the user. Exit code 1."""

    exit_code = 1

    def __init__(self, what: str, fix: str, path: Path | str | None = None) -> None:
        said = one_line(what, MAX_QUOTED)
        self.what = said if path is None else f"{one_line(str(path))}: {said}"
        self.fix = one_line(fix, MAX_QUOTED)
        super().__init__(f"{self.what} — {self.fix}")


class BadInput(IrisError):
    """A capture, a result or a job file that cannot be used as it is. Exit code 3."""

    exit_code = 3


class SolverEnvironmentMissing(IrisError):
    """The Python at hand lacks a package the solver needs. Exit code 4."""

    exit_code = 4


class Cancelled(IrisError):
    """The user cancelled the work; finished stages stay on disk. Exit code 130."""

    exit_code = 130

    def __init__(self, fix: str = "run again with --resume to go on from the last finished stage") -> None:
        super().__init__("cancelled", fix)
