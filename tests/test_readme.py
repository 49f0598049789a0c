"""The README's code runs unchanged."""

import re
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


LOOP, *EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_the_loop_runs_and_is_short(tmp_path, monkeypatch, capsys) -> None:
    assert len(LOOP.strip().splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    exec(compile(LOOP, "README.md", "exec"), {})
    returns = re.findall(r"return (\d\.\d+), density 0\.\d+", capsys.readouterr().out)
    assert len(returns) == 2
    assert (tmp_path / "packed.png").stat().st_size > 1000


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_examples_run(example, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})


def test_the_targets_files_and_pictures_that_it_names_exist() -> None:
    root = Path(__file__).parent.parent
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    pictures = re.findall(r'<img src="([^"]+)"', README)
    assert pictures
    for path in links + pictures:
        assert (root / path).is_file(), path
    makefile = (root / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^ *make ([\w-]+)", README, flags=re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
