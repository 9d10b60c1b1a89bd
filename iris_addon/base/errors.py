"""Errors a user can act on, and the exit code each one maps to.

Every message has the form ``what is wrong — how to fix it`` and names the file it is about. It is shown unchanged, as
one line on stderr or in the panel.
"""

from __future__ import annotations

from pathlib import Path


class IrisError(Exception):
    """Base of every error that is shown to the user. Exit code 1."""

    exit_code = 1

    def __init__(self, what: str, fix: str, path: Path | str | None = None) -> None:
        self.what = what if path is None else f"{path}: {what}"
        self.fix = fix
        super().__init__(f"{self.what} — {fix}")


class BadInput(IrisError):
    """A capture, a result or a job file that cannot be used as it is. Exit code 3."""

    exit_code = 3


class SolverEnvironmentMissing(IrisError):
    """The Python at hand lacks a package the solver needs. Exit code 4."""

    exit_code = 4


class Cancelled(IrisError):
    """The user cancelled the work; finished stages stay on disk. Exit code 130."""

    exit_code = 130

    def __init__(self) -> None:
        super().__init__("cancelled", "run again with --resume to go on from the last finished stage")
