"""Which tests are run on a mutant, and in which order."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

from campaigns.mutant_runs import Baseline, kernel_modules
from campaigns.mutations import Mutation

_OF_THE_GAME = (
    *("rotations", "voxels", "shapes", "poses", "placement", "containment", "nofit", "insertion"),
    *("off_grid", "witness", "compaction", "disassembly", "caches", "box", "unchanged", "episode"),
    *("packs", "old_format", "original", "verification", "rules", "evaluation", "manifests"),
    *("forged_results", "terminal"),
)
TESTS = tuple(f"tests/test_{name}.py" for name in _OF_THE_GAME)
"""The files of tests that are run on mutants of the game and its ground."""

_OF_PARTS = (
    *("as_many_as_fit", "bad_folders", "balance", "box_lists", "brick_windows"),
    *("builtin_instances", "cells"),
    *("closed_meshes", "compaction", "constraints", "containers", "deliveries", "distances"),
    *("evening", "exact_fits", "films", "fitting", "gltf_files", "groups", "hostile_parts"),
    *("instances", "instructions", "lattices", "layers", "limits", "motions", "named_containers"),
    *("nest", "nest_cli", "nest_conflicts", "nest_estimates", "nest_separation", "nesting_copies"),
    *("nesting_types", "nesting_validity", "number_bounds"),
    *("own_files", "pack", "pack_cli", "pack_limits", "pack_results", "packing_film"),
    *("packing_page", "part_lists", "plates", "platforms", "public_reports", "rebuilding"),
    *("removal", "requests", "resuming", "same_packings", "separability", "settling"),
    *("several_boxes", "stacking", "state_checks", "step_files", "turning", "workbench"),
    *("workbench_orders", "workbench_page"),
)
TESTS_OF_PARTS = tuple(f"tests/test_{name}.py" for name in _OF_PARTS)
"""The files of tests that are run on mutants of what packs parts."""

_OWN = {
    "voxel": ("voxels",),
    "voxelization": ("voxels",),
    "word": ("voxels",),
    "oracle": ("placement", "containment"),
    "feasibility": ("placement", "nofit"),
    "screening": ("placement", "nofit"),
    "collision": ("placement", "containment"),
    "collision_meshes": ("placement", "containment"),
    "occupancy": ("off_grid", "box", "placement"),
    "pack_files": ("packs", "verification"),
    "pack_checks": ("verification",),
    "results": ("evaluation", "forged_results", "manifests"),
    "results_store": ("evaluation", "manifests"),
}
"""Names of test files for modules that have no file of the same name."""

SECONDS = 10.0
"""Processor time of the tests of one mutant, measured without it; the slowest are left out."""


def plan(
    baseline: Baseline,
    copy: Path,
    mutant: tuple[str, Mutation],
    kills: Counter[str],
    most: float = SECONDS,
) -> list[str]:
    """Choose the tests of a mutant, in the order in which they are run.

    Parameters
    ----------
    baseline : Baseline
        What the tests do without a mutant.
    copy : Path
        The copy of the source.
    mutant : tuple
        Module and mutation.
    kills : Counter
        Numbers of mutants of the module that each test killed so far.
    most : float
        Processor time of the tests in seconds; infinite for all of them.

    Returns
    -------
    list of str
        Tests that execute the line; of a line that runs at the import, those that use the module;
        of a compiled line, which is not traced, those that use a module that calls it, or whose
        file does. The first are those that killed most, then those of the module's own files. Tests
        of a file stay together, since they share what they prepare.
    """
    module, mutation = mutant
    name = Path(module).stem.removesuffix("_kernels")
    tests: set[str] = set()
    if module.endswith("_kernels.py"):
        compiled = kernel_modules(copy, module)
        for caller, lines in baseline.lines.items():
            if any(_imports(copy / caller, own) for own in compiled):
                tests |= set(lines[0])
        files = sorted({_file(test) for test in baseline.seconds})
        direct = {file for file in files if any(_imports(copy / file, own) for own in compiled)}
        tests |= {test for test in baseline.seconds if _file(test) in direct}
    else:
        lines = baseline.lines[module]
        for line in range(mutation.line, mutation.end[0] + 1):
            tests |= set(lines.get(line, []))
        tests = tests or set(lines[0])
    own = tuple(f"tests/test_{file}.py" for file in (name, *_OWN.get(name, ())))
    seconds = baseline.seconds
    killers = [test for test, _ in kills.most_common(5) if test in tests]
    chosen = list(_affordable(sorted(tests, key=lambda t: seconds[t]), seconds, most))
    number = {test: n for n, test in enumerate(seconds)}
    of_file: defaultdict[str, float] = defaultdict(float)
    for test in chosen:
        of_file[_file(test)] += seconds[test]
    chosen.sort(key=lambda t: (_file(t) not in own, of_file[_file(t)], _file(t), number[t]))
    return list(dict.fromkeys([*killers, *chosen]))


def _file(test: str) -> str:
    return test.split("::")[0]


def _affordable(tests: Sequence[str], seconds: dict[str, float], left: float) -> Iterator[str]:
    for test in tests:
        left -= seconds[test]
        if left > 0:
            yield test


def _imports(file: Path, module: str) -> bool:
    name = Path(module).stem
    text = file.read_text()
    return f".{name} import " in text or f" import {name}\n" in text
