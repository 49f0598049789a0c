"""Measure what imports cost: `import packit_sim`, and making and stepping an environment.

    .venv/bin/python -m benchmarks.imports --runs 9

Each run is a fresh process, after one that is not counted. Prints seconds (median, and the range)
and the number of modules loaded, all of them and those of PackIt-Sim.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys

CASES = {
    "import packit_sim": "import packit_sim",
    "make the environment": (
        "import gymnasium, packit_sim\n"
        "env = gymnasium.make('PackIt-v0')\n"
        "_, info = env.reset(seed=1)\n"
        "env.step(int(info['action_mask'].argmax()))"
    ),
    "make the environment, imports only": "import packit_sim, packit_sim.game.envs.env",
}

TEMPLATE = """
import sys, time
started = time.perf_counter()
{code}
seconds = time.perf_counter() - started
own = sum(name.partition(".")[0] == "packit_sim" for name in sys.modules)
print(seconds, len(sys.modules), own)
"""


def measure(code: str) -> tuple[float, int, int]:
    """Run code in a fresh process.

    Parameters
    ----------
    code : str
        Python statements.

    Returns
    -------
    tuple[float, int, int]
        Seconds, modules loaded, and modules of PackIt-Sim loaded.
    """
    command = [sys.executable, "-c", TEMPLATE.format(code=code)]
    run = subprocess.run(command, capture_output=True, check=True, text=True)
    seconds, modules, own = run.stdout.split()
    return float(seconds), int(modules), int(own)


def main() -> None:
    """Print one line for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=9, help="fresh processes for each case")
    runs = parser.parse_args().runs
    for name, code in CASES.items():
        found = [measure(code) for _ in range(runs + 1)][1:]
        seconds = [one[0] for one in found]
        print(
            f"{name:36} {statistics.median(seconds):6.2f} s ({min(seconds):.2f} to "
            f"{max(seconds):.2f}), {found[-1][1]} modules, {found[-1][2]} of PackIt-Sim"
        )


if __name__ == "__main__":
    main()
