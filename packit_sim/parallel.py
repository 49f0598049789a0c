"""Parallel work, all of it by joblib: on this machine's cores, or on a Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import Any, Literal, TypeVar, get_args

import joblib

from packit_sim.errors import PackItError

_T = TypeVar("_T")

BackendName = Literal["loky", "ray"]

BACKENDS: tuple[str, ...] = get_args(BackendName)
"""Processes of this machine, or of a Ray cluster (the extra `cluster`)."""


class WorkersError(PackItError, ValueError):
    """Workers that can't be had as they were asked for."""


class Workers:
    """So many processes that work; they start with the first `map` and end with the `with` block.

    count: how many, 0 for one on each core there is. address: of the Ray cluster's head, None for
    the one that is running here, or else a new one. Raises WorkersError where that is not possible.
    """

    def __init__(
        self, count: int = 0, backend: BackendName = "loky", address: str | None = None
    ) -> None:
        if backend not in BACKENDS:
            raise WorkersError(f"no backend {backend!r}: choose from {', '.join(BACKENDS)}")
        if count < 0:
            raise WorkersError(f"{count} workers are not possible: choose 1 or more, or 0 for all")
        if address is not None and backend != "ray":
            raise WorkersError(f"address {address!r} is of a Ray cluster: choose backend ray")
        if backend == "ray":
            _join_cluster(address)
        self._settings: dict[str, Any] = {"backend": backend, "batch_size": 1}
        with joblib.parallel_config(backend):
            self.count = count or joblib.effective_n_jobs(-1)
        self._parallel: joblib.Parallel | None = None

    def map(self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]) -> list[_T]:
        """What the function returns for each of the arguments, in their order."""
        if self._parallel is None:
            self._parallel = joblib.Parallel(
                self.count, pre_dispatch="all", **self._settings
            ).__enter__()
        jobs = (joblib.delayed(function)(*each) for each in arguments)
        found: list[_T] = self._parallel(jobs)
        return found

    def as_done(
        self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]
    ) -> Iterator[_T]:
        """The same as they are done, in any order; no more than one a worker is begun ahead.

        On a Ray cluster they come in rounds, one a worker: joblib knows no other way there.
        """
        if self._settings["backend"] == "ray":
            rest = iter(arguments)
            while together := list(islice(rest, self.count)):
                yield from self.map(function, together)
            return
        parallel = joblib.Parallel(
            self.count, return_as="generator_unordered", pre_dispatch="n_jobs", **self._settings
        )
        yield from parallel(joblib.delayed(function)(*each) for each in arguments)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._parallel is not None:
            self._parallel.__exit__(*raised)
            self._parallel = None


def _join_cluster(address: str | None) -> None:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError as error:
        raise WorkersError(
            "the backend ray is not installed: pip install 'packit-sim[cluster]'"
        ) from error
    if not ray.is_initialized():
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    register_ray()
