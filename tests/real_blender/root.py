"""A Debian root with a real Blender in it, and programs that run inside."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
SUITES = ("trixie", "sid")
CANNOT = 75


class Unavailable(Exception):
    """This machine cannot run the tests; the text says why."""


def roots_folder() -> Path:
    """Where the roots are kept between runs: IRIS_BLENDER_ROOTS, else the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("IRIS_BLENDER_ROOTS") or cache / "iris-blender-roots")


@dataclass(frozen=True)
class Root:
    """A root folder. Seen from inside, this repository is /srv/iris and ``home`` the home of a user, so that no path of
    this machine gets into a picture; the solver's Python keeps its place, because a virtual environment needs it."""

    path: Path
    home: Path

    REPOSITORY: ClassVar[str] = "/srv/iris"
    HOME: ClassVar[str] = "/home/artist"
    SMALL_DISK: ClassVar[str] = "/home/artist/small_disk"

    def command(self, *arguments: str | Path) -> list[str]:
        """``arguments`` as a command line that runs inside."""
        return [str(HERE / "in_root.sh"), str(self.path), *map(str, arguments)]

    def environment(self, **more: str) -> dict[str, str]:
        """Environment for :meth:`command`: nothing of this user's Python or desktop."""
        places = {REPOSITORY: self.REPOSITORY, self.home: self.HOME, sys.base_prefix: sys.base_prefix}
        solver = REPOSITORY / ".venv"
        if solver.is_symlink():  # shared with another working tree
            places[solver.resolve()] = str(solver.resolve())
        bind = ":".join(f"{folder}={place}" for folder, place in places.items())
        kept = {name: os.environ[name] for name in ("PATH", "LANG", "LC_ALL") if name in os.environ}
        return kept | {"IRIS_BIND": bind, "IRIS_SMALL_DISK": self.SMALL_DISK, "HOME": self.HOME, **more}

    def output(self, *arguments: str | Path) -> str:
        """What a command inside prints.

        Raises:
            AssertionError: it failed; with all it printed.
        """
        run = subprocess.run(
            self.command(*arguments),
            env=self.environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert run.returncode == 0, f"{' '.join(map(str, arguments))}: exit {run.returncode}\n{run.stdout}"
        return run.stdout


def set_up(suite: str, home: Path, log: Path) -> Root:
    """The root of a Debian suite, made where it is not there yet.

    Raises:
        Unavailable: this machine cannot have it.
    """
    path = roots_folder() / f"blender-{suite}"
    with log.open("w") as file:
        command = [str(HERE / "set_up.sh"), suite, str(path)]
        code = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=False).returncode
    said = log.read_text().strip().splitlines()
    if code == CANNOT:
        raise Unavailable(said[-1])
    assert code == 0, f"setting up {suite} failed (exit {code}), the end of {log}:\n" + "\n".join(said[-15:])
    return Root(path, home)
