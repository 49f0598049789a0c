"""Compare ways to generate hard tasks: densities, and what searches reach on the packs.

    .venv/bin/python -m benchmarks.densification    (an hour on one core; a stopped run resumes)

Each pack is generated from validation shapes, and its task is then played by the strongest searches
for a minute of processor time each. Packs of `everyday-v1` are there for comparison. Finished
packs are kept in `benchmarks/results/densification.json`, and a table is printed.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import Agent, Pack, ShapeLibrary, dataset_file, play, verify
from packit_sim.core.confidence import Estimate
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.pack_files import read_packs
from packit_sim.game.generation.densification import Densification

V1 = "everyday-v1"

ALIKE = {"items": (20, 20), "floor": 0.035, "largest": 0.045}
"""Settings of packs whose items are about equally large."""

KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "28 items, floor 2%": {"items": (28, 28), "floor": 0.02},
    "alike": ALIKE,
    "alike, tolerance 0.01": {**ALIKE, "tolerance": 0.01},
    "hollow": {**ALIKE, "floor": 0.03, "fill": 0.5},
    "alike, 180 rounds": {**ALIKE, "rounds": 180},
}
"""Settings that differ from the default, by the name of the way."""

AGENTS = (
    "largest-fitting-first/lowest/maximal-contact+lns={}s",
    "largest-fitting-first/lowest/blbf+lns={}s",
)


def generated(library: ShapeLibrary, kind: str, seed: int) -> tuple[Pack, dict[str, Any]]:
    """Generate a pack; also return the processor time and the density after each round."""
    started = time.process_time()
    densification = Densification(library, seed, DensificationSettings(**KINDS[kind]))
    while not densification.is_over:
        densification.step()
    seconds = time.process_time() - started
    densities = [round(density, 4) for density in densification.densities]
    return densification.best, {"seconds": seconds, "densities": densities}


def measured(pack: Pack, library: ShapeLibrary, seconds: float) -> dict[str, Any]:
    """Measure a pack, which must be valid, and the returns of the searches on its task."""
    problems = verify(pack, library)
    if problems:
        raise SystemExit(f"a pack is not valid: {problems[0]}")
    volumes = [placed.item.volume for placed in pack.placed(library)]
    returns = {}
    for name in AGENTS:
        agent = Agent.from_name(name.format(f"{seconds:g}"))
        returns[agent.name] = play(pack.task(library), agent, np.random.default_rng(0)).total
    return {
        "density": pack.density,
        "items": len(volumes),
        "smallest": min(volumes) / sum(volumes),
        "shapes": len({item.shape for item in pack.items}),
        "returns": returns,
    }


def show(console: Console, runs: Mapping[str, Mapping[str, Any]]) -> None:
    """Print the means of each way."""
    agents = list(
        dict.fromkeys(a for rows in runs.values() for r in rows.values() for a in r["returns"])
    )
    table = Table("packs", "n", "items", "density", "smallest share", "core-minutes", *agents)
    for kind, found in runs.items():
        rows = list(found.values())
        if not rows:
            continue
        cells = [
            f"{np.mean([r['items'] for r in rows]):.1f}",
            _interval([r["density"] for r in rows]),
            f"{min(r['smallest'] for r in rows):.4f}",
            f"{np.mean([r.get('seconds', 0) for r in rows]) / 60:.1f}" if kind != V1 else "",
        ]
        for agent in agents:
            totals = np.array([r["returns"][agent] for r in rows])
            complete = 100 * float((totals >= 1 - 1e-9).mean())
            cells.append(f"{_interval(totals.tolist())}, {complete:.0f}% complete")
        table.add_row(kind, str(len(rows)), *cells)
    console.print(table)


def _interval(values: list[float]) -> str:
    found = Estimate.of(np.array(values))
    if found.low is None or found.high is None:
        return f"{found.mean:.3f}"
    return f"{found.mean:.3f} ({found.low:.3f} to {found.high:.3f})"


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--packs", type=int, default=4, help="packs of each way, from seed 0 on")
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time of a search")
    parser.add_argument("--kinds", nargs="*", default=[V1, *KINDS], help="what to compare")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday").split("validation")
    file: Path = arguments.out / "densification.json"
    result = json.loads(file.read_text()) if file.exists() else {"runs": {}}
    runs = result["runs"]
    v1 = read_packs(dataset_file(V1, "validation"))
    for number in range(arguments.packs):
        for kind in arguments.kinds:
            rows = runs.setdefault(kind, {})
            if str(number) in rows:
                continue
            pack, facts = (v1[number], {}) if kind == V1 else generated(library, kind, number)
            rows[str(number)] = {**measured(pack, library, arguments.seconds), **facts}
            print(f"{kind}, pack {number}: {rows[str(number)]}", flush=True)
            write_json(
                file,
                {
                    "command": "python -m benchmarks.densification",
                    "library": {"name": library.name, "digest": library.digest},
                    "split": "validation",
                    "kinds": KINDS,
                    "seconds": arguments.seconds,
                    "machine": machine(),
                    "runs": runs,
                },
            )
    show(Console(width=160), runs)


if __name__ == "__main__":
    main()
