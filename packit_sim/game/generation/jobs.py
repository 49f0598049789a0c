"""Generation of datasets of packs: on many workers, and resumable at any moment.

Packs evolve, or they are made denser (see `densification`). A dataset is a JSON Lines file (see
`packs`), which is rewritten after each finished pack. Until all are finished, a hidden folder next
to it contains a checkpoint of each unfinished pack. The same job resumes from there, and produces
the same packs as without an interruption.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import starmap
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import PackItError
from packit_sim.core.files import claimed, followed, replace_text
from packit_sim.core.parallel import Workers
from packit_sim.core.plain_text import plain_logger
from packit_sim.game.datasets import manifests
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import read_packs, write_packs
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.datasets.provenance import Densified, Evolved
from packit_sim.game.generation.densification import Densification, DensificationState
from packit_sim.game.generation.evolution import Evolution, EvolutionState
from packit_sim.libraries.library import ShapeLibrary

_log = plain_logger(__name__)

CHECKPOINT_SECONDS = 5.0
"""Time between checkpoints: a kill loses this much work, and one generation."""

JOB_FILE = "job.json"
"""The record of the job in a folder of checkpoints."""

T = TypeVar("T")

SearchSettings: TypeAlias = EvolutionSettings | DensificationSettings
"""The settings of a search for packs: their type decides which search it is."""


class GenerationError(PackItError):
    """A dataset that can't be generated, or resumed, as requested."""


class JobRecord(Struct, frozen=True):
    """The properties that must be equal to resume a job; the number of packs may grow.

    Attributes
    ----------
    library : LibraryRef
        The library of shapes.
    split : str, optional
        The name of its split.
    seed : int
        The seed of the first pack.
    history : bool
        Whether all packs of an evolution's history are kept.
    settings : dict
        The settings of the searches, in JSON's types.
    """

    library: LibraryRef
    split: str | None
    seed: int
    history: bool
    settings: dict[str, Any]


@dataclass(frozen=True)
class GenerationJob:
    """A dataset to generate.

    Attributes
    ----------
    library : ShapeLibrary
        The library of shapes, or one of its splits.
    packs : int
        The number of evolutions, or of densifications.
    seed : int
        The seed of the first one; that of number n is `seed` + n.
    split : str, optional
        The name of the split that the library is.
    history : bool
        Whether an evolution gives all packs of its history, not the best pack alone (for the
        hardness curve: paper, figure 4). Densifications have no history.

    Raises
    ------
    GenerationError
        If densifications are to have a history.
    """

    library: ShapeLibrary
    packs: int
    seed: int = 0
    split: str | None = None
    history: bool = False
    settings: SearchSettings = field(default_factory=EvolutionSettings)

    def __post_init__(self) -> None:
        if self.history and isinstance(self.settings, DensificationSettings):
            raise GenerationError("only evolutions have a history, not densifications")

    @property
    def record(self) -> JobRecord:
        """The properties that must be equal to resume the job."""
        library = LibraryRef.of(self.library)
        return JobRecord(library, self.split, self.seed, self.history, self.settings.to_json())

    def search(self, number: int) -> Evolution | Densification:
        """Start the search for the pack of a number."""
        seed = self.seed + number
        if isinstance(self.settings, EvolutionSettings):
            return Evolution(self.library, seed, self.settings)
        return Densification(self.library, seed, self.settings)

    def is_of(self, pack: Pack) -> bool:
        """Return whether a pack was generated with the job's library, settings and history."""
        found = pack.provenance
        if not isinstance(found, Evolved | Densified) or found.settings != self.settings:
            return False
        is_history = isinstance(found, Evolved) and found.after is not None
        return is_history == self.history and pack.library == LibraryRef.of(self.library)


@dataclass(frozen=True)
class EvolutionProgress:
    """An unfinished evolution or densification at its last checkpoint.

    Attributes
    ----------
    number : int
        The number of its pack.
    generation : int
        The last generation or round, from 0.
    density : float
        The best density so far.
    """

    number: int
    generation: int
    density: float


def generate(
    job: GenerationJob,
    file: Path,
    workers: Workers | None = None,
    on_pack: Callable[[int, Pack], None] = lambda number, pack: None,
) -> list[Pack]:
    """Generate a dataset, or its missing packs.

    The packs are the same with any number of workers. On a cluster the packs of a lost machine are
    resumed elsewhere, from their checkpoints if its machines share the file's folder, otherwise
    from the start.

    Parameters
    ----------
    job : GenerationJob
        The dataset to generate.
    file : Path
        The JSON Lines file of its packs.
    workers : Workers | None
        The workers that run searches; None for this process.
    on_pack : Callable[[int, Pack], None]
        Called with the number and the best pack of each search that ends, once.

    Returns
    -------
    list of Pack
        The packs in the order of their seeds.

    Raises
    ------
    GenerationError
        If the file or the folder of checkpoints belongs to a job with other settings.
    BusyError
        If another process generates the same file.
    WorkersError
        If workers are lost for good.
    """
    folder = work_folder(file)
    with _locked(folder):
        manifests.prepare(file)
        done = _finished(job, file)
        _check_job(job, folder / JOB_FILE)
        if done:
            write_packs(file, _in_order(done))
        missing = [n for n in range(job.packs) if job.seed + n not in done]
        _log.info("%s: %d of %d packs are left to evolve", file, len(missing), job.packs)
        started = time.monotonic()
        calls = ((job, job.record, folder.absolute(), n, os.getpid()) for n in missing)
        evolved = (
            starmap(evolve_pack, calls) if workers is None else workers.as_done(evolve_pack, calls)
        )
        for number, packs in evolved:
            done[job.seed + number] = packs
            write_packs(file, _in_order(done))
            checkpoint(folder, number).unlink(missing_ok=True)
            _log.info("pack %d: density %.3f", number, packs[-1].density)
            on_pack(number, packs[-1])
        shutil.rmtree(folder)
    _log.info("%s: finished in %.1f s", file, time.monotonic() - started)
    return _in_order(done)


def work_folder(file: Path) -> Path:
    """Return the folder of a dataset's checkpoints, which exists until all packs are finished."""
    target = followed(file)
    return target.with_name(f".{target.stem}.making")


def checkpoint(folder: Path, number: int) -> Path:
    """Return the file of a pack's checkpoint."""
    return folder / f"{number:05d}.json"


def under_way(file: Path) -> list[EvolutionProgress]:
    """Read the progress of a dataset's unfinished packs from their checkpoints."""
    found = []
    for path in sorted(work_folder(file).glob("[0-9]*.json")):
        state = read_state(path, EvolutionState) or read_state(path, DensificationState)
        if state is not None and state.densities:
            last = len(state.densities) - 1
            found.append(EvolutionProgress(int(path.stem), last, state.densities[-1]))
    return found


def evolve_pack(
    job: GenerationJob, wanted: JobRecord, folder: Path, number: int, driver: int
) -> tuple[int, list[Pack]]:
    """Search for a pack to the end, from its checkpoint if it has one.

    Checkpoints are written only if the folder is that of the wanted job: a machine of a cluster may
    not share it. Raises GenerationError if the library here is not the wanted one.
    """
    if job.record != wanted:
        raise GenerationError(
            f"{job.library.path}: not the library of the job: its digest is "
            f"{job.library.digest:.12}, and should be {wanted.library.digest:.12}"
        )
    is_child = os.getppid() == driver
    writes = read_state(folder / JOB_FILE, JobRecord) == wanted
    path = checkpoint(folder, number)
    search = job.search(number)
    restored = writes and _restore(search, path)
    if restored:
        _log.info("pack %d: resumes after %d generations", number, len(search.densities))
    elif writes and path.exists():
        _log.warning("%s is damaged: pack %d starts again", path, number)
    written = time.monotonic()
    while not search.is_over:
        search.step()
        if search.is_over or time.monotonic() - written > CHECKPOINT_SECONDS:
            if is_child and os.getppid() != driver:
                os._exit(1)  # nobody waits for this worker any more
            if writes:
                replace_text(path, typed_json.encode(search.state))
            written = time.monotonic()
    packs = search.kept if job.history and isinstance(search, Evolution) else [search.best]
    return number, packs


def _restore(search: Evolution | Densification, path: Path) -> bool:
    """Resume a search from its checkpoint; return whether there is one that can be read."""
    if isinstance(search, Evolution):
        evolved = read_state(path, EvolutionState)
        if evolved is not None:
            search.restore(evolved)
        return evolved is not None
    densified = read_state(path, DensificationState)
    if densified is not None:
        search.restore(densified)
    return densified is not None


def _in_order(done: dict[int, list[Pack]]) -> list[Pack]:
    return [pack for seed in sorted(done) for pack in done[seed]]


def read_state(path: Path, kind: type[T]) -> T | None:
    """Read a record; None if there is none, or if a failing disk has damaged it."""
    try:
        return typed_json.decode(path.read_bytes(), kind, GenerationError)
    except (OSError, GenerationError):
        return None


def _check_job(job: GenerationJob, path: Path) -> None:
    """Record the job, or compare it with the record that is there."""
    before, wanted = read_state(path, JobRecord), job.record
    if before is None:
        replace_text(path, typed_json.encode(wanted))
    elif before != wanted:
        theirs, ours = typed_json.builtins(before), typed_json.builtins(wanted)
        differences = "; ".join(
            f"{name} was {theirs[name]!r}, now {ours[name]!r}"
            for name in ours
            if theirs[name] != ours[name]
        )
        raise GenerationError(
            f"{path.parent} can be resumed only as the job that began it: {differences}. "
            "Choose another folder, or delete that one to start again"
        )


def _finished(job: GenerationJob, file: Path) -> dict[int, list[Pack]]:
    """Read the packs of a dataset by seed. Raises GenerationError if they are not of this job."""
    if not file.exists():
        return {}
    done: dict[int, list[Pack]] = {}
    library = LibraryRef.of(job.library)
    for number, pack in enumerate(read_packs(file)):
        found = pack.provenance
        if not (isinstance(found, Evolved | Densified) and job.is_of(pack)):
            raise GenerationError(
                f"{file}, pack {number} was generated with another library or other settings: "
                "choose another folder"
            )
        done.setdefault(found.seed, []).append(replace(pack, library=library))
    return done


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock the folder for this process; the lock ends with the process.

    If the folder has no checkpoint at the end, it is removed, with the parents created here.
    """
    created = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with claimed(folder / "lock", folder):
        try:
            yield
        finally:
            if folder.exists() and not any(folder.glob("[0-9]*.json")):
                shutil.rmtree(folder)
            for parent in created[1:]:
                if not any(parent.iterdir()):
                    parent.rmdir()
