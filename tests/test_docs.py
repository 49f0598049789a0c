"""The documentation is true: its code runs, its commands are valid, its links lead somewhere.

It also quotes the results of the last full `packit reproduce all`.
"""

import json
import re
import runpy
import shlex
import sys
import tomllib
from argparse import ArgumentParser
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.main import get_command

import packit_sim
from packit_sim import Box
from packit_sim.cli.app import app
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import write_packs
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.paper.names import HEURISTIC
from packit_sim.game.paper.reproduction import TABLES
from packit_sim.physics.convex import decomposition, disk_cache
from tests.doc_pages import (
    DOCS,
    GENERATED,
    PAGES,
    ROOT,
    anchors,
    blocks,
    commands,
    expanded,
    name,
    read,
    spans,
    targets,
)
from tests.runs import rollout, run_packit

sys.path.insert(0, str(DOCS / "extensions"))
from command_pages import MARKER, reference

REPRODUCED = DOCS / "reproduced"

SLOW = frozenset({"docs/reference/environment.md", "docs/start/train.md"})
"""Pages whose code takes long: it runs in `make test-all`."""

QUICK = (
    "--version",
    "agents list",
    "datasets list",
    "shapes list",
    "shapes show",
    "shapes stats",
    "verify starter",
)
"""Beginnings of commands that take seconds and need no files: they are run."""

OTHER_TOOLS = (
    "cd",
    "docker",
    "export",
    "git",
    "gunzip",
    "make",
    "packit",
    "pip",
    "python",
    "ray",
    "source",
)
"""Programs that commands of the documentation may call."""

IN_THE_README = {
    **{row.label: ("table1", row.agent) for row in TABLES["table1"].rows},
    "the Heuristic with 4 beams": ("beam", f"{HEURISTIC}+beam=4"),
    "the same with 8 backtracks": ("backtrack", f"{HEURISTIC}+backtrack=8"),
    "the Heuristic in PackIt-Easy": ("easy", HEURISTIC),
}
"""The tables and agents in the README, by their names there."""


@cache
def rows(table: str) -> dict[str, dict]:
    content = json.loads((REPRODUCED / f"{table}.json").read_text())
    assert "150 tasks" in content["what"]
    return {row["agent"]: row for row in content["rows"]}


def cells(document: Path) -> list[list[str]]:
    """The rows of all tables of a document."""
    lines = document.read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if line[:1] == "|"]


def reward(row: dict) -> str:
    return format_estimate(Estimate(**row["ours"]["reward"]), ".3f")


def test_the_readme_quotes_the_last_run() -> None:
    quoted = 0
    for label, ours, *rest in cells(ROOT / "README.md"):
        agent = re.fullmatch(r"`([^`]+/[^`]+/[^`]+)`", label)
        if label in IN_THE_README:
            table, name = IN_THE_README[label]
            row = rows(table)[name]
            assert rest == [f"{row['paper']['reward']:g}"]
        elif agent:
            row = rows("baselines")[agent[1]]
        else:
            continue
        assert ours == reward(row), label
        quoted += 1
    assert quoted == 5


@pytest.mark.parametrize("name", TABLES)
def test_all_agents_that_can_be_played_were(name) -> None:
    assert list(rows(name)) == [row.agent for row in TABLES[name].playable]
    assert (REPRODUCED / f"{name}.png").exists() and (REPRODUCED / f"{name}.md").exists()


def pages_with(kind: str) -> list[Any]:
    """The pages that have blocks of a language."""
    return [
        pytest.param(page, id=name(page), marks=[pytest.mark.slow] if name(page) in SLOW else [])
        for page in PAGES
        if any(blocks(page, kind))
    ]


def few_items(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Settle a few items of a pack, bisected: CoACD and a whole pack would take minutes."""
    write_packs(folder / "few.jsonl", [rollout("a/b/c", 0, 3).pack])
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(folder))
    monkeypatch.setattr(decomposition, "by_coacd", lambda shape, settings: ([], "not asked"))
    monkeypatch.setattr(packit_sim, "dataset_file", lambda name: folder / "few.jsonl")


def few_chromosomes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evolve a tenth of the population."""
    small = partial(EvolutionSettings, population=10, elite=2, lucky=2)
    monkeypatch.setattr(packit_sim, "EvolutionSettings", small)


SHORTENED: dict[str, Callable[[Path, pytest.MonkeyPatch], None]] = {
    "README.md": few_chromosomes,
    "docs/start/first-box.md": few_chromosomes,
    "docs/guides/physics.md": few_items,
}
"""What makes the code of a page shorter, by the page."""


def check_physics(names: dict[str, Any], output: str) -> None:
    assert len(names["settled"].items) == len(names["box"].placed) == 3
    assert Path("settled.png").stat().st_size > 1000


def check_search(names: dict[str, Any], output: str) -> None:
    *lines, outcome = [line.split() for line in output.splitlines()]
    assert outcome == ["filled"]
    assert [int(rollouts) for rollouts, _ in lines] == list(range(1, len(lines) + 1))
    best = [float(reward) for _, reward in lines]
    assert 1 < len(best) <= 20 and best == sorted(best) and 0 < best[0] <= best[-1] <= 1 + 1e-9


def check_readme(names: dict[str, Any], output: str) -> None:
    assert len(re.findall(r"return (\d\.\d+), density 0\.\d+", output)) == 2
    assert Path("packed.png").stat().st_size > 1000


def check_training(names: dict[str, Any], output: str) -> None:
    assert names["model"].num_timesteps == 512
    assert len(names["rollouts"]) == len(names["test"].tasks)
    for file in ("packer.zip", "mine.jsonl", "mine.safetensors"):
        assert Path(file).stat().st_size > 1000, file


def check_extensions(names: dict[str, Any], output: str) -> None:
    assert output.count("flattest-first/aligned/blbf, task ") == 3
    placed = names["env"].unwrapped.episode.box.placed
    assert placed and max(4 * each.location[2] + each.item.cells[2] for each in placed) <= 60
    box = Box()
    for each in names["supported"].unwrapped.episode.box.placed:
        (x, y, z), (a, b, _) = each.start, each.item.cells
        below = box.outer[x : x + a, y : y + b, z - 1] if z else np.ones((a, b))
        assert below[each.item.outer[:, :, 0]].mean() >= 0.6
        box.place(each.item, each.location)
    assert len(box.placed) > 3 and 0 < names["total"] < 1
    assert list(names["library"]) == ["brick", "cube", "plank"]


CHECKED = {
    "README.md": check_readme,
    "docs/guides/agents.md": check_search,
    "docs/guides/physics.md": check_physics,
    "docs/start/extend.md": check_extensions,
    "docs/start/train.md": check_training,
}
"""What must hold after the code of a page, with its names and its output."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [pytest.param(page, id=name(page)) for page in PAGES if any(blocks(page, "python"))]
)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch, capsys) -> None:
    """All blocks in turn, in one namespace and an empty folder."""
    monkeypatch.chdir(tmp_path)
    SHORTENED.get(name(page), lambda *_: None)(tmp_path, monkeypatch)
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page, "python"):
        if block.runs:
            exec(compile("\n" * (block.line - 1) + block.code, name(page), "exec"), names)
    CHECKED.get(name(page), lambda *_: None)(names, capsys.readouterr().out)


def test_the_loop_of_the_readme_is_short() -> None:
    loop = next(blocks(ROOT / "README.md", "python"))
    assert len(loop.code.strip().splitlines()) <= 12


def parse(words: Sequence[str]) -> None:
    """Parse a `packit` command without running it; raises what is wrong with it."""
    command, name, context, rest = get_command(app), "packit", None, list(words)
    try:
        while True:
            context = command.make_context(name, rest, parent=context)
            if not hasattr(command, "resolve_command"):
                break
            name, command, rest = command.resolve_command(
                context, [*context._protected_args, *context.args]
            )
    except typer.Exit as done:
        if done.exit_code:
            raise
        return
    agents = context.params.get("agent") or ()
    for agent in [agents] if isinstance(agents, str) else agents:
        if "@" not in agent:  # then it names a file of weights
            Agent.from_name(agent)


class Parsed(Exception):
    """A command line has been parsed, and its command would run now."""


def parse_of_module(module: str, words: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse a command of a benchmark or a campaign without running it, and format its help."""
    parse_args = ArgumentParser.parse_args

    def parsed(parser: ArgumentParser, *given: Any) -> None:
        assert "--help" in parser.format_help()
        parse_args(parser, *given)
        raise Parsed

    spec = find_spec(module)
    assert spec, module
    is_package = spec.submodule_search_locations is not None
    with monkeypatch.context() as patch:
        patch.setattr(ArgumentParser, "parse_args", parsed)
        patch.setattr(sys, "argv", [module, *words])
        # runpy warns of a module that another test has imported
        patch.delitem(sys.modules, f"{module}.__main__" if is_package else module, raising=False)
        with pytest.raises(Parsed):
            runpy.run_module(module, run_name="__main__")


@pytest.mark.parametrize("page", pages_with("console"))
def test_the_commands_of_a_page_are_valid(page, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mk4.json").write_text('{"options": {}}')  # read while a command line is parsed
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = list(commands(page))
    for line in found:
        for part in re.split(r" (?:&&|\|\|?|;) ", line):
            program, *words = shlex.split(part, comments=True)
            assert program in OTHER_TOOLS, line
            if program == "packit":
                try:
                    parse(words)
                except Exception as error:
                    raise AssertionError(f"{name(page)}: {line}") from error
                if " ".join(words).startswith(QUICK) and "--library" not in words:
                    done = run_packit(*words, cwd=tmp_path)
                    assert done.returncode == 0, done.stderr
            elif program == "make":
                for target in (word for word in words if "=" not in word):
                    assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), line
            elif program == "python" and words[:1] == ["-m"] and words[1] != "venv":
                assert find_spec(words[1]), line
                if words[1].startswith(("benchmarks.", "campaigns.")):
                    parse_of_module(words[1], words[2:], monkeypatch)
            for chosen in re.findall(r"packit-sim\[([\w,]+)\]", line):
                assert set(chosen.split(",")) <= set(extras), line


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_are_in_console_blocks(page) -> None:
    """Otherwise nothing checks them."""
    assert re.findall(r"^ {4}\$? ?packit .*", read(page), flags=re.MULTILINE) == []


def test_the_command_reference_has_every_command_and_its_examples_are_valid() -> None:
    text = reference()
    examples = re.findall(r"^\$ packit (.*)$", text, flags=re.MULTILINE)
    assert len(examples) > 10
    for example in examples:
        parse(shlex.split(example))
    sections = re.findall(r"^### packit (.*)$", text, flags=re.MULTILINE)
    usages = re.findall(r"^\*\*Usage:\*\* `packit (.*?) \[OPTIONS\]", text, flags=re.MULTILINE)
    assert "...." not in text
    assert sections == usages and len(set(sections)) == len(sections) > 20


@pytest.mark.parametrize("page", [page for page in PAGES if page.stem != "CHANGELOG"], ids=name)
def test_commands_in_the_text_exist(page) -> None:
    """`packit evaluate --scores` in a sentence: the command and its options, without a value."""
    for span in spans(page):
        words = span.split()
        if words[0] != "packit":
            continue
        command, rest = get_command(app), words[1:]
        while hasattr(command, "resolve_command") and rest and re.match(r"[a-z]", rest[0]):
            found = command.get_command(typer.Context(command), rest[0])
            assert found is not None, f"{name(page)}: {span}"
            command, rest = found, rest[1:]
        options = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
        for word in rest:
            if word.startswith("-") and word != "--help":
                assert word.split("=")[0] in options, f"{name(page)}: {span}"


@cache
def known_anchors(page: Path) -> set[str]:
    return anchors(expanded(page).replace(MARKER, reference()))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page) -> None:
    for target in targets(page):
        if re.match(r"https?://|mailto:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        where = f"{name(page)}: {target}"
        assert file.is_file() or (file.is_dir() and DOCS not in page.parents), where
        if DOCS in page.parents and file.suffix == ".md":
            assert DOCS in file.parents, f"{where} is not on the site"
        if anchor and file.suffix == ".md":
            assert anchor in known_anchors(file), where


def test_every_picture_is_used() -> None:
    used = {
        (page.parent / target).resolve()
        for page in [*PAGES, *DOCS.glob("reproduced/*.md")]
        for target in targets(page)
    }
    unused = set(DOCS.glob("images/*")) - used
    assert not unused, sorted(map(name, unused))


@pytest.mark.parametrize("front", [ROOT / "README.md", DOCS / "index.md"])
def test_a_front_page_links_the_repository_and_its_issues(front) -> None:
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
    page = front.read_text(encoding="utf-8")
    assert f"]({urls['Repository']})" in page and f"]({urls['Issues']})" in page


def test_the_sidebar_has_at_most_30_pages() -> None:
    tables = [block.code.splitlines() for block in blocks(DOCS / "index.md", "{toctree}")]
    pages = [line for lines in tables for line in lines if line and not line.startswith(":")]
    assert 20 < len(pages) <= 30


def test_every_page_is_in_a_table_of_contents() -> None:
    listed = {
        file.resolve()
        for page in PAGES
        for block in blocks(page, "{toctree}")
        for entry in re.findall(r"^(?:.*<)?([\w/.*-]+)>?$", block.code, flags=re.MULTILINE)
        for file in (
            page.parent.glob(f"{entry}.md") if "*" in entry else [page.parent / f"{entry}.md"]
        )
    }
    generated = {file for file in listed if name(file).startswith(GENERATED)}
    pages = {page for page in PAGES if DOCS in page.parents} - {DOCS / "index.md"}
    assert sorted(map(name, listed - generated)) == sorted(map(name, pages))
