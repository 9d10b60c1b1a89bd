"""The solver as a process of its own, seen from Blender: start, messages, stop. Does not use bpy.

The worker writes newline-delimited JSON on stdout (:func:`iris_addon.base.progress.json_lines`) and its errors on
stderr; threads move both into queues, so that :meth:`Worker.poll` never blocks. Its stdin is a pipe that nobody writes
to: it closes when this process ends, for whatever reason, and a worker started with ``--stop-with-stdin`` stops then.
Its current folder is the add-on's: Blender's may be the folder of a file from an untrusted source, and Windows and some
libraries search the current folder for programs and modules.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from ...base.errors import Cancelled, IrisError

ADDON = Path(__file__).resolve().parents[3]
CANCEL_SECONDS = 0.8
"""Maximum cancellation latency, seconds: then the worker is killed, which its atomic checkpoints survive."""
CANCELLED_CODE = 130
LOG_LINES = 500
MESSAGES_PER_POLL = 200


class Worker:
    """A running command.

    Attributes:
        stage, fraction, overall, seconds_left: the latest progress (see
            :class:`iris_addon.base.progress.ProgressEvent`).
        found: what it said in a line when it was done, or the folder it wrote; "" without either.
        warning: what to look at although it is done; "" where all is well.
        log: the last lines of its output, stages included.

    Args:
        command: program and arguments, paths absolute.
        log_file: file that receives all of its output; None for none.

    Raises:
        IrisError: the program cannot be started, or ``log_file`` cannot be written.
    """

    def __init__(self, command: Sequence[str], log_file: Path | None = None) -> None:
        self.stage, self.fraction, self.overall = "", 0.0, 0.0
        self.seconds_left: float | None = None
        self.found = self.warning = ""
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self._error: IrisError | None = None
        self._kill_at = float("inf")
        self._cancelled = False
        self._messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._log_file = _open_log(log_file)
        self._log_lock = threading.Lock()
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                env=worker_environment(),
                cwd=ADDON,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )
        except OSError as error:
            self._close_log()
            what = f"{command[0]}: the solver cannot be started ({error.strerror})"
            raise IrisError(what, "set the solver's Python in the preferences") from error
        self._threads = [
            threading.Thread(target=self._read_messages, args=(self._process.stdout,), daemon=True),
            threading.Thread(target=self._read_errors, args=(self._process.stderr,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether the process is alive or has messages that were not polled."""
        alive = self._process.poll() is None or any(thread.is_alive() for thread in self._threads)
        return alive or not self._messages.empty()

    @property
    def stopping(self) -> bool:
        """Whether it was asked to stop."""
        return self._cancelled

    def poll(self) -> bool:
        """Handle pending messages; returns whether there were any. Never blocks; kills a process that does not stop."""
        if time.monotonic() > self._kill_at and self._process.poll() is None:
            self._process.kill()
        for handled in range(MESSAGES_PER_POLL):
            try:
                self._handle(self._messages.get_nowait())
            except queue.Empty:
                return handled > 0
        return True

    def wait(self) -> None:
        """Block until the process has ended and all of its messages are handled."""
        while self.running:
            self.poll()
            time.sleep(0.02)

    def interrupt(self) -> None:
        """Ask the process to stop at its next checkpoint, like Ctrl-C; :meth:`poll` kills it after CANCEL_SECONDS."""
        if self._process.poll() is None and not self._cancelled:
            self._cancelled = True
            self._kill_at = time.monotonic() + CANCEL_SECONDS
            self._process.send_signal(signal.CTRL_BREAK_EVENT if sys.platform == "win32" else signal.SIGINT)

    def close(self) -> None:
        """Make sure that the process has ended: interrupt it, and kill it if it does not stop."""
        self.interrupt()
        try:
            self._process.wait(CANCEL_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join(CANCEL_SECONDS)
        self.poll()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._close_log()

    def raise_if_failed(self) -> None:
        """Raise what the ended process failed with.

        Raises:
            Cancelled: it was interrupted.
            IrisError: anything else, with the message of the process where it gave one.
        """
        code = self._process.returncode
        if code == 0:
            return
        if self._cancelled or code in (CANCELLED_CODE, -signal.SIGINT):
            raise Cancelled
        if self._error is not None:
            raise self._error
        said = next((line for line in reversed(self.log) if line.startswith("error: ")), None)
        if said is not None:
            what, _, fix = said.removeprefix("error: ").partition(" — ")
            raise IrisError(what, fix or "see the log")
        how = _describe_exit(code)
        last = self.log[-1] if self.log else "no message"
        raise IrisError(f"the solver {how} ({last})", "solve again: it goes on from the last finished stage")

    # ---- messages --------------------------------------------------------------------------------------------------

    def _handle(self, message: dict[str, Any]) -> None:
        kind = message.get("type")
        if kind == "progress":
            if message["stage"] != self.stage or message.get("message"):
                self._say(f"{message['stage']} {message.get('message', '')}".rstrip())
            self.stage, self.fraction = message["stage"], message["fraction"]
            self.overall, self.seconds_left = message["overall"], message["seconds_left"]
        elif kind == "error":
            self._error = IrisError(str(message.get("what")), str(message.get("fix")))
        elif kind == "done" and isinstance(message.get("result"), dict):
            result = message["result"]
            self.found = str(result.get("found") or result.get("folder") or "")
            warnings = result.get("warnings")
            self.warning = "; ".join(map(str, warnings)) if isinstance(warnings, list) else ""

    def _read_messages(self, pipe: IO[str]) -> None:
        for line in pipe:
            try:
                message = json.loads(line)
            except ValueError:
                self._say(line.rstrip())  # a library that prints: kept for the log, no message of ours
                continue
            if isinstance(message, dict):
                self._messages.put(message)

    def _read_errors(self, pipe: IO[str]) -> None:
        for line in pipe:
            self._say(line.rstrip())

    def _say(self, line: str) -> None:
        self.log.append(line)
        with self._log_lock:
            if self._log_file is None:
                return
            try:
                self._log_file.write(line + "\n")
                self._log_file.flush()
            except OSError as error:  # a full disk must not end the solve for the sake of its log
                self.log.append(f"the log file ends here ({error.strerror})")
                self._log_file = None

    def _close_log(self) -> None:
        with self._log_lock:
            if self._log_file is not None:
                self._log_file.close()
                self._log_file = None


def worker_environment() -> dict[str, str]:
    """The environment of this process without the variables of Blender's Python.

    PYTHONHOME and PYTHONPATH would make another Python load Blender's library; IRIS_PYTHON would delegate the work to a
    third program, which could not be stopped.
    """
    kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON") and k != "IRIS_PYTHON"}
    return {**kept, "PYTHONUTF8": "1"}


def _open_log(path: Path | None) -> IO[str] | None:
    """A new file. What had its name in a folder from an untrusted source may be a link, a second name of any file, or a
    pipe that blocks whoever opens it: it is removed and never opened."""
    if path is None:
        return None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        return path.open("x", encoding="utf-8")
    except OSError as error:
        fix = "free some disk space, or choose another folder for the result"
        raise IrisError(f"cannot be written ({error.strerror})", fix, path) from error


def _describe_exit(code: int) -> str:
    if code == -9:
        return "was killed (signal 9), often by the system because memory ran out"
    return f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
