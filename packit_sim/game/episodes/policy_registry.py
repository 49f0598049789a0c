"""The installed policies and searches, by name.

Other packages announce them as entry points. `packit_agents`, which is installed with this package,
is one of them.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from packit_sim.core.entry_points import EntryPointError, announced, load, usable
from packit_sim.core.errors import PackItError
from packit_sim.core.suggestions import did_you_mean
from packit_sim.game.episodes.episode import Stage
from packit_sim.game.episodes.policies import Policy

_SEARCHES = "packit_sim.searches"


class UnknownPolicyError(PackItError, ValueError):
    """A policy or search that is not installed, or has no such value."""


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    """Read the entry points of a group, once per process."""
    return announced(group)


def policy_names(stage: Stage) -> tuple[str, ...]:
    """Return the names of the installed policies for a sub-task."""
    return tuple(_installed(_group(stage)))


@dataclass(frozen=True)
class PolicySummary:
    """The entry of an installed policy or search in a list.

    Attributes
    ----------
    form : str
        Its name as it is written in an agent's name, with VALUE if it takes one.
    summary : str
        The first line of its documentation, or why it can't be used.
    """

    form: str
    summary: str


def installed_policies(stage: Stage) -> tuple[PolicySummary, ...]:
    """Summarise the installed policies for a sub-task, without importing them."""
    return tuple(
        PolicySummary(f"{name}@VALUE" if source.takes_value else name, source.summary)
        for name, source in _sources(_group(stage), _kind(stage))
    )


def installed_searches() -> tuple[PolicySummary, ...]:
    """Summarise the installed searches, without importing them."""
    found = _sources(_SEARCHES, "search")
    return tuple(PolicySummary(f"{name}=VALUE", source.summary) for name, source in found)


@dataclass(frozen=True)
class _Definition:
    """The source code's documentation of an object, and whether it can `parse`."""

    summary: str = ""
    takes_value: bool = False


def _sources(group: str, kind: str) -> list[tuple[str, _Definition]]:
    found = []
    for name, point in _installed(group).items():
        try:
            with usable(point, kind):
                found.append((name, _definition(point)))
        except EntryPointError as error:
            found.append((name, _Definition(str(error))))
    return found


def _methods(node: ast.stmt | None, classes: Mapping[str, ast.ClassDef]) -> set[str]:
    """Return the names of a class's methods, with those of its bases in the same module."""
    if not isinstance(node, ast.ClassDef):
        return set()
    found = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
    bases = [classes.get(base.id) for base in node.bases if isinstance(base, ast.Name)]
    return found.union(*(_methods(base, classes) for base in bases))


def _definition(point: EntryPoint) -> _Definition:
    """Read the definition of an entry point's object: its package may lack what it imports."""
    spec = find_spec(point.module)
    if spec is None:
        raise ModuleNotFoundError(f"there is no module {point.module}")
    if spec.origin is None or not spec.origin.endswith(".py"):
        return _Definition()
    nodes = ast.parse(Path(spec.origin).read_text(encoding="utf-8"), spec.origin).body
    classes = {node.name: node for node in nodes if isinstance(node, ast.ClassDef)}
    for node, after in zip(nodes, [*nodes[1:], None], strict=True):
        text: str | None = None
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == point.attr:
            text = ast.get_docstring(node) or ""
            return _Definition(text.partition("\n")[0], "parse" in _methods(node, classes))
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(one, ast.Name) and one.id == point.attr for one in targets):
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                text = str(after.value.value)
            return _Definition((text or "").partition("\n")[0])
    return _Definition()


def _group(stage: Stage) -> str:
    return f"packit_sim.{stage.name.lower()}_policies"


def _kind(stage: Stage) -> str:
    return f"{stage.name.lower()} policy"


def load_policy(stage: Stage, name: str) -> Policy:
    """Load a policy for a sub-task.

    Parameters
    ----------
    stage : Stage
        The sub-task.
    name : str
        The name of the policy, or "name@value" if it takes a value.

    Returns
    -------
    Policy
        The policy.

    Raises
    ------
    UnknownPolicyError
        If there is no such policy, or a value is missing or not expected.
    EntryPointError
        If it can't be imported.
    """
    what = _kind(stage)
    kind, at, value = name.partition("@")
    found = _load(_group(stage), what, kind)
    parse = getattr(found, "parse", None)
    if (parse is not None) != bool(at):
        form = f"{kind}@VALUE" if parse else kind
        raise UnknownPolicyError(f"{what} {name!r} is not of the form {form}")
    policy: Policy = parse(value) if parse else found()
    return policy


def load_search(name: str) -> Any:
    """Load a search.

    Parameters
    ----------
    name : str
        Its name and value, such as "beam=4"; the `parse` of its class gets the value.

    Returns
    -------
    Search
        The search, which follows the protocol `agents.Search`.

    Raises
    ------
    UnknownPolicyError
        If there is no such search, or its value is not possible.
    EntryPointError
        If it can't be imported.
    """
    kind, _, value = name.partition("=")
    found = _load(_SEARCHES, "search", kind)
    try:
        return found.parse(value)
    except ValueError as error:
        raise UnknownPolicyError(f"search {name!r}: {error}") from None


def _load(group: str, kind: str, name: str) -> Any:
    installed = _installed(group)
    if name not in installed:
        raise UnknownPolicyError(
            f"there is no {kind} {name!r}: {did_you_mean(name, installed)}"
            f"choose from {', '.join(installed)}"
        )
    return load(installed[name], kind)
