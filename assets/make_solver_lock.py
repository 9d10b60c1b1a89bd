"""Lock what the solver's environment installs: ``make lock``.

headless/solver_requirements.txt pins what the solver imports. headless/solver_lock.txt, written here, has these and all
that they need in turn, for every platform and Python at once, each with the hashes of its files. The extension installs
the lock, so that an environment made next year has the same packages, and a file that was changed is refused.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HEADLESS = Path(__file__).resolve().parents[1] / "headless"
LOCKS = {
    "solver_requirements.txt": ("solver_lock.txt", []),
    # What the environment can do without: installed one by one, and what they need is in the other lock.
    "optional_requirements.txt": ("optional_lock.txt", ["--no-deps"]),
}
OLDEST_PYTHON = "3.11"
HEADING = "# Made by `make lock` from {}; not to be edited.\n"


def main() -> int:
    """Write the lock; what is locked already stays as long as the requirements allow it."""
    options = ["--universal", "--generate-hashes", "--python-version", OLDEST_PYTHON, "--only-binary", ":all:"]
    plain = ["--no-header", "--no-annotate", "--no-emit-index-url", "--quiet"]
    for given, (name, more) in LOCKS.items():
        lock, heading = HEADLESS / name, HEADING.format(given)
        files = [str(HEADLESS / given), "-o", str(lock)]
        command = [sys.executable, "-m", "uv", "pip", "compile", *options, *plain, *more, *files]
        code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
        if code != 0:
            return code
        lock.write_text(heading + lock.read_text(encoding="utf-8").removeprefix(heading), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
