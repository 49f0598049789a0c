"""Agents: three policies, one for each sub-task, and optionally a search; found by name.

Policies and searches are in other packages, which announce them as entry points. `packit_agents`,
which is installed with this package, is one of them.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.core.extras import needed_for
from packit_sim.game.episode import Episode, Stage, stages
from packit_sim.geometry.items import PlacedItem

OnProgress = Callable[[int, float], None]
"""Called by a search with the number of its rollouts so far, and the best return of them."""


class Policy(Protocol):
    """A function that chooses the next action of one sub-task.

    Notes
    -----
    A policy that loads weights from a file may have an attribute `weights_digest`, a str: it is
    recorded with results, so that they are not mistaken for those of other weights. Results that
    record an attribute `former_weights_digest` instead are taken for those of the same weights.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        """Choose an action.

        Parameters
        ----------
        episode : Episode
            The episode; it must not be changed.
        rng : np.random.Generator
            The source of random numbers.

        Returns
        -------
        int
            An index at which `episode.action_mask()` is True: of a shape, of a rotation, or of a
            grid node in C order.
        """
        ...


@runtime_checkable
class Scored(Protocol):
    """A policy that scores every action, so that searches can try the best alternatives."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int: ...

    def scores(self, episode: Episode, rng: np.random.Generator) -> npt.NDArray[np.float64]:
        """Compute the log-probabilities of the stage's actions.

        Parameters
        ----------
        episode : Episode
            The episode; it must not be changed.
        rng : np.random.Generator
            The source of random numbers.

        Returns
        -------
        ndarray of float64, shape (n actions,)
            -inf for an action that is not valid. The policy chooses the first of the largest.
        """
        ...


class Search(Protocol):
    """A planner: it plays ahead with the model of the game, guided by an agent's policies.

    Notes
    -----
    A search knows all items of the episode that it gets. So it never gets an online one:
    `Agent.play` gives it the visible items alone, before each choice of a shape.
    """

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        """Play an episode from a choice of a shape, and leave it at the best end that was found.

        Parameters
        ----------
        agent : Agent
            The agent that the search belongs to.
        episode : Episode
            The episode.
        rng : np.random.Generator
            The source of random numbers.
        on_progress : OnProgress
            Called after each rollout.
        """
        ...


class UnknownPolicyError(PackItError, ValueError):
    """A policy or search that is not installed, or has no such value."""


@dataclass(frozen=True)
class Agent:
    """Three policies that play an episode together, and the search that plans with them, if any.

    Parameters
    ----------
    name : str
        "shape/rotation/location", or "shape/rotation/location+search=value".
    shape, rotation, location : Policy
        The policies.
    search : Search, optional
        The search; by default the policies play alone.
    """

    name: str
    shape: Policy
    rotation: Policy
    location: Policy
    search: Search | None = None

    @classmethod
    def from_name(cls, name: str) -> Agent:
        """Create an agent from the names of its parts.

        Parameters
        ----------
        name : str
            For example "largest-first/aligned/blbf" or "largest-first/aligned/blbf+beam=4". A
            single name, such as "champion" or "best-fit", is that of all three policies.

        Returns
        -------
        Agent
            The agent.

        Raises
        ------
        UnknownPolicyError
            If a part is not known. The message lists the valid ones.
        """
        policies, *search = name.split("+")
        parts = _parts(policies)
        if not _are_known(parts) and _are_known([policies] * len(Stage)):
            parts = [policies] * len(Stage)
        if len(parts) != len(Stage) or len(search) > 1:
            raise UnknownPolicyError(
                f"agent {name!r} is not of the form shape/rotation/location or "
                "shape/rotation/location+search=value, such as largest-first/aligned/blbf+beam=4"
            )
        shape, rotation, location = (
            load_policy(stage, part) for stage, part in zip(Stage, parts, strict=True)
        )
        return cls(name, shape, rotation, location, load_search(search[0]) if search else None)

    @property
    def weights(self) -> str | None:
        """The digests of its policies' weights; None if no policy has such."""
        return self._digests("weights_digest")

    @property
    def known_weights(self) -> tuple[str | None, ...]:
        """`weights`, and what former versions recorded for the same weights."""
        return self.weights, self._digests("former_weights_digest")

    def _digests(self, attribute: str) -> str | None:
        policies = (self.shape, self.rotation, self.location)
        digests = dict.fromkeys(getattr(policy, attribute, None) for policy in policies)
        return " ".join(digest for digest in digests if digest is not None) or None

    def policy(self, stage: Stage) -> Policy:
        """Return the policy of a sub-task."""
        return (self.shape, self.rotation, self.location)[stage]

    def act(self, episode: Episode, rng: np.random.Generator) -> int:
        """Choose the action for the episode's stage by the policy alone, without the search."""
        return self.policy(episode.stage)(episode, rng)

    def play(
        self,
        episode: Episode,
        rng: np.random.Generator,
        on_progress: OnProgress = lambda rollouts, best: None,
    ) -> None:
        """Play an episode to its end.

        Parameters
        ----------
        episode : Episode
            The episode.
        rng : np.random.Generator
            The source of random numbers.
        on_progress : OnProgress
            Called by the search, if there is one.

        Raises
        ------
        ArgumentError
            If a search is to plan an online episode with physics.

        Notes
        -----
        In the online game the search plans anew before each choice of a shape, as if the visible
        items were the only ones, with its whole budget each time. The first placement of its best
        plan is played; then progress is reported, with the return so far.
        """
        if self.search is None:
            self._play_until(episode, rng)
        elif episode.rules.buffer is None:
            if episode.end is None:
                self.search(self, episode, rng, on_progress)
        else:
            self._plan_visible(self.search, episode, rng, on_progress)

    def _play_until(
        self, episode: Episode, rng: np.random.Generator, stage: Stage | None = None
    ) -> None:
        """Let the policies play at least one action, up to a stage or to the end."""
        while episode.end is None:
            episode.step(self.act(episode, rng))
            if episode.stage is stage:
                return

    def _plan_visible(
        self, search: Search, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        """Play an online episode by a search that knows the visible items alone."""
        if episode.rules.physics is not None:
            raise ArgumentError(
                f"agent {self.name!r} can't plan online with physics: a search needs the grid"
            )
        rollouts = 0

        def count(number: int, best: float) -> None:
            nonlocal rollouts
            rollouts += 1

        while episode.end is None:
            known = episode.visible_alone()
            search(self, known, rng, count)
            planned = known.box.placed[len(episode.box.placed) :]
            if planned:
                play_placement(episode, planned[0])
            else:  # its policies choose other rotations than those in which something fits
                self._play_until(episode, rng, Stage.SHAPE)
            on_progress(rollouts, episode.total)


def play_placement(episode: Episode, placed: PlacedItem) -> None:
    """Play the three choices that place a visible item.

    Parameters
    ----------
    episode : Episode
        The episode, at a choice of a shape.
    placed : PlacedItem
        The item, which is feasible there.
    """
    item = placed.item.turned(0)
    visible = np.flatnonzero(episode.visible).tolist()
    chosen = {
        Stage.SHAPE: next(n for n in visible if episode.task.items[n] == item),
        Stage.ROTATION: placed.item.rotation,
        Stage.LOCATION: int(np.ravel_multi_index(placed.location, episode.box.nodes)),
    }
    for stage in stages(episode.rules):
        episode.step(chosen[stage])


def _parts(policies: str) -> list[str]:
    """Split "shape/rotation/location" into three names, each of which may contain a path.

    From the right, a part begins where the name of a policy begins.
    """
    found: list[str] = []
    for stage in (Stage.LOCATION, Stage.ROTATION):
        slashes = [n for n, character in enumerate(policies) if character == "/"][::-1]
        if not slashes:
            break
        names = policy_names(stage)
        starts = (n for n in slashes if _kind(policies[n + 1 :]) in names)
        at = next(starts, slashes[0])
        found.insert(0, policies[at + 1 :])
        policies = policies[:at]
    return [policies, *found]


def _are_known(parts: Sequence[str]) -> bool:
    """Return whether these are the names of one installed policy for each sub-task."""
    return len(parts) == len(Stage) and all(
        _kind(part) in policy_names(stage) for stage, part in zip(Stage, parts, strict=True)
    )


def _kind(policy: str) -> str:
    """Return the name of a policy without its value."""
    return policy.partition("@")[0]


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    """Read the entry points of a group, sorted by name, once per process: it takes about 10 ms."""
    found = entry_points(group=group)
    return {name: found[name] for name in sorted(found.names)}


def policy_names(stage: Stage) -> tuple[str, ...]:
    """Return the names of the installed policies for a sub-task."""
    return tuple(_installed(_group(stage)))


_SEARCHES = "packit_sim.searches"


@dataclass(frozen=True)
class PolicySummary:
    """What a list says about an installed policy or search.

    Attributes
    ----------
    form : str
        Its name as it is written in an agent's name, with VALUE if it takes one.
    summary : str
        The first line of its documentation.
    """

    form: str
    summary: str


def installed_policies(stage: Stage) -> tuple[PolicySummary, ...]:
    """Summarise the installed policies for a sub-task, without importing them."""
    return tuple(
        PolicySummary(f"{name}@VALUE" if source.takes_value else name, source.summary)
        for name, source in _sources(_group(stage))
    )


def installed_searches() -> tuple[PolicySummary, ...]:
    """Summarise the installed searches, without importing them."""
    found = _sources(_SEARCHES)
    return tuple(PolicySummary(f"{name}=VALUE", source.summary) for name, source in found)


@dataclass(frozen=True)
class _Definition:
    """What the source code says about an object: its documentation, and whether it can `parse`."""

    summary: str = ""
    takes_value: bool = False


def _sources(group: str) -> list[tuple[str, _Definition]]:
    return [(name, _definition(point)) for name, point in _installed(group).items()]


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
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return _Definition()
    nodes = ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body
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
    """
    what = f"{stage.name.lower()} policy"
    kind, at, value = name.partition("@")
    found = _load(_group(stage), what, kind)
    parse = getattr(found, "parse", None)
    if (parse is not None) != bool(at):
        form = f"{kind}@VALUE" if parse else kind
        raise UnknownPolicyError(f"{what} {name!r} is not of the form {form}")
    policy: Policy = parse(value) if parse else found()
    return policy


def load_search(name: str) -> Search:
    """Load a search.

    Parameters
    ----------
    name : str
        Its name and value, such as "beam=4"; the `parse` of its class gets the value.

    Returns
    -------
    Search
        The search.

    Raises
    ------
    UnknownPolicyError
        If there is no such search, or its value is not possible.
    """
    kind, _, value = name.partition("=")
    found = _load(_SEARCHES, "search", kind)
    try:
        search: Search = found.parse(value)
    except ValueError as error:
        raise UnknownPolicyError(f"search {name!r}: {error}") from None
    return search


def _load(group: str, kind: str, name: str) -> Any:
    installed = _installed(group)
    if name not in installed:
        raise UnknownPolicyError(f"there is no {kind} {name!r}: choose from {', '.join(installed)}")
    with needed_for(f"agents with the {kind} {name!r}"):
        return installed[name].load()


def _solution_shape(episode: Episode, rng: np.random.Generator) -> int:
    for shape, _, _ in episode.task.solution:
        if episode.visible[shape]:
            return shape
    raise PackItError("the task has no solution to play")


def _solution_rotation(episode: Episode, rng: np.random.Generator) -> int:
    return next(r for shape, r, _ in episode.task.solution if shape == episode.shape)


def _solution_location(episode: Episode, rng: np.random.Generator) -> int:
    location = next(at for shape, _, at in episode.task.solution if shape == episode.shape)
    return int(np.ravel_multi_index(location, episode.box.nodes))


GROUND_TRUTH = Agent("ground-truth", _solution_shape, _solution_rotation, _solution_location)
"""Plays the solution of a task, item by item, by the rules of PackIt or PackIt-Easy.

Online it places the visible items where the solution has them: if nothing must come from above.
"""
