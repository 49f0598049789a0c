"""What Windows and macOS lack or do differently: modules of POSIX, paths, processes, text files."""

import ntpath
import pkgutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from trimesh import creation

import packit_sim
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.task import PackSettings
from packit_sim.parts.reading import box_lists, boxes, files
from packit_sim.parts.reading.boxes import MeshBox
from packit_sim.parts.reading.named_containers import named_containers

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


LONG = 200 * "long"


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


@pytest.fixture(name="_windows")
def _paths_of_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (boxes, box_lists):
        monkeypatch.setattr(module, "os", SimpleNamespace(path=ntpath, sep="\\"))


@pytest.mark.usefixtures("_windows")
@pytest.mark.parametrize(
    ("text", "file", "name", "count"),
    [
        (r"C:\my parts\trunk.stl", r"C:\my parts\trunk.stl", None, None),
        (r"C:\my parts\trunk.stl=2", r"C:\my parts\trunk.stl", None, 2),
        ("C:/parts/trunk.stl=2", "C:/parts/trunk.stl", "trunk", 2),
        (r"\\server\parts\trunk.stl=2", r"\\server\parts\trunk.stl", None, 2),
        (r"A:C:\parts\trunk.stl=2", r"C:\parts\trunk.stl", "A", 2),
        ("A:trunk.stl", "trunk.stl", "A", None),
        (f"C:/{LONG}.stl=2", f"C:/{LONG}.stl", LONG, 2),
    ],
)
def test_a_drive_is_not_the_name_of_a_container(text, file, name, count) -> None:
    box = MeshBox.parse(text)
    assert box is not None
    assert (str(box.mesh), box.count) == (file, count)
    assert box.name == (name or Path(file).stem)


@pytest.mark.parametrize("drive", [r"C:\my parts", r"\\server\parts", "C:/parts"])
def test_the_count_of_a_file_may_follow_a_drive(drive, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)  # on POSIX the whole is one name, or a folder with a colon
    Path(drive).mkdir(parents=True, exist_ok=True)
    path = f"{drive}/part.stl"
    creation.box((1, 2, 3)).export(path)
    (part,) = files.find_parts([f"{path}=4"]).parts
    assert (part.name, part.count, str(part.file)) == ("part", 4, path)


@pytest.mark.usefixtures("_windows")
def test_a_list_of_boxes_may_have_a_path_with_a_drive(tmp_path) -> None:
    table = tmp_path / "boxes.csv"
    table.write_bytes("\ufeffbox,name\r\nC:/parts/trunk.stl,A\r\n".encode())
    assert box_lists.without_lists(str(table))[0] == [f"A:{tmp_path}/C:/parts/trunk.stl"]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_text_files_may_have_marks_and_line_ends_of_windows(
    end, mark, tmp_path, monkeypatch
) -> None:
    def write(name: str, *lines: str) -> Path:
        path = tmp_path / name
        path.write_bytes((mark + "".join(line + end for line in lines)).encode())
        return path

    creation.box((1, 2, 3)).export(tmp_path / "part.stl")
    table = write("parts.csv", "file,count", "part.stl,4")
    plain = write("parts.json", "[", '{"file": "part.stl", "count": 4}', "]")
    for source in (table, plain):
        assert files.find_parts([source]).parts[0].count == 4
    box = write("boxes.csv", "box,name", "30x30x30mm,B")
    task = prepared_task([table], str(box), "volume", PackSettings())
    assert [each.name for each in task.boxes] == ["B"]
    monkeypatch.setenv("PACKIT_CONFIG", str(tmp_path))
    write("containers.toml", "[mine]", 'size = "30x30x30mm"')
    assert named_containers()["mine"].size == "30x30x30mm"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_settings_may_have_marks_and_line_ends_of_windows(end, mark, tmp_path) -> None:
    settings = pytest.importorskip("packit_agents.learning.training_settings")
    file = tmp_path / "train.toml"
    file.write_bytes(f"{mark}steps = 512{end}".encode())
    assert settings.read_settings(file, []).steps == 512
