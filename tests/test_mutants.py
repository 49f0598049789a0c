"""Mutation testing finds what tests miss."""

import ast
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.common import table_in_page
from campaigns import common, mutant_runs, mutants
from campaigns.mutant_plans import plan
from campaigns.mutations import mutations

PLANTED = '''
def clamp(x: int, low: int = 0) -> int:
    """Return at least `low`, and at most 9."""
    while x > 9:
        x -= 1
    if x < low:
        raise ValueError(f"{x + 1} is too small")
    return x
'''

TEST = """
import pytest
from small.planted import clamp

def test_clamp():
    assert clamp(20) == 9
    with pytest.raises(ValueError):
        clamp(-5)
"""

RUN = """
import json, sys
from pathlib import Path
from campaigns import mutant_runs
from campaigns.mutations import mutations
mutant_runs.SLACK = mutant_runs.COMPILATION = 0.3
copy, module = Path(sys.argv[1]), "small/planted.py"
baseline = mutant_runs.measure(copy, [module], ["tests/test_planted.py"])
mutant_runs.import_libraries(baseline.libraries)
found = {}
drawn = mutations((copy / module).read_text())
for mutation in (one for one in drawn if one.code in ("1", "pass", "(x <= low)")):
    text = (copy / module).read_text()
    with mutant_runs.mutated(copy, module, mutation.apply(text)):
        outcome = mutant_runs.run(copy, baseline.lines[module][0], baseline.seconds)
    found[f"{mutation.original(text)} -> {mutation.code}"] = outcome.outcome
print(json.dumps(found))
"""


def test_mutations_change_code_and_no_text() -> None:
    found = [(mutation.original(PLANTED), mutation.code) for mutation in mutations(PLANTED)]
    assert found == [
        ("0", "1"),
        ("x > 9", "(x >= 9)"),
        ("x > 9", "(not x > 9)"),
        ("9", "10"),
        ("x -= 1", "x += 1"),
        ("x -= 1", "pass"),
        ("1", "2"),
        ("x < low", "(x <= low)"),
        ("x < low", "(not x < low)"),
        ('raise ValueError(f"{x + 1} is too small")', "pass"),
        ("return x", "return None"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("module", [m for each in mutants.GROUPS.values() for m in each.modules])
def test_every_mutant_is_another_program(module: str) -> None:
    text = (mutants.ROOT / module).read_text()
    original = ast.dump(ast.parse(text))
    for mutation in mutations(text)[:: 1 + len(text) // 200]:
        assert ast.dump(ast.parse(mutation.apply(text))) != original


@pytest.mark.slow
def test_a_hole_in_the_tests_is_found(tmp_path: Path) -> None:
    """The tests of `clamp` check neither its default nor the value at the limit."""
    for name, text in (("small/planted.py", PLANTED), ("tests/test_planted.py", TEST)):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-c", RUN, str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=mutants.ROOT, check=True)
    found = json.loads(run.stdout)
    assert found == {
        "0 -> 1": "survived",
        "x -= 1 -> pass": "timeout",
        "x < low -> (x <= low)": "survived",
        'raise ValueError(f"{x + 1} is too small") -> pass': "killed",
    }
    assert (tmp_path / "small/planted.py").read_text() == PLANTED


def test_a_mutant_that_no_test_executes_has_survived(tmp_path: Path) -> None:
    assert mutant_runs.run(tmp_path, [], {}) == mutant_runs.Outcome("survived", "", 0)


def test_compiled_callers_of_a_kernel_are_found() -> None:
    """Else the tests of its callers would not be run on its mutants."""
    nesting = "packit_sim/parts/nesting"
    found = mutant_runs.kernel_modules(mutants.ROOT, f"{nesting}/cost_kernels.py")
    callers = ("conflict", "construction", "contact", "pushing", "separation", "settling")
    assert {f"{nesting}/{name}_kernels.py" for name in callers} <= set(found)


def test_tests_that_call_a_kernel_are_run_on_its_mutants() -> None:
    direct, other = "tests/test_nest_conflicts.py::test_a", "tests/test_plates.py::test_b"
    baseline = mutant_runs.Baseline({other: 1.0, direct: 1.0}, {}, [])
    module = "packit_sim/parts/nesting/surface_kernels.py"
    mutation = mutations((mutants.ROOT / module).read_text())[0]
    assert plan(baseline, mutants.ROOT, (module, mutation), Counter()) == [direct]


@pytest.mark.slow
def test_a_draw_is_repeated_by_its_seed_and_extended_by_its_count() -> None:
    modules = mutants.GROUPS["game"].modules
    first, second = mutants.draw(1, 20, modules), mutants.draw(2, 20, modules)
    assert mutants.draw(1, 30, modules)[:20] == first != second


MEASURED = [g for g in mutants.GROUPS.values() if (mutants.RESULTS / f"{g.name}.json").exists()]


@pytest.mark.parametrize("group", MEASURED, ids=lambda group: group.name)
def test_the_page_has_the_results(group: mutants.Group) -> None:
    found = json.loads((mutants.RESULTS / f"{group.name}.json").read_text())
    page = common.PAGES / "mutants.md"
    assert table_in_page(page, group.name) == mutants.table(found)
