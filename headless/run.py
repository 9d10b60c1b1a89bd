"""Starts the command line where the package is not installed, with Python or inside Blender:

python headless/run.py COMMAND ...
blender -b --factory-startup --python-exit-code 1 -P headless/run.py -- COMMAND ...
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

if __name__ == "__main__":
    sys.path[:] = [str(ROOT)] + [entry for entry in sys.path if entry != str(ROOT / "headless")]
    try:
        from headless.cli import main

        sys.exit(main())
    except KeyboardInterrupt:  # before or after the part of main that reports it
        print("error: cancelled — run again", file=sys.stderr)
        sys.exit(130)
