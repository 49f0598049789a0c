"""Parallel work: jobs by joblib, on this machine's cores or a Ray cluster, and Ray's actors."""

from __future__ import annotations

import logging
import pickle
import platform
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, Literal, TypeVar, get_args

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError
from joblib.parallel import ParallelBackendBase

from packit_sim._version import __version__
from packit_sim.core.errors import PackItError

_T = TypeVar("_T")

BackendName = Literal["loky", "ray"]

BACKENDS: tuple[str, ...] = get_args(BackendName)
"""Processes of this machine, or of a Ray cluster (the extra `cluster`)."""

MOST_LOSSES = 20
"""How often a job may be lost with its process or its machine: more often, and it kills them."""

START_SECONDS = 120.0
"""In which all `Actors` must have begun: without a core that is free they would wait for ever."""

CONNECT_SECONDS = 10.0
"""In which the head of a cluster must answer; Ray itself would try for minutes."""


class WorkersError(PackItError, ValueError):
    """Workers that can't be had as they were asked for, or are lost for good."""


class Workers:
    """So many processes that work; they start with the first job and end with the `with` block.

    count: how many, 0 for one on each core there is; of a cluster also on cores that join it later,
    up to as many again. address: of the Ray cluster's head, None for the one that is running here,
    or else a new one. Jobs are pure functions: what is lost with a machine of the cluster is done
    again on another, as soon as there is one. Raises WorkersError where workers can't be had, or
    not be replaced.
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
        is_ray = backend == "ray"
        self._leave = _join_cluster(address) if is_ray else lambda: None
        with joblib.parallel_config(backend):
            self.count = count or joblib.effective_n_jobs(-1)
        self._settings: dict[str, Any] = {
            "n_jobs": max(2, self.count) if is_ray else self.count,  # joblib does a single one here
            "backend": backend,
            "batch_size": 1,
        }
        self._ahead = self.count * (2 if is_ray and count == 0 else 1)
        self._parallel: joblib.Parallel | None = None

    def map(self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]) -> list[_T]:
        """What the function returns for each of the arguments, in their order."""
        if self._parallel is None:
            ahead = self._ahead if self._settings["backend"] == "ray" else "all"
            self._parallel = joblib.Parallel(pre_dispatch=ahead, **self._settings).__enter__()
        with _reporting_killed_workers():
            jobs = (joblib.delayed(function)(*each) for each in arguments)
            found: list[_T] = self._parallel(jobs)
        return found

    def as_done(
        self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]
    ) -> Iterator[_T]:
        """The same as they are done, in any order; no more than one a worker is begun ahead."""
        parallel = joblib.Parallel(
            return_as="generator_unordered", pre_dispatch=self._ahead, **self._settings
        )
        with _reporting_killed_workers():
            yield from parallel(joblib.delayed(function)(*each) for each in arguments)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._parallel is not None:
            self._parallel.__exit__(*raised)
            self._parallel = None
        self._leave()


class Actors:
    """Objects that keep their state, each in a process of its own of a Ray cluster.

    kind: makes one of each of the arguments, in its process. address: as of `Workers`. Raises
    WorkersError where there is no cluster, or no core for each, or a process is lost: what was in
    it can't be had again.
    """

    def __init__(
        self,
        kind: Callable[..., Any],
        arguments: Sequence[tuple[Any, ...]],
        address: str | None = None,
    ) -> None:
        self._leave = _join_cluster(address)
        import ray
        from ray import cloudpickle

        class Actor:
            """Travels as code: the machine may lack PackIt-Sim."""

            def __init__(self, job: bytes) -> None:
                self.made = pickle.loads(job)()

            def call(self, method: str, args: Any, others: Any) -> Any:
                return getattr(self.made, method)(*args, **others)

        remote = ray.remote(num_cpus=1)(Actor)
        jobs = [cloudpickle.dumps(partial(kind, *each)) for each in arguments]
        self._actors: list[Any] = [
            remote.remote(cloudpickle.dumps(partial(_answer, __version__, job))) for job in jobs
        ]
        self._begun: list[Any] = []
        count = len(self._actors)
        _, late = ray.wait(
            [actor.__ray_ready__.remote() for actor in self._actors],
            num_returns=count,
            timeout=START_SECONDS,
        )
        if late:
            self.close()
            raise WorkersError(
                f"{len(late)} of {count} processes did not begin in {START_SECONDS:g} s: the "
                "cluster has too few cores that are free"
            )

    def begin(
        self,
        method: str,
        arguments: Sequence[tuple[Any, ...]],
        others: Sequence[dict[str, Any]] | None = None,
    ) -> None:
        """Calls a method of each, with arguments by position and by name, for `end`."""
        named = others or [{}] * len(arguments)
        self._begun = [
            actor.call.remote(method, args, by_name)
            for actor, args, by_name in zip(self._actors, arguments, named, strict=True)
        ]

    def end(self) -> list[Any]:
        """What the methods that were begun return. Raises what they raise."""
        import ray
        from ray.exceptions import RayError, RayTaskError

        try:
            return list(ray.get(self._begun))
        except RayTaskError as error:
            raise error.cause from error
        except RayError as error:
            why = str(error).partition("\n")[0]
            raise WorkersError(f"a process of the cluster was lost: {why}") from error

    def call(
        self,
        method: str,
        arguments: Sequence[tuple[Any, ...]],
        others: Sequence[dict[str, Any]] | None = None,
    ) -> list[Any]:
        """`begin` and `end`."""
        self.begin(method, arguments, others)
        return self.end()

    def close(self) -> None:
        """Ends the processes."""
        import ray

        for actor in self._actors:
            ray.kill(actor)
        self._actors = []
        self._leave()


class RayTasks(ParallelBackendBase):  # type: ignore[misc] # joblib has no hints
    """joblib's jobs as tasks of a Ray cluster, which does again what is lost with a machine.

    Ray's own backend for joblib is a pool of actors: it fails with the first machine that does.
    """

    supports_retrieve_callback = True

    def effective_n_jobs(self, n_jobs: int) -> int:
        import ray

        return n_jobs if n_jobs > 0 else max(1, int(ray.cluster_resources().get("CPU", 0)))

    def configure(self, n_jobs: int = 1, parallel: Any = None, **settings: Any) -> int:
        import ray

        def work(job: bytes) -> Any:  # travels as code: the machine may lack PackIt-Sim
            return pickle.loads(job)()

        self.parallel = parallel
        self._task = ray.remote(num_cpus=1, max_retries=MOST_LOSSES)(work)
        self._begun: set[Any] = set()
        self._ended: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        Thread(target=_call_each, args=(self._ended,), daemon=True).start()
        return self.effective_n_jobs(n_jobs)

    def submit(self, func: Callable[[], Any], callback: Callable[..., Any]) -> Future[Any]:
        from ray import cloudpickle

        begun, ended = self._begun, self._ended
        job = partial(_answer, __version__, cloudpickle.dumps(func))
        task = self._task.remote(cloudpickle.dumps(job))
        begun.add(task)

        def end(future: Future[Any]) -> None:
            begun.discard(task)
            ended.put(partial(callback, future))

        future: Future[Any] = task.future()
        future.add_done_callback(end)
        return future

    def retrieve_result_callback(self, out: Future[Any]) -> Any:
        """What a job returned. Raises what it raised, and WorkersError where it can't be done."""
        from ray.exceptions import RayError, RayTaskError

        try:
            return out.result()
        except RayTaskError as error:
            if isinstance(error.cause, ImportError):
                raise WorkersError(f"a machine of the cluster lacks it: {error.cause}") from error
            raise error.cause from error
        except RayError as error:
            why = str(error).partition("\n")[0]
            raise WorkersError(f"the cluster gave a job up: {why}") from error

    def abort_everything(self, ensure_ready: bool = True) -> None:
        import ray

        for task in self._begun.copy():
            ray.cancel(task, force=True)

    def terminate(self) -> None:
        self._ended.put(None)


def _call_each(calls: SimpleQueue[Callable[[], object] | None]) -> None:
    """Tells joblib, which then begins the next job, on a thread that Ray does not need."""
    for call in iter(calls.get, None):
        call()


def _answer(version: str, job: bytes) -> Any:
    """Does a job on a machine of the cluster. Errors that are the machine's say which it is."""
    try:
        if version != __version__:
            raise WorkersError(f"PackIt-Sim is {__version__} here, not {version}")
        return pickle.loads(job)()
    except (PackItError, ImportError) as error:
        raise WorkersError(f"{platform.node()}: {error}") from error


@contextmanager
def _reporting_killed_workers() -> Iterator[None]:
    try:
        yield
    except TerminatedWorkerError as error:
        raise WorkersError(
            "a worker process was killed, most often because memory was short: the same command "
            "goes on from here, if need be with fewer workers"
        ) from error


def _join_cluster(address: str | None) -> Callable[[], None]:
    """Joins a cluster, unless this process is in one already, and returns what leaves it."""
    try:
        import ray
    except ImportError as error:
        raise WorkersError(
            "the backend ray is not installed: pip install 'packit-sim[cluster]'"
        ) from error
    joblib.register_parallel_backend("ray", RayTasks)
    if ray.is_initialized():
        return lambda: None
    host, _, port = (address or "").rpartition(":")
    try:
        if port.isdigit():
            socket.create_connection((host.rpartition("/")[2], int(port)), CONNECT_SECONDS).close()
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (OSError, RuntimeError, ValueError) as error:
        raise WorkersError(f"no Ray cluster to join at {address!r}: {error}") from error
    return ray.shutdown
