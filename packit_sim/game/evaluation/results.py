"""Results: the boxes that agents packed, and files of them.

A file of results is a file of packs (see `packs`) with `Played` as provenance: it can be verified
and drawn like any dataset.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from msgspec import structs

from packit_sim.core.errors import PackFormatError, PackItError, located
from packit_sim.core.files import naming
from packit_sim.game.datasets.execution_checks import trajectories_folder
from packit_sim.game.datasets.pack_files import read_packs, write_packs
from packit_sim.game.datasets.packs import ItemRecord, Pack
from packit_sim.game.datasets.provenance import Improvement, Played
from packit_sim.game.datasets.result_checks import result_problems, task_of
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.executed import Executed
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.robot.trajectory import Trajectory
from packit_sim.rules import End, Rules


class ResultsError(PackItError, ValueError):
    """A file without results, or with results of another evaluation."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """One played episode. Two rollouts are equal if they differ only in their time.

    Parameters
    ----------
    pack : Pack
        The box as the agent left it, with a provenance of `Played`.

    Raises
    ------
    ResultsError
        If the pack was not played.

    Examples
    --------
    >>> from packit_sim import evaluate, load_tasks
    >>> (rollout,) = evaluate(["largest-first/aligned/blbf"], load_tasks("starter")[:1], seed=0)
    >>> rollout.agent, round(rollout.total, 3), str(rollout.end)
    ('largest-first/aligned/blbf', 0.995, 'no room')
    >>> len(rollout.pack.items), len(rollout.pack.outside)
    (26, 9)
    """

    pack: Pack

    def __post_init__(self) -> None:
        if not isinstance(self.pack.provenance, Played):
            raise ResultsError(
                f"this is not a result, its provenance is {self.pack.provenance.producer!r}: "
                "results are written by `packit evaluate --out`"
            )

    @classmethod
    def of(
        cls,
        episode: Episode,
        agent: str,
        number: int,
        seed: int,
        seconds: float,
        weights: str | None = None,
        improvements: Iterable[Improvement] = (),
        execution: Executed | None = None,
    ) -> Rollout:
        """Record an episode that is over.

        Parameters
        ----------
        agent : str
            The name of the agent.
        number : int
            The number of the task.
        seed : int
            The seed of the evaluation.
        seconds : float
            The processor seconds that the episode took.
        weights : str | None
            The digest of the agent's weights, for an agent that learned.
        improvements : Iterable[Improvement]
            Each better return that the agent's search found.
        execution : Executed | None
            The measures and the trajectory, for a box that an arm packed.

        Returns
        -------
        Rollout
            The record.
        """
        assert episode.end is not None
        played = Played(
            agent=agent,
            task=number,
            task_digest=episode.task.digest,
            seed=seed,
            rules=episode.rules,
            total=float(episode.total),
            end=episode.end,
            seconds=round(seconds, 6),
            improvements=tuple(improvements),
            weights=weights,
            scores={} if execution is None else execution.scores,
            trajectory=None if execution is None else execution.digest,
        )
        task = episode.task
        pack = Pack.of(episode.box, task.pack.library, played)
        left = [item for item, is_left in zip(task.items, episode.outside, strict=True) if is_left]
        outside = tuple(ItemRecord(item.shape.id, item.scale) for item in left)
        return cls(replace(pack, outside=outside).valued(task.pack.values))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Rollout):
            return NotImplemented
        return self._timeless == other._timeless

    __hash__ = None  # type: ignore[assignment]

    @property
    def _timeless(self) -> Pack:
        timeless = tuple(each._replace(seconds=0.0) for each in self.played.improvements)
        played = structs.replace(self.played, seconds=0.0, improvements=timeless)
        return replace(self.pack, provenance=played)

    @property
    def played(self) -> Played:
        """The record of the play."""
        assert isinstance(self.pack.provenance, Played)
        return self.pack.provenance

    @property
    def agent(self) -> str:
        """The name of the agent."""
        return self.played.agent

    @property
    def task(self) -> int:
        """The number of the task."""
        return self.played.task

    @property
    def task_digest(self) -> str:
        """The digest of the task."""
        return self.played.task_digest

    @property
    def seed(self) -> int:
        """The seed of the evaluation."""
        return self.played.seed

    @property
    def rules(self) -> Rules:
        """The rules that were played."""
        return self.played.rules

    @property
    def total(self) -> float:
        """The return of the episode."""
        return self.played.total

    @property
    def end(self) -> End:
        """Why the episode ended."""
        return self.played.end

    @property
    def seconds(self) -> float:
        """The processor seconds that the episode took."""
        return self.played.seconds

    @property
    def weights(self) -> str | None:
        """The digest of the agent's weights, None for an agent that did not learn."""
        return self.played.weights

    def return_after(self, seconds: float) -> float:
        """Return the best return of the search by then: one run gives the whole curve.

        Parameters
        ----------
        seconds : float
            Processor seconds since the start of the episode.

        Returns
        -------
        float
            The best return until then; 0 before the first end of an episode was found. An agent
            without a search reaches its return when the episode is over.
        """
        found = self.played.improvements or (Improvement(self.seconds, self.total),)
        return max((each.total for each in found if each.seconds <= seconds), default=0.0)


def read_results(path: Path | str) -> list[Rollout]:
    """Read a file of results.

    Returns
    -------
    list of Rollout
        The rollouts, in the order of the file.

    Raises
    ------
    ResultsError
        If a pack is not a result; the message names the file and the pack.
    PackFormatError
        If the file can't be read as packs; the message names the file and the line.

    Examples
    --------
    >>> from packit_sim import evaluate, load_tasks, read_results
    >>> tasks = load_tasks("starter")[:2]
    >>> rollouts = evaluate(["smallest-first/aligned/blbf"], tasks, seed=0, file="results.jsonl")
    >>> read_results("results.jsonl") == rollouts
    True
    """
    rollouts = []
    for number, pack in enumerate(read_packs(path), start=1):
        try:
            rollouts.append(Rollout(pack))
        except ResultsError as error:
            raise ResultsError(f"{path}, pack {number}: {error}") from None
    return rollouts


def check_results(
    path: Path | str, rollouts: Iterable[Rollout], library: ShapeLibrary | None = None
) -> int:
    """Check that returns and ends follow from the recorded items and tasks.

    Parameters
    ----------
    path : Path | str
        The file of the results.
    rollouts : Iterable[Rollout]
        The results, in the order of the file.
    library : ShapeLibrary | None
        Their library. Without it returns and densities are not computed.

    Returns
    -------
    int
        The number of returns that can't be checked: former versions did not record items outside,
        and the task is not built in; or there is no library.

    Raises
    ------
    ResultsError
        If one does not hold, or an agent has two results on a task.
    """
    found: set[tuple[str, int]] = set()
    volume = None if library is None else (lambda id: library.info(id).volume)
    unchecked = 0
    for number, rollout in enumerate(rollouts, start=1):
        if (rollout.agent, rollout.task) in found:
            raise ResultsError(
                f"{path} holds two results of {rollout.agent!r} on task {rollout.task}: "
                "write each evaluation to a separate file"
            )
        found.add((rollout.agent, rollout.task))
        for problem in result_problems(rollout.pack, rollout.played, volume):
            raise ResultsError(
                f"{path}, pack {number}: {problem}; `packit verify` reports all problems"
            )
        unchecked += volume is None or task_of(rollout.pack, rollout.played) is None
    return unchecked


def write_results(path: Path | str, rollouts: Iterable[Rollout]) -> None:
    """Write a file of results, completely or not at all.

    Parameters
    ----------
    path : Path | str
        The file; its folder is created.
    rollouts : iterable of Rollout
        The rollouts, in the order of the file.

    Examples
    --------
    >>> from packit_sim import evaluate, load_tasks, read_results, write_results
    >>> rollouts = evaluate(["smallest-first/aligned/blbf"], load_tasks("starter")[:2], seed=0)
    >>> write_results("worst.jsonl", [min(rollouts, key=lambda rollout: rollout.total)])
    >>> len(read_results("worst.jsonl"))
    1
    """
    write_packs(path, [rollout.pack for rollout in rollouts])


def stored_trajectory(file: Path, rollout: Rollout, library: ShapeLibrary) -> Trajectory:
    """Read the trajectory of a result that an arm packed.

    Parameters
    ----------
    file : Path
        The file of results.

    Returns
    -------
    Trajectory
        The trajectory.

    Raises
    ------
    PackFormatError
        If it is missing, or not a trajectory.
    """
    path = trajectories_folder(file) / f"{rollout.played.trajectory}.npz"
    if not path.is_file():
        raise PackFormatError(f"the trajectory {path} is missing")
    with naming(path), located(path, PackFormatError):
        return Trajectory.from_bytes(path.read_bytes(), library.__getitem__)
