"""The campaigns as they are run for the pages, and the sources of which their results are.

Each campaign begins anew; its results, table and stamp are replaced when it has ended.
A stamp has the commit, and the digests of the folders of code that the campaign measures: those
that git has for them, so that `git rev-parse COMMIT:FOLDER` repeats them.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

from benchmarks import common as tables
from benchmarks.common import write_json
from campaigns.common import PAGES, RESULTS, ROOT
from packit_sim.core.version import __version__

STAMPS = RESULTS / "stamps.json"

_GROUND = tuple(f"packit_sim/{name}" for name in ("core", "geometry", "engine", "libraries"))
_ALL = "packit_sim", "agents"


@dataclass(frozen=True)
class Campaign:
    """A campaign as it is run for its page.

    Attributes
    ----------
    command : str
        What follows `python -m`; the folder of the results is `OUT`.
    measures : tuple of str
        The folders and files of code that its results are of.
    page : str
        Its page in `docs/trust`, without the suffix.
    table : str
        What follows `python -m` to write its table.
    """

    command: str
    measures: tuple[str, ...]
    page: str
    table: str


def _campaign(name: str, options: str = "", page: str = "") -> Campaign:
    module = f"campaigns.{name}"
    return Campaign(f"{module} {options} --out OUT", _ALL, page or name, f"{module} --table")


def _mutants(name: str, group: str, seed: int, *measures: str) -> Campaign:
    """Return the campaign of a group's mutants, drawn from a seed."""
    module = f"campaigns.mutants --of {group}"
    command = f"{module} --seed {seed} --count 400 --out OUT/{name}.json"
    own = (*measures, f"packit_sim/{group}", "tests")
    return Campaign(command, own, "mutants", f"{module} --table")


CAMPAIGNS = {
    "exactness": Campaign(
        "packit_sim selftest --minutes 60 --seed 101 --out OUT/exactness.json",
        (*_GROUND, "packit_sim/box.py", "packit_sim/placement.py", "packit_sim/selftest"),
        "exactness",
        "campaigns.exactness",
    ),
    "packings": _campaign("packings", "--seed 1000 --packings 1000 --work OUT/trials"),
    "options": _campaign("options", page="packings"),
    "fuzzing": _campaign("fuzzing", "--minutes 60 --work OUT/work", "hostile-files"),
    "faults": _campaign("faults"),
    "repeatability": _campaign("repeatability", "--seed 1"),
    "forgeries": _campaign("forgeries", "--forgeries 100000"),
    "requests": _campaign("requests", "--requests 10000"),
    "growth": _campaign("growth"),
    "mutants": _mutants("mutants", "game", 1, *_GROUND, "packit_sim/box.py", "packit_sim/rules.py"),
    "mutants-parts": _mutants("mutants-parts", "parts", 3),
    "soak": _campaign("soak", "--episodes 9000 --seed 1"),
}
"""All campaigns: a night on two cores."""


@dataclass(frozen=True)
class Stamp:
    """The sources that the results of a campaign are of.

    Attributes
    ----------
    command : str
        The command that measured them.
    version : str
        The version of PackIt-Sim.
    commit : str
        The commit, 12 digits.
    day : str
        The day, such as "2026-11-26".
    sources : dict of str to str
        The digests of the folders and files that were measured, 12 digits of those of git.
    results : str
        The digest of the results file.
    """

    command: str
    version: str
    commit: str
    day: str
    sources: dict[str, str]
    results: str

    def line(self, name: str) -> str:
        """Say it for the page, in Markdown."""
        folders = ", ".join(f"`{path}` {digest}" for path, digest in self.sources.items())
        return (
            f"Measured on {self.day} at commit `{self.commit}` (PackIt-Sim {self.version}) by "
            f"`{self.command}`. Digests of the sources: {folders}; of "
            f"`campaigns/results/{name}.json`: {self.results}.\n"
        )


def read_stamps() -> dict[str, Stamp]:
    """Read the stamps of all results."""
    return {name: Stamp(**each) for name, each in json.loads(STAMPS.read_text()).items()}


def changed(name: str, stamp: Stamp) -> list[str]:
    """List the folders and files that a campaign measures and that have changed since."""
    now = _digests(CAMPAIGNS[name].measures, "HEAD")
    return [path for path, digest in now.items() if stamp.sources.get(path) != digest]


def digest(file: Path) -> str:
    """Return the digest of a results file, 12 digits."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12]


def run(names: Sequence[str], work: Path) -> list[str]:
    """Run campaigns one after the other, each into a new folder, and replace the results.

    Returns
    -------
    list of str
        The campaigns that failed; their results, tables and stamps are as before.
    """
    if changes := _git("status", "--porcelain", *_ALL, "campaigns", "tests"):
        sys.exit(f"commit these changes first: results are those of a commit:\n{changes}")
    failed = []
    for name in names:
        campaign, out = CAMPAIGNS[name], work / name
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        commit, sources = _git("rev-parse", "HEAD"), _digests(campaign.measures, "HEAD")
        arguments = [word.replace("OUT", str(out)) for word in campaign.command.split()]
        print(f"{name}: python -m {' '.join(arguments)}", flush=True)
        with (work / f"{name}.log").open("wb") as log:
            ended = subprocess.run(
                [sys.executable, "-m", *arguments], cwd=ROOT, stdout=log, stderr=subprocess.STDOUT
            )
        new = out / f"{name}.json"
        if ended.returncode != 0 or not new.exists():
            failed.append(name)
            print(f"{name}: failed, see {log.name}", flush=True)
            continue
        file = RESULTS / new.name
        shutil.copy(new, file)
        subprocess.run([sys.executable, "-m", *campaign.table.split()], cwd=ROOT, check=True)
        command, day = f"python -m {campaign.command}", date.today().isoformat()
        write_stamp(name, Stamp(command, __version__, commit[:12], day, sources, digest(file)))
    return failed


def write_stamp(name: str, stamp: Stamp) -> None:
    """Write the stamp of a campaign's results into the file of all and into its page."""
    stamps = read_stamps() if STAMPS.exists() else {}
    stamps[name] = stamp
    write_json(STAMPS, {each: asdict(stamps[each]) for each in sorted(stamps)})
    tables.write_into_page(PAGES / f"{CAMPAIGNS[name].page}.md", stamp.line(name), f"{name}-stamp")


def _digests(paths: Sequence[str], commit: str) -> dict[str, str]:
    """Return git's digests of folders and files at a commit."""
    return {path: _git("rev-parse", f"{commit}:{path}")[:12] for path in paths}


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()
