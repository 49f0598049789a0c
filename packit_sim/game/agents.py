"""What an agent is: three policies, one for each sub-task, and maybe a search; found by name.

The policies and searches themselves are in other packages, which announce them as entry points;
`packit_agents`, which comes with this one, does so like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import PackItError
from packit_sim.game.episode import Episode, Stage

OnProgress = Callable[[int, float], None]
"""Called by a search with how many rollouts it has made, and the best return of them."""


class Policy(Protocol):
    """Chooses the next action of one sub-task.

    Called with the episode, which it must not change, and the random generator to draw from.
    A shape policy returns the index of a shape outside, a rotation policy 0 to 23, a location
    policy the C-order index of a feasible location. One that loads what it learned from a file may
    have `weights_digest`, a str: kept results are then not taken for those of other weights.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int: ...


@runtime_checkable
class Scored(Protocol):
    """A policy that says what it thinks of every action: what searches look for alternatives by."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int: ...

    def scores(self, episode: Episode, rng: np.random.Generator) -> npt.NDArray[np.float64]:
        """Log-probabilities of the stage's actions, -inf for one that is not valid.

        The policy's own choice is the first of the largest.
        """
        ...


class Search(Protocol):
    """Looks ahead with the model of the game, and asks an agent's policies what to try."""

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        """Plays an episode from a choice of a shape, and leaves it at the best end it found."""
        ...


class UnknownPolicyError(PackItError, ValueError):
    """A policy or search that no installed package announces, or that can't do what is asked."""


@dataclass(frozen=True)
class Agent:
    """Three policies that play an episode together, and the search that plans with them, if any.

    name: "shape/rotation/location", or "shape/rotation/location+search=value".
    """

    name: str
    shape: Policy
    rotation: Policy
    location: Policy
    search: Search | None = None

    @classmethod
    def from_name(cls, name: str) -> Agent:
        """An agent by its parts, such as "largest-first/aligned/blbf" or "...+beam=4".

        Raises UnknownPolicyError that lists the valid ones.
        """
        policies, *search = name.split("+")
        parts = _parts(policies)
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
        """Digests of the weights of its policies that have such and tell; None where none does."""
        policies = (self.policy(stage) for stage in Stage)
        told = dict.fromkeys(getattr(policy, "weights_digest", None) for policy in policies)
        return " ".join(weights for weights in told if weights is not None) or None

    def policy(self, stage: Stage) -> Policy:
        """Of a sub-task."""
        return (self.shape, self.rotation, self.location)[stage]

    def act(self, episode: Episode, rng: np.random.Generator) -> int:
        """The action for the episode's stage, by the policy alone, without the search."""
        return self.policy(episode.stage)(episode, rng)

    def play(
        self,
        episode: Episode,
        rng: np.random.Generator,
        on_progress: OnProgress = lambda rollouts, best: None,
    ) -> None:
        """Plays an episode to its end."""
        if self.search is not None and episode.end is None:
            self.search(self, episode, rng, on_progress)
        else:
            while episode.end is None:
                episode.step(self.act(episode, rng))


def _parts(policies: str) -> list[str]:
    """The names of policies of "shape/rotation/location", of which each may hold a path.

    From the right, a part begins where the name of a policy does.
    """
    found: list[str] = []
    for stage in (Stage.LOCATION, Stage.ROTATION):
        slashes = [n for n, character in enumerate(policies) if character == "/"][::-1]
        if not slashes:
            break
        names = policy_names(stage)
        starts = (n for n in slashes if policies[n + 1 :].partition("@")[0] in names)
        at = next(starts, slashes[0])
        found.insert(0, policies[at + 1 :])
        policies = policies[:at]
    return [policies, *found]


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    """Read the entry points of a group, sorted by name, once per process: it takes about 10 ms."""
    found = entry_points(group=group)
    return {name: found[name] for name in sorted(found.names)}


def policy_names(stage: Stage) -> tuple[str, ...]:
    """The installed policies for a sub-task."""
    return tuple(_installed(_group(stage)))


def search_names() -> tuple[str, ...]:
    """The installed searches."""
    return tuple(_installed(_SEARCHES))


_SEARCHES = "packit_sim.searches"


def _group(stage: Stage) -> str:
    return f"packit_sim.{stage.name.lower()}_policies"


def load_policy(stage: Stage, name: str) -> Policy:
    """The policy of this name for a sub-task, or of "name@value" where it takes one.

    Raises UnknownPolicyError that lists the names, or says whether it takes a value.
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
    """A search by its name and value, such as "beam=4": its class's `parse` gets the value.

    Raises UnknownPolicyError that lists the names, or says which values there are.
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
    try:
        return installed[name].load()
    except ImportError as error:
        raise UnknownPolicyError(
            f"{kind} {name!r} needs {error.name}, which is not installed"
        ) from None


def _solution_shape(episode: Episode, rng: np.random.Generator) -> int:
    for shape, _, _ in episode.task.solution:
        if episode.outside[shape]:
            return shape
    raise PackItError("the task has no solution that could be played")


def _solution_rotation(episode: Episode, rng: np.random.Generator) -> int:
    return next(r for shape, r, _ in episode.task.solution if shape == episode.shape)


def _solution_location(episode: Episode, rng: np.random.Generator) -> int:
    location = next(at for shape, _, at in episode.task.solution if shape == episode.shape)
    return int(np.ravel_multi_index(location, episode.box.nodes))


GROUND_TRUTH = Agent("ground-truth", _solution_shape, _solution_rotation, _solution_location)
"""Plays the pack that a task was made of, item by item, by the rules of PackIt or PackIt-Easy."""
