"""What reaches the terminal: no commands in names from files, and one line after Ctrl-C."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from packit_sim.cli import app, library_import
from packit_sim.core.silence import quiet_threads
from packit_sim.game.datasets import dataset_checks
from tests.runs import results, run_packit

EVIL = "random\x1b]0;owned\x07/\x1b[31maligned\x9b2J/blbf\u202e"
"""An agent's name that would rename the terminal's window, colour and clear it."""


def test_no_control_characters_of_names_reach_the_terminal(tmp_path: Path) -> None:
    file = results(tmp_path / "played.jsonl", {EVIL: [2, 3], "other": [3, 2]})
    done = run_packit("compare", file)
    assert done.returncode == 0 and "owned" in done.stdout
    assert not set("\x1b\x07\x9b\u202e") & set(done.stdout)
    done = run_packit("compare", tmp_path / "\x1b[31mmissing.jsonl")
    assert done.returncode == 2 and "missing" in done.stderr and "\x1b" not in done.stderr


@pytest.mark.parametrize(
    ("module", "name", "command"),
    [
        (dataset_checks, "verify_dataset", ["verify", "starter"]),
        (library_import, "import_library", ["shapes", "import", "MESHES", "--out", "OUT"]),
    ],
)
def test_commands_end_on_ctrl_c_with_one_line(
    module: object,
    name: str,
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, name, interrupted)
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "cube.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    places = {"MESHES": str(meshes), "OUT": str(tmp_path / "library")}
    done = run_packit(*(places.get(word, word) for word in command))
    assert done.returncode == 130
    assert done.stdout.splitlines()[-1].startswith("stopped: ") and not done.stderr
    assert "Traceback" not in done.stdout


def test_too_little_memory_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(**settings: object) -> None:
        raise MemoryError("1 GB")

    monkeypatch.setattr(app, "app", fail)
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "error: the memory is not enough: 1 GB\n"


def test_only_the_expected_error_of_a_thread_is_not_printed(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(threading, "excepthook", threading.__excepthook__)

    def fail(error: Exception) -> None:
        raise error

    with quiet_threads(OSError):
        for error in (OSError("disk full"), ValueError("a defect")):
            thread = threading.Thread(target=fail, args=(error,))
            thread.start()
            thread.join()
    assert threading.excepthook is threading.__excepthook__
    shown = capfd.readouterr().err
    assert "a defect" in shown and "disk full" not in shown


def test_a_thread_may_end_after_its_owner_with_the_same_error(
    capfd: pytest.CaptureFixture[str],
) -> None:
    def fail() -> None:
        time.sleep(0.1)
        raise OSError("disk full")

    @quiet_threads(OSError)
    def owner() -> None:
        threading.Thread(target=fail).start()
        raise OSError("disk full")

    with pytest.raises(OSError, match="full"):
        owner()
    assert capfd.readouterr().err == ""
