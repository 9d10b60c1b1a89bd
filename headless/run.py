"""Entry of the command line, for Python and for Blender:

python headless/run.py COMMAND ...
blender -b --factory-startup --python-exit-code 1 -P headless/run.py -- COMMAND ...
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def arguments(argv: list[str]) -> list[str]:
    """What is meant for us: inside Blender everything after ``--``, otherwise all but the program's name."""
    in_blender = "bpy" in sys.modules
    if in_blender:
        return argv[argv.index("--") + 1 :] if "--" in argv else []
    return argv[1:]


if __name__ == "__main__":
    sys.path[:] = [str(ROOT)] + [entry for entry in sys.path if entry != str(ROOT / "headless")]
    try:
        from headless.cli import main

        sys.exit(main(arguments(sys.argv)))
    except KeyboardInterrupt:  # before or after anything that could say it better
        print("error: cancelled — run again", file=sys.stderr)
        sys.exit(130)
