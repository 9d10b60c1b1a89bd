"""A command of this program in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from iris_addon.base.errors import BadInput, Cancelled, IrisError
from iris_addon.base.progress import Progress

RUN = Path(__file__).with_name("run.py")


def run_command(words: Sequence[str], progress: Progress) -> Mapping[str, Any]:
    """Run a command line that takes ``--json``, and pass its progress on; it ends when this process does.

    Returns:
        The data of its outcome.

    Raises:
        IrisError: what the command fails of, or that it died.
    """
    command = [sys.executable, str(RUN), *words, "--json", "--stop-with-stdin"]
    ended: dict[str, Any] = {}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8") as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            for line in process.stdout:
                if not line.startswith('{"type": '):
                    continue  # Blender prints, too
                message = json.loads(line)
                if message["type"] == "progress":
                    progress.update(message["overall"])
                else:
                    ended = message
        finally:
            process.stdin.close()
    if ended.get("type") == "done":
        return ended["result"]
    if not ended:
        raise IrisError(f"{words[0]} died (code {process.returncode})", "run it alone to see what it prints")
    if ended["exit_code"] == Cancelled.exit_code:
        raise Cancelled
    kind = BadInput if ended["exit_code"] == BadInput.exit_code else IrisError
    raise kind(ended["what"], ended["fix"])
