"""The README's code runs, as it stands there."""

import re
from pathlib import Path

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def test_the_loop_runs_and_is_short(tmp_path, monkeypatch, capsys) -> None:
    (loop,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(loop.strip().splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    exec(compile(loop, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert re.search(r"\d\.\d+", printed)
    assert (tmp_path / "packed.png").stat().st_size > 1000


def test_commands_and_pictures_that_it_names_exist() -> None:
    root = Path(__file__).parent.parent
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", README):
        assert (root / picture).is_file(), picture
    makefile = (root / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^ *make ([\w-]+)", README, flags=re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
