"""The provenance of packs: a typed record, stored with each pack."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple, TypeAlias

from msgspec import Meta, Struct, field, structs

from packit_sim.core.choices import Split
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.geometry import rotations
from packit_sim.physics.convex.settings import Method
from packit_sim.rules import PACKIT, End, Rules

RETURN_SLACK = 1e-9
"""Tolerance of returns for the rounding of sums."""

Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Positive = Annotated[float, Meta(gt=0)]
Return = Annotated[float, Meta(ge=-RETURN_SLACK, le=1 + RETURN_SLACK)]
Seconds = Annotated[float, Meta(ge=0)]
Sha256 = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]
RotationIndex = Annotated[int, Meta(ge=0, lt=rotations.COUNT)]

PuzzleName = Literal["guillotine", "pinwheel", "polycubes", "curved"]
"""The ways to cut the box of a puzzle (see `generation.puzzles`)."""


class _Record(
    Struct,
    frozen=True,
    kw_only=True,
    omit_defaults=True,
    forbid_unknown_fields=True,
    tag_field="kind",
):
    """The fields of all records.

    Attributes
    ----------
    split : Split, optional
        The split of the library that the shapes belong to, if it is known.
    """

    split: Split | None = None

    @property
    def producer(self) -> str:
        """The name of the agent or search that packed it, for tables."""
        return str(self.__struct_config__.tag)


class Evolved(_Record, frozen=True, kw_only=True, tag="evolution"):
    """A pack found by evolution: each item is at its bottom-left-back-fill location.

    Attributes
    ----------
    seed : int
        The seed of the evolution.
    generation : int
        The generation in which the pack was found.
    size : float
        The linear factor on all items of the pack.
    after : int, optional
        The generation after which the pack was the best so far, for packs of a history.
    """

    seed: Count
    generation: Count
    size: Positive
    settings: EvolutionSettings
    after: Count | None = None


class Densified(_Record, frozen=True, kw_only=True, tag="densification"):
    """A pack of large items, made denser by replacing items with larger ones.

    Attributes
    ----------
    seed : int
        The seed of the densification.
    rounds : int
        The number of rounds after which the pack was as it is.
    """

    seed: Count
    rounds: Count
    settings: DensificationSettings


class Sampled(_Record, frozen=True, kw_only=True, tag="random chromosome"):
    """A pack of a random chromosome.

    Attributes
    ----------
    size : float
        The linear factor on all items of the pack.
    """

    size: Positive


class Drawn(_Record, frozen=True, kw_only=True, tag="random sequence"):
    """An empty box, and the items of a task that were drawn from a library.

    Attributes
    ----------
    seed : int, optional
        The seed of the draw, if it had its own.
    """

    seed: Count | None = None


class Improvement(NamedTuple):
    """The best return of a search so far.

    Attributes
    ----------
    seconds : float
        The processor seconds until then.
    total : float
        The return.
    """

    seconds: Seconds
    total: Return


class Puzzle(_Record, frozen=True, kw_only=True, tag="puzzle"):
    """A box that was cut into pieces, which can be put in from above in the order of the pack.

    Attributes
    ----------
    cuts : PuzzleName
        The way in which it was cut.
    seed : int
        The seed of the cuts.
    """

    cuts: PuzzleName
    pieces: Count
    seed: Count


class Played(_Record, frozen=True, kw_only=True, tag="rollout"):
    """A box at the end of an agent's episode.

    Attributes
    ----------
    agent : str
        The name of the agent.
    task : int
        The number of the task in its dataset.
    seed : int
        The seed of the evaluation.
    rules : Rules
        The rules that were played.
    total : float
        The return of the episode, "return" in files.
    end : End
        Why the episode ended.
    seconds : float
        The processor seconds that the episode took.
    improvements : tuple of Improvement
        Each better return that the agent's search found, and when; empty without a search.
    weights : str, optional
        The digest of the agent's weights, for an agent that learned.
    scores : mapping of str to number
        Other scores of the box by name, such as those of `packit evaluate --scores`.
    pieces : Method, optional
        The method of convex decomposition for these scores.
    trajectory : str, optional
        The SHA-256 of the recorded trajectory, for a box that an arm packed.
    """

    agent: str
    task: Count
    task_digest: str
    seed: Count
    rules: Rules = PACKIT
    total: Return = field(name="return")
    end: End
    seconds: Seconds = 0.0
    improvements: tuple[Improvement, ...] = ()
    weights: str | None = None
    scores: Mapping[str, int | float] = {}
    pieces: Method | None = None
    trajectory: Sha256 | None = None

    def __post_init__(self) -> None:
        if self.rules == PACKIT:  # msgspec leaves out the default itself, not what equals it
            structs.force_setattr(self, "rules", PACKIT)

    @property
    def producer(self) -> str:
        return self.agent


class FromOriginal(_Record, frozen=True, kw_only=True, tag="the original PackIt"):
    """A pack of the original PackIt's files, of which only the items are known.

    Attributes
    ----------
    file : str
        The name of the file.
    pack : int
        The number of the pack in the file, from 0.
    efficiency : float
        The value in the file.
    shape_scale : float, optional
        The value in the file.
    rotations : tuple of int
        The rotations of the task's items, as our indices.
    left_out : int
        The number of items without a shape in the library.
    """

    file: str
    pack: Count
    efficiency: float
    shape_scale: float | None = None
    rotations: tuple[RotationIndex, ...]
    left_out: Count = 0


class Other(_Record, frozen=True, kw_only=True, tag="other"):
    """Any other pack, such as one of another tool.

    Attributes
    ----------
    author : str
        The person or the tool that packed it.
    notes : str
        Anything else that is known of it.
    """

    author: str = ""
    notes: str = ""

    @property
    def producer(self) -> str:
        return self.author or "packs"


Provenance: TypeAlias = (
    Evolved | Densified | Sampled | Puzzle | Drawn | Played | FromOriginal | Other
)

UNKNOWN_PROVENANCE = Other()
"""The provenance of a pack without a record."""
