"""Every public name has an Examples section that runs and prints what it says."""

import doctest
import inspect

import pytest

import packit_sim

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def docstring(name: str) -> str:
    """The docstring of a name: of its class for constants, of the package for `__version__`."""
    value = packit_sim if name == "__version__" else getattr(packit_sim, name)
    return inspect.getdoc(value) or ""


def examples(name: str) -> doctest.DocTest:
    _, _, section = docstring(name).partition("\nExamples\n--------\n")
    return doctest.DocTestParser().get_doctest(section, {}, name, None, None)


@pytest.mark.parametrize("name", packit_sim.__all__)
def test_a_public_name_has_examples_that_print_what_they_say(name, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = examples(name)
    assert any(example.want or example.exc_msg for example in found.examples)
    report: list[str] = []
    result = doctest.DocTestRunner(optionflags=FLAGS).run(found, out=report.append)
    assert result.attempted > 0
    assert result.failed == 0, "".join(report)
