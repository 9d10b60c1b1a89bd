"""Processes that Blender starts: news, cancelling, crashes, and what a folder tells about them later."""

import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from iris_addon.base.errors import Cancelled, IrisError
from iris_addon.blender.worker import jobs
from iris_addon.blender.worker.jobs import inspect_command, solve_command
from iris_addon.blender.worker.process import CANCEL_SECONDS, Worker

ROOT = Path(__file__).parents[2]
EVENT = {"type": "progress", "stage": "tracing", "fraction": 0.5, "overall": 0.25, "seconds_left": 9.0}
SPEAK = f"print({json.dumps(EVENT)!r}, flush=True)"


@pytest.fixture(autouse=True)
def nothing_left():
    yield
    jobs.stop_all()


def python(code: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(code)]


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def ended(worker: Worker) -> Worker:
    worker.wait()
    worker.close()
    return worker


def alive(pid: int) -> bool:
    """Whether the process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


# ---- worker --------------------------------------------------------------------------------------------------------


def test_a_worker_reports_its_progress_and_its_output(tmp_path):
    done = json.dumps({"type": "done", "result": {"photos": 3}})
    worker = Worker(python(f"print('chatter'); {SPEAK}; print({done!r})"), tmp_path / "deep" / "a.log")
    ended(worker).raise_if_failed()
    assert (worker.stage, worker.fraction, worker.overall, worker.seconds_left) == ("tracing", 0.5, 0.25, 9.0)
    assert not worker.running
    assert set(worker.log) == {"chatter", "tracing"}
    assert set((tmp_path / "deep" / "a.log").read_text().split()) == {"chatter", "tracing"}


def test_a_worker_that_does_not_stop_is_killed():
    deaf = Worker(python(f"import signal, time; signal.signal(2, signal.SIG_IGN); {SPEAK}; time.sleep(60)"))
    until(deaf.poll)
    deaf.interrupt()
    asked = time.monotonic()
    while deaf.running:
        deaf.poll()
        time.sleep(0.01)
    assert time.monotonic() - asked < CANCEL_SECONDS + 5  # on a busy machine; idle it is below a second
    deaf.close()
    with pytest.raises(Cancelled):
        deaf.raise_if_failed()


def test_the_way_a_worker_ended_is_reported():
    with pytest.raises(IrisError, match=r"was killed \(signal 9\), often .* memory"):
        ended(Worker(python("import os, signal; os.kill(os.getpid(), signal.SIGKILL)"))).raise_if_failed()
    with pytest.raises(IrisError, match=r"ended with code 7 \(last words\)"):
        ended(Worker(python("print('last words', flush=True); raise SystemExit(7)"))).raise_if_failed()
    with pytest.raises(IrisError, match="cannot be started"):
        Worker(["/no/such/python"])


def test_the_error_of_a_worker_is_its_own_message():
    error = json.dumps({"type": "error", "what": "no photos", "fix": "add some", "exit_code": 3})
    with pytest.raises(IrisError, match="no photos — add some"):
        ended(Worker(python(f"print({error!r}); raise SystemExit(3)"))).raise_if_failed()


def test_a_worker_does_not_inherit_blender_s_python(monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/blender")
    monkeypatch.setenv("IRIS_PYTHON", "/another")
    worker = ended(Worker(python("import os; print(sorted(n for n in os.environ if 'PYTHON' in n))")))
    worker.raise_if_failed()
    assert worker.log[0] == "['PYTHONUTF8']"


def test_a_python_without_the_solver_s_packages_says_what_it_lacks(tmp_path):
    command = solve_command(sys.executable, tmp_path, tmp_path / "out", "draft")
    command.insert(1, "-S")  # no site-packages
    with pytest.raises(IrisError, match="lacks numpy"):
        ended(Worker(command)).raise_if_failed()


# ---- jobs ----------------------------------------------------------------------------------------------------------


def test_a_job_leaves_a_record_that_another_session_reads(tmp_path):
    heard = []
    job = jobs.start("solve", tmp_path / "out", python(SPEAK), heard.append)
    assert jobs.record("solve", tmp_path / "out").state == "running"
    assert json.loads((tmp_path / "out" / "job-solve.json").read_text())["state"] == "running"
    with pytest.raises(IrisError, match="runs already"):
        jobs.start("solve", tmp_path / "out", python(SPEAK), heard.append)
    until(lambda: jobs.poll() and not job.worker.running)
    assert [record.state for record in heard] == ["done"]
    jobs._ended.clear()
    assert jobs.record("solve", tmp_path / "out").state == "done"
    assert jobs.record("inspect", tmp_path / "out").state == "missing"


def test_a_job_tells_the_folder_it_wrote_and_what_to_look_at_and_no_record_on_disk_does(tmp_path):
    written = {"frames": 3, "folder": "/shots/sh010", "warnings": ["nothing is seen", "it is dark"]}
    done = json.dumps({"type": "done", "result": written})
    out = tmp_path / "out"
    job = jobs.start("plate", out, python(f"print({done!r})"), lambda record: None)
    assert jobs.ended_here("plate", out) == jobs.MISSING
    until(lambda: jobs.poll() and not job.worker.running)
    assert jobs.ended_here("plate", out) == jobs.Record("done", "/shots/sh010", "nothing is seen; it is dark")
    jobs._ended.clear()
    assert jobs.record("plate", out).what == "/shots/sh010"
    assert jobs.ended_here("plate", out) == jobs.MISSING


def test_a_job_whose_end_takes_steps_runs_until_the_last_of_them(tmp_path):
    taken = []

    def end(record):
        for step in range(3):
            taken.append((record.state, step))
            yield step

    job = jobs.start("inspect", tmp_path, python(SPEAK), end)
    until(lambda: (jobs.poll(), bool(taken))[1])
    assert taken == [("done", 0)] and jobs.record("inspect", tmp_path).state == "running"
    assert jobs.running("inspect", tmp_path) is job
    assert not jobs.poll() and not jobs.poll() and len(taken) == 3  # nothing that a panel shows has changed
    assert jobs.poll() and not list(jobs.all_running()) and len(taken) == 3
    assert jobs.record("inspect", tmp_path).state == "done"


@pytest.mark.parametrize("waited", [False, True])
def test_a_job_fails_by_any_step_of_its_end(tmp_path, waited):
    def end(_record):
        yield
        raise IrisError("damaged", "mend it")

    job = jobs.start("inspect", tmp_path, python(SPEAK), end)
    if waited:
        jobs.wait(job)
    else:
        until(lambda: (jobs.poll(), not list(jobs.all_running()))[1])
    assert jobs.record("inspect", tmp_path) == jobs.Record("failed", "damaged", "mend it")


def test_a_record_of_a_blender_that_was_killed_says_so(tmp_path):
    (tmp_path / "job-solve.json").write_text(json.dumps({"state": "running", "what": "", "fix": ""}))
    record = jobs.record("solve", tmp_path)
    assert record.state == "interrupted" and "finished stages are kept" in record.fix
    (tmp_path / "job-solve.json").write_text("{")
    assert jobs.record("solve", tmp_path).state == "missing"


def test_a_folder_that_is_deleted_is_missing(tmp_path):
    jobs.wait(jobs.start("solve", tmp_path / "out", python(SPEAK), lambda record: None))
    for path in (tmp_path / "out").iterdir():
        path.unlink()
    (tmp_path / "out").rmdir()
    assert jobs.record("solve", tmp_path / "out").state == "missing"


def test_a_failure_and_a_cancelled_job_are_told_apart(tmp_path):
    error = json.dumps({"type": "error", "what": "broken", "fix": "mend", "exit_code": 3})
    jobs.wait(jobs.start("solve", tmp_path, python(f"print({error!r}); raise SystemExit(3)"), lambda record: None))
    assert jobs.record("solve", tmp_path) == jobs.Record("failed", "broken", "mend")
    job = jobs.start("inspect", tmp_path, python(f"import time; {SPEAK}; time.sleep(60)"), lambda record: None)
    until(job.worker.poll)
    job.worker.interrupt()
    jobs.wait(job)
    assert jobs.record("inspect", tmp_path).state == "cancelled"


def test_a_full_disk_is_named_before_anything_starts(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(IrisError, match=r"No space left on device.*free some disk space"):
        jobs.start("solve", tmp_path, python("import time; time.sleep(60)"), lambda record: None)
    assert not list(jobs.all_running())
    (tmp_path / "file").write_text("")
    with pytest.raises(IrisError, match="choose another folder"):
        jobs.start("solve", tmp_path / "file" / "out", python(SPEAK), lambda record: None)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks processes up in /proc")
def test_no_process_outlives_the_program_that_started_it(tmp_path):
    """Killed without a chance to tidy up; the real command line, stopped by its stdin that closes."""
    busy = f"""
        import sys, time
        sys.path.insert(0, {str(ROOT)!r})
        from headless.cancellation import stop_with_stdin
        from iris_addon.base.progress import Progress
        progress = Progress()
        stop_with_stdin(progress)
        {SPEAK}
        while True:
            progress.check()
            time.sleep(0.05)
    """
    blender = f"""
        import sys, time
        sys.path.insert(0, {str(ROOT)!r})
        from iris_addon.blender.worker import jobs
        from pathlib import Path
        command = [sys.executable, "-c", {textwrap.dedent(busy)!r}]
        job = jobs.start("solve", Path({str(tmp_path)!r}), command, print)
        while not job.worker.poll():
            time.sleep(0.02)
        print(job.worker.pid, flush=True)
        time.sleep(60)
    """
    parent = subprocess.Popen(python(blender), stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert alive(pid)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    until(lambda: not alive(pid))
    assert jobs.record("solve", tmp_path).state == "interrupted"


def test_commands_stop_with_their_caller_and_write_nothing_into_the_extension():
    for command in (inspect_command("py", Path("c"), Path("o")), solve_command("py", Path("c"), Path("o"), "draft")):
        assert command[:2] == ["py", "-B"] and {"--json", "--stop-with-stdin"} <= set(command)
