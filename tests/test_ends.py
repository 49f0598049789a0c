"""Ctrl-C, SIGTERM and SIGHUP end a command with one line at every moment."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from packit_sim.cli.local_pages import serve_until_interrupt
from packit_sim.core import temporary_folders
from packit_sim.core.signals import as_interrupts

STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}

AT_IMPORT = """
import os, runpy, sys
number, left = int(sys.argv.pop(1)), int(sys.argv.pop(1))
def hook(event, arguments):
    global left
    if event == "import" and "packit_sim.core.signals" in sys.modules:
        left -= 1
        if left == 0:
            os.kill(os.getpid(), number)
sys.addaudithook(hook)
runpy.run_module("packit_sim", run_name="__main__", alter_sys=True)
"""
"""Runs `packit` and gets a signal at an import, counted from the first line of `main`."""

AT_FIRST_IMPORT = """
import os, signal, sys
def hook(event, arguments):
    if event == "import" and arguments[0] == "packit_sim":
        os.kill(os.getpid(), signal.SIGINT)
from packit_command import main
sys.addaudithook(hook)
main()
"""
"""Runs `packit` as its script does, and gets Ctrl-C when it imports the first of its packages."""

TEMPORARY = """
import os, tempfile
from packit_sim.core.temporary_folders import TemporaryFolder
folder = TemporaryFolder("packit-test-")
print(folder.path, flush=True)
input()
"""


def ended(command: list[str], **options: object) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=120, **options
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("number", "at"), [(signal.SIGINT, 5), (signal.SIGTERM, 50), (signal.SIGHUP, 90)]
)
def test_a_signal_during_the_start_ends_it_with_one_line(number, at) -> None:
    found = ended(["-c", AT_IMPORT, str(int(number)), str(at), "--version"])
    assert found == (STATUS[number], "stopped\n", "")


def test_ctrl_c_before_any_import_ends_the_command_without_a_traceback() -> None:
    assert ended(["-c", AT_FIRST_IMPORT]) == (-signal.SIGINT, "", "")


@pytest.mark.parametrize(("number", "at"), [(signal.SIGINT, 600), (signal.SIGTERM, 900)])
def test_a_signal_during_an_import_of_a_command_ends_it_with_one_line(number, at) -> None:
    found = ended(["-c", AT_IMPORT, str(int(number)), str(at), "datasets", "list"])
    assert found == (STATUS[number], "stopped: the command is not finished\n", "")


@pytest.mark.slow
def test_a_signal_at_any_import_ends_the_start_with_one_line() -> None:
    rng = random.Random(0)
    for _ in range(40):
        number, at = rng.choice(list(STATUS)), rng.randrange(1, 2500)
        command = rng.choice([["--version"], ["pack", "--help"], ["doctor"]])
        code, out, err = ended(["-c", AT_IMPORT, str(int(number)), str(at), *command])
        if code == 0:  # it has fewer imports
            continue
        assert (code, err) == (STATUS[number], ""), (number, at, command)
        assert out.splitlines()[-1].startswith("stopped"), (number, at, command)


@pytest.mark.slow
def test_a_signal_at_any_time_ends_the_start_without_a_traceback_of_ours() -> None:
    rng = random.Random(1)
    for _ in range(30):
        number = rng.choice(list(STATUS))
        process = subprocess.Popen(
            [sys.executable, "-m", "packit_sim", "verify", "starter"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        time.sleep(rng.uniform(0.25, 6))
        process.send_signal(number)
        out, err = process.communicate(timeout=120)
        assert "Traceback" not in err and (process.returncode in (0, STATUS[number])), (number, err)
        assert process.returncode == 0 or out.splitlines()[-1].startswith("stopped")


@pytest.mark.slow
@pytest.mark.parametrize("number", STATUS)
def test_the_workbench_leaves_no_folder(number, tmp_path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "packit_sim", "workbench", "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(tmp_path), "COLUMNS": "400"},
    )
    assert process.stdout is not None
    assert "is shown at" in process.stdout.readline()
    assert list(tmp_path.glob("packit-workbench-*"))
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    code = 0 if number == signal.SIGINT else STATUS[number]
    assert (process.returncode, err, list(tmp_path.iterdir())) == (code, "", [])
    assert out.endswith("the workbench is closed\n")


def test_other_signals_do_what_ctrl_c_does() -> None:
    before = [signal.getsignal(number) for number in STATUS]
    for number in (signal.SIGTERM, signal.SIGHUP):
        with pytest.raises(KeyboardInterrupt), as_interrupts() as arrived:
            signal.raise_signal(number)
        assert arrived == [number]
    noted: list[int] = []
    with as_interrupts() as arrived:
        signal.signal(signal.SIGINT, lambda number, frame: noted.append(number))
        signal.raise_signal(signal.SIGTERM)
    assert noted == arrived == [signal.SIGTERM]
    assert [signal.getsignal(number) for number in STATUS] == before


class Interrupted:
    """An object whose end is interrupted: Python prints and ignores what a finalizer raises."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def test_ctrl_c_in_a_finalizer_is_not_lost(capsys) -> None:
    before = sys.unraisablehook

    def work() -> None:
        Interrupted()
        time.sleep(30)
        pytest.fail("it was not interrupted")

    with as_interrupts(), pytest.raises(KeyboardInterrupt):
        work()
    assert capsys.readouterr().err == "" and sys.unraisablehook is before


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with as_interrupts() as arrived:
            signal.raise_signal(signal.SIGHUP)
        assert arrived == []
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_forked_child_ends_by_the_signal_itself() -> None:
    with as_interrupts():
        child = os.fork()
        if child == 0:
            signal.raise_signal(signal.SIGTERM)
            os._exit(0)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGTERM


def within_c_code(cause: BaseException) -> SystemError:
    """The error of numba if Python code that it calls raises anything."""
    error = SystemError("returned a result with an exception set")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    "error",
    [
        KeyboardInterrupt(),
        within_c_code(KeyboardInterrupt()),
        within_c_code(within_c_code(KeyboardInterrupt())),
    ],
)
def test_ctrl_c_outside_of_a_command_is_one_line(error, monkeypatch, capsys) -> None:
    from packit_sim.cli import app

    def interrupted(**options: object) -> None:
        raise error

    monkeypatch.setattr(app, "end_at_once", lambda: None)
    monkeypatch.setattr(app, "app", interrupted)
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == 130 and capsys.readouterr() == ("stopped\n", "")


def test_ctrl_c_while_the_command_line_is_read_is_one_line(monkeypatch, capsys) -> None:
    from packit_sim.cli import app

    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app.Group, "make_context", interrupted)
    with pytest.raises(SystemExit) as end:
        app.main()
    out, err = capsys.readouterr()
    assert (end.value.code, out, err) == (130, "stopped: nothing is begun\n", "")


def test_an_error_within_c_code_is_not_taken_for_ctrl_c(monkeypatch) -> None:
    from packit_sim.cli import app

    def broken(**options: object) -> None:
        raise within_c_code(ValueError())

    monkeypatch.setattr(app, "app", broken)
    with pytest.raises(SystemError):
        app.main()


def test_a_temporary_folder_ends_with_its_process_or_with_the_next_one(tmp_path) -> None:
    def started() -> subprocess.Popen[str]:
        return processes.enter_context(
            subprocess.Popen(
                [sys.executable, "-c", TEMPORARY],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=os.environ | {"TMPDIR": str(tmp_path)},
            )
        )

    def folder(process: subprocess.Popen[str]) -> Path:
        assert process.stdout is not None
        return Path(process.stdout.readline().strip())

    with contextlib.ExitStack() as processes:
        killed, living = started(), started()
        left, kept = folder(killed), folder(living)
        killed.kill()
        killed.communicate()
        assert left.exists() and kept.exists()
        last = started()
        assert folder(last).exists() and not left.exists() and kept.exists()
        living.communicate("\n")
        last.communicate("\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("when", ["before it is opened", "before it is locked"])
def test_a_new_folder_that_another_process_removes_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    removed: list[str] = []

    def remove_the_first(folder: str | Path) -> None:
        if not removed:
            removed.append(str(folder))
            os.rmdir(folder)

    def made(prefix: str, dir: Path, mkdtemp=tempfile.mkdtemp) -> str:
        folder = mkdtemp(prefix=prefix, dir=dir)
        if when == "before it is opened":
            remove_the_first(folder)
        return folder

    def locked(descriptor: int, wait: bool = True, lock=temporary_folders.lock) -> None:
        if when == "before it is locked":
            remove_the_first(os.readlink(f"/proc/self/fd/{descriptor}"))
        lock(descriptor, wait=wait)

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(tempfile, "mkdtemp", made)
    monkeypatch.setattr(temporary_folders, "lock", locked)
    before = len(os.listdir("/proc/self/fd"))
    folder = temporary_folders.TemporaryFolder("packit-test-")
    assert list(tmp_path.iterdir()) == [folder.path]
    assert removed and removed[0] != str(folder.path)
    folder.remove()
    assert len(os.listdir("/proc/self/fd")) == before


def test_the_first_module_of_a_command_imports_little() -> None:
    heavy = "{'numpy', 'typer', 'trimesh', 'gymnasium'} & sys.modules.keys()"
    code = f"import sys, packit_sim.__main__; assert not {heavy}, {heavy}"
    assert ended(["-c", code]) == (0, "", "")


def test_two_signals_at_once_end_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    def second(*_: object) -> None:
        raise KeyboardInterrupt

    threading.Thread(target=_interrupt, daemon=True).start()
    monkeypatch.setattr(threading.Condition, "_acquire_restore", second)
    serve_until_interrupt("the page", "http://127.0.0.1:1", "127.0.0.1", False)


def _interrupt() -> None:
    time.sleep(0.3)
    os.kill(os.getpid(), signal.SIGINT)
