"""Datasets of evolved packs: on many workers, stopped at any moment, and gone on with.

A dataset is a JSON Lines file (see `packs`), which is written anew with each finished pack. Until
all are finished, a hidden folder stands beside it with a checkpoint of each evolution under way:
the same order goes on from there, and ends in the same packs as without a stop.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from itertools import starmap
from pathlib import Path
from typing import Any

from packit_sim.core.errors import PackItError
from packit_sim.core.files import claimed, replace_text
from packit_sim.core.parallel import Workers
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.packs import LibraryRef, Pack, read_packs, write_packs
from packit_sim.datasets.provenance import Evolved
from packit_sim.generation.evolution import Evolution
from packit_sim.libraries.library import ShapeLibrary

_log = logging.getLogger(__name__)

CHECKPOINT_SECONDS = 5.0
"""Work that a kill can lose, and the time of a generation."""

ORDER = "order.json"
"""What a folder of checkpoints was begun with."""


class GenerationError(PackItError):
    """A dataset that can't be made, or gone on with, as it was asked for."""


@dataclass(frozen=True)
class GenerationJob:
    """What is to be made: packs 0 to packs - 1, of which number n has the seed `seed` + n.

    library: or one of its splits, which `split` names. history: of each evolution not the best pack
    alone, but all that were kept on the way (the hardness curve: paper, figure 4).
    """

    library: ShapeLibrary
    packs: int
    seed: int = 0
    split: str | None = None
    history: bool = False
    settings: EvolutionSettings = field(default_factory=EvolutionSettings)

    def to_json(self) -> dict[str, Any]:
        """What must be the same to go on; there may be more packs."""
        return {
            "library": asdict(LibraryRef.of(self.library)),
            "split": self.split,
            "seed": self.seed,
            "history": self.history,
            "settings": self.settings.to_json(),
        }


@dataclass(frozen=True)
class Progress:
    """An evolution under way: which pack's, and where its last checkpoint stands."""

    number: int
    generation: int
    density: float


def generate(
    order: GenerationJob,
    file: Path,
    workers: Workers | None = None,
    on_pack: Callable[[int, Pack], None] = lambda number, pack: None,
) -> list[Pack]:
    """Makes a dataset, or what is missing of it, and returns it in the order of seeds.

    on_pack is called with the number and the best pack of each evolution that ends, once. The packs
    are the same with any number of workers. On a cluster the lost machine's packs go on elsewhere,
    from their checkpoints where its machines share the file's folder, or else anew. Raises
    GenerationError where another process is at it, and where what is there was made with other
    settings; WorkersError where workers are lost for good.
    """
    folder = work_folder(file)
    with _locked(folder):
        for half_written in file.parent.glob(f".{file.name}.*"):
            half_written.unlink()
        done = _finished(order, file)
        _check_order(order, folder / ORDER)
        if done:
            write_packs(file, _in_order(done))
        missing = [n for n in range(order.packs) if order.seed + n not in done]
        _log.info("%s: %d of %d packs are left to evolve", file, len(missing), order.packs)
        started = time.monotonic()
        jobs = ((order, order.to_json(), folder.absolute(), n, os.getpid()) for n in missing)
        made = starmap(_made, jobs) if workers is None else workers.as_done(_made, jobs)
        for number, packs in made:
            done[order.seed + number] = packs
            write_packs(file, _in_order(done))
            checkpoint(folder, number).unlink(missing_ok=True)
            _log.info("pack %d: density %.3f", number, packs[-1].density)
            on_pack(number, packs[-1])
        shutil.rmtree(folder)
    _log.info("%s: finished in %.1f s", file, time.monotonic() - started)
    return _in_order(done)


def work_folder(file: Path) -> Path:
    """Where the checkpoints of a dataset are while it is being made."""
    return file.with_name(f".{file.stem}.making")


def checkpoint(folder: Path, number: int) -> Path:
    """The checkpoint of a pack."""
    return folder / f"{number:05d}.json"


def under_way(file: Path) -> list[Progress]:
    """Where the evolutions of a dataset stand."""
    found = []
    for path in sorted(work_folder(file).glob("[0-9]*.json")):
        state = _read(path)
        if state and state["densities"]:
            densities = state["densities"]
            found.append(Progress(int(path.stem), len(densities) - 1, densities[-1]))
    return found


def _made(
    order: GenerationJob, wanted: dict[str, Any], folder: Path, number: int, driver: int
) -> tuple[int, list[Pack]]:
    """Evolves a pack, from its checkpoint if it has one, to the end.

    Checkpoints are kept where the folder is that of the order wanted: a machine of a cluster may
    not share it. Raises GenerationError where the library here is not the one that is wanted.
    """
    if order.to_json() != wanted:
        raise GenerationError(
            f"{order.library.path}: not the library of the order: its digest is "
            f"{order.library.digest:.12}, and should be {wanted['library']['digest']:.12}"
        )
    ours = os.getppid() == driver
    keeps = _read(folder / ORDER) == wanted
    path = checkpoint(folder, number)
    evolution = Evolution(order.library, order.seed + number, order.settings)
    state = _read(path) if keeps else None
    if state:
        evolution.restore(state)
        _log.info("pack %d: resumes after %d generations", number, len(evolution.densities))
    elif keeps and path.exists():
        _log.warning("%s is damaged: pack %d starts again", path, number)
    written = time.monotonic()
    while not evolution.is_over:
        evolution.step()
        if evolution.is_over or time.monotonic() - written > CHECKPOINT_SECONDS:
            if ours and os.getppid() != driver:
                os._exit(1)  # nobody waits for this worker any more
            if keeps:
                replace_text(path, json.dumps(evolution.to_json()))
            written = time.monotonic()
    packs = evolution.kept if order.history else [evolution.best]
    return number, packs


def _in_order(done: dict[int, list[Pack]]) -> list[Pack]:
    return [pack for seed in sorted(done) for pack in done[seed]]


def _read(path: Path) -> dict[str, Any] | None:
    """A checkpoint; None where there is none to be had, or a failing disk has damaged it."""
    try:
        state: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return state


def _check_order(order: GenerationJob, path: Path) -> None:
    wanted = order.to_json()
    before = _read(path)
    if before is None:
        replace_text(path, json.dumps(wanted))
    elif before != wanted:
        names = [name for name in wanted if before.get(name) != wanted[name]]
        told = "; ".join(f"{name} was {before.get(name)!r}, now {wanted[name]!r}" for name in names)
        raise GenerationError(
            f"{path.parent} goes on only with what it was begun with: {told}. "
            "Choose another folder, or delete that one to begin anew"
        )


def _finished(order: GenerationJob, file: Path) -> dict[int, list[Pack]]:
    """The packs of a dataset by seed. Raises GenerationError where they are not of this order.

    The manifest may be that of one pack less: between the two a kill can fall.
    """
    if not file.exists():
        return {}
    done: dict[int, list[Pack]] = {}
    for number, pack in enumerate(read_packs(file, manifest=False)):
        found = pack.provenance
        if (
            not isinstance(found, Evolved)
            or pack.library != LibraryRef.of(order.library)
            or found.settings != order.settings
            or (found.after is not None) != order.history
        ):
            raise GenerationError(
                f"{file}, pack {number} was made with another library or other settings: "
                "choose another folder"
            )
        done.setdefault(found.seed, []).append(pack)
    return done


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Holds the folder for this process; the lock ends with the process, however that ends.

    A folder that is left without a checkpoint goes, with those above it that were made for it.
    """
    made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with claimed(folder / "lock", folder):
        try:
            yield
        finally:
            if folder.exists() and not any(folder.glob("[0-9]*.json")):
                shutil.rmtree(folder)
            for parent in made[1:]:
                if not any(parent.iterdir()):
                    parent.rmdir()
