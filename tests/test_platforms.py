"""What Windows and macOS lack: the modules of POSIX can't be imported, and nothing else changes."""

import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import packit_sim

WITHOUT = """
import sys
for name in ("fcntl", "pty", "pwd", "grp", "resource", "termios"):
    sys.modules[name] = None
"""

FILES = """
import os, sys
from pathlib import Path
from packit_sim.core import files, memory, orphans, silence, temporary_folders
folder = Path(sys.argv[1])
with files.replacing(folder / "text.txt") as file:
    file.write(b"new")
assert (folder / "text.txt").read_bytes() == b"new"
files.replace_text(folder / "text.txt", "again")
assert [each.name for each in folder.iterdir()] == ["text.txt"]
with files.claimed(files.lock_path(folder), folder), orphans.without_interrupts():
    pass
memory.limit_memory(2**30)
with silence.quiet():
    print("nothing")
temporary = temporary_folders.TemporaryFolder("packit-test-")
assert temporary.path.is_dir()
temporary.remove()
assert not temporary.path.exists()
print("done")
"""


def run(code: str, *arguments: object) -> str:
    command = [sys.executable, "-c", WITHOUT + code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_files_and_folders_need_no_module_of_posix(tmp_path: Path) -> None:
    assert run(FILES, tmp_path) == "done\n"


@pytest.mark.slow
def test_every_module_can_be_imported_without_those_of_posix() -> None:
    found = pkgutil.walk_packages(packit_sim.__path__, "packit_sim.")
    names = [module.name for module in found if not module.name.endswith("__main__")]
    assert "packit_sim.core.files" in names
    run(f"import importlib\nfor name in {names!r}: importlib.import_module(name)")
