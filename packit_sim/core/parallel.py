"""Parallel work: jobs on the cores of this machine or a Ray cluster, and Ray's actors."""

from __future__ import annotations

import logging
import os
import pickle
import platform
import socket
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar, get_args

import joblib
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import TerminatedWorkerError
from joblib.parallel import ParallelBackendBase

from packit_sim.core import compilation
from packit_sim.core.choices import BackendName, SearchBackend
from packit_sim.core.errors import PackItError
from packit_sim.core.extras import needed_for
from packit_sim.core.orphans import end_with, without_interrupts
from packit_sim.core.version import __version__

_T = TypeVar("_T")

BACKENDS: tuple[str, ...] = get_args(BackendName)

MAX_RETRIES = 20
"""Maximum retries of a job whose process or machine was lost; more suggest that it kills them."""

START_SECONDS = 120.0
"""Maximum time for all `Actors` to start: without a free core they would wait forever."""

CONNECT_SECONDS = 10.0
"""Maximum time for the head of a cluster to answer; Ray itself would try for minutes."""


class WorkersError(PackItError, ValueError):
    """Workers that can't be started with these arguments, or are lost for good."""


class Workers:
    """Processes for jobs; they start with the first job and end with the `with` block.

    Jobs that have not ended by then are stopped.

    Jobs are pure functions: a job that is lost with a machine of the cluster is repeated on another
    one, as soon as there is one.

    Parameters
    ----------
    count : int
        The number of processes; 0: one per core, in a cluster also on cores that join later, up to
        twice as many.
    backend : BackendName
        The backend that runs the processes: "loky" or "ray".
    address : str | None
        The address of the Ray cluster's head; None: the cluster that runs on this machine, or else
        a new one.

    Raises
    ------
    WorkersError
        If the workers can't be started, or not be replaced.
    MissingPackageError
        If the backend is "ray", and Ray is not installed.
    """

    def __init__(
        self, count: int = 0, backend: BackendName = "loky", address: str | None = None
    ) -> None:
        _check_backend(backend, BACKENDS, address)
        _check_count(count)
        is_ray = backend == "ray"
        self._leave = _join_cluster(address) if is_ray else lambda: None
        with joblib.parallel_config(backend):
            self.count = count or joblib.effective_n_jobs(-1)
        processes = max(2, self.count) if is_ray else self.count  # one would be this process
        self._settings = {"n_jobs": processes, "backend": backend, "batch_size": 1}
        self._settings["max_nbytes"] = None  # large arrays would arrive as read-only files
        if not is_ray:  # Ray ends its processes itself
            self._settings |= {"initializer": end_with, "initargs": (os.getpid(),)}
        self._ahead = self.count * (2 if is_ray and count == 0 else 1)
        self._parallel: joblib.Parallel | None = None
        self._unfinished: list[Generator[Any, None, None]] = []
        self._is_started = False

    def map(self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]) -> list[_T]:
        """Return the function's results for all arguments, in their order."""
        self._announce()
        if self._parallel is None:
            ahead = self._ahead if self._settings["backend"] == "ray" else "all"
            self._parallel = joblib.Parallel(
                return_as="generator", pre_dispatch=ahead, **self._settings
            ).__enter__()
        return list(self._results(self._parallel, function, arguments))

    def as_done(
        self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]
    ) -> Iterator[_T]:
        """Yield results as they finish, in any order; at most one job per worker is queued."""
        self._announce()
        parallel = joblib.Parallel(
            return_as="generator_unordered", pre_dispatch=self._ahead, **self._settings
        )
        yield from self._results(parallel, function, arguments)

    def _results(
        self,
        parallel: joblib.Parallel,
        function: Callable[..., _T],
        arguments: Iterable[tuple[Any, ...]],
    ) -> Iterator[_T]:
        """Start jobs, with the workers if there are none yet, and yield their results."""
        with _reporting_killed_workers():
            with without_interrupts():
                self._is_started = True
                results = parallel(joblib.delayed(function)(*each) for each in arguments)
                self._unfinished.append(results)
            try:
                for result in results:  # noqa: UP028 - it would close them, with a warning
                    yield result
            finally:
                self._end(results)

    def _end(self, results: Generator[Any, None, None]) -> None:
        """Stop the jobs that have not ended, unless the block's end or their reader's was first."""
        if results not in self._unfinished:
            return
        self._unfinished.remove(results)
        with suppress(KeyboardInterrupt), _silent_manager():
            results.throw(KeyboardInterrupt())

    def _announce(self) -> None:
        """Announce the compilation here: workers would print into the progress bars."""
        if self.count > 1:
            compilation.announce()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        with without_interrupts():
            for results in self._unfinished.copy():
                self._end(results)
            if self._parallel is not None:
                self._parallel.__exit__(*raised)
                self._parallel = None
            if self._is_started and self._settings["backend"] == "loky" and self.count > 1:
                _end_idle_processes()
                self._is_started = False
            self._leave()


@contextmanager
def _silent_manager() -> Iterator[None]:
    """Let joblib's thread that hands out jobs not print a `KeyError` while they are stopped.

    It forgets the jobs, but not their numbers, and looks these up if a worker was free.
    """
    before = threading.excepthook

    def hook(arguments: threading.ExceptHookArgs) -> None:
        name = arguments.thread and arguments.thread.name
        if (name, arguments.exc_type) != ("ExecutorManagerThread", KeyError):
            before(arguments)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


def _end_idle_processes() -> None:
    """End the processes that joblib keeps for five minutes, and remove their temporary folder.

    A process that multiprocessing started would wait for them when it ends.
    """
    executor = get_reusable_executor(reuse=True)
    end = getattr(executor, "terminate", executor.shutdown)  # joblib's, or loky's if there was none
    end()


class Threads:
    """Threads of this process, for jobs that mostly run compiled kernels.

    Parameters
    ----------
    count : int
        The number of threads; 0: one per core.

    Raises
    ------
    WorkersError
        If the number is not possible.
    """

    def __init__(self, count: int = 0) -> None:
        _check_count(count)
        self.count = count or joblib.effective_n_jobs(-1)
        self._pool = ThreadPoolExecutor(self.count)

    def map(self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]) -> list[_T]:
        """Return the function's results for all arguments, in their order."""
        return [each.result() for each in [self._pool.submit(function, *a) for a in arguments]]

    def __enter__(self) -> Threads:
        return self

    def __exit__(self, *raised: object) -> None:
        self._pool.shutdown(cancel_futures=True)  # those that an error or Ctrl-C left


def search_workers(count: int, backend: SearchBackend, address: str | None) -> Workers | Threads:
    """Return workers for searches: threads, or the processes of `Workers`.

    Parameters
    ----------
    count : int
        The number of workers; 0: one per core.
    backend : SearchBackend
        The backend that runs them.
    address : str | None
        The address of the Ray cluster's head.

    Returns
    -------
    Workers | Threads
        The workers.

    Raises
    ------
    WorkersError
        If the workers can't be started with these arguments.
    """
    check_search_workers(count, backend, address)
    return Workers(count, "ray", address) if backend == "ray" else Threads(count)


def check_search_workers(count: int, backend: SearchBackend, address: str | None) -> None:
    """Raise WorkersError if workers for searches can't be started with these arguments."""
    _check_backend(backend, get_args(SearchBackend), address)
    _check_count(count)


def _check_backend(backend: str, choices: Sequence[str], address: str | None) -> None:
    if backend not in choices:
        raise WorkersError(f"no backend {backend!r}: choose from {', '.join(choices)}")
    if address is not None and backend != "ray":
        raise WorkersError(f"address {address!r} needs the backend ray")


def _check_count(count: int) -> None:
    if count < 0:
        raise WorkersError(
            f"{count} workers are not possible: choose 1 or more, or 0 for one per core"
        )


class Actors:
    """Objects with state, each in a separate process of a Ray cluster.

    Parameters
    ----------
    kind : Callable[..., Any]
        Creates an object in its process.
    arguments : Sequence[tuple[Any, ...]]
        The arguments of `kind`, for each object.
    address : str | None
        The address of the cluster, as in `Workers`.

    Raises
    ------
    WorkersError
        If there is no cluster, if it has too few free cores, or if a process is lost: its state
        can't be restored.
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
            """An object's host. It is sent as code: the machine may lack PackIt-Sim."""

            def __init__(self, job: bytes) -> None:
                self.target = pickle.loads(job)()

            def call(self, method: str, args: Any, others: Any) -> Any:
                return getattr(self.target, method)(*args, **others)

        remote = ray.remote(num_cpus=1)(Actor)
        jobs = [cloudpickle.dumps(partial(kind, *each)) for each in arguments]
        self._actors: list[Any] = [
            remote.remote(cloudpickle.dumps(partial(_run_job, __version__, job))) for job in jobs
        ]
        self._running: list[Any] = []
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
        by_name: Sequence[dict[str, Any]] | None = None,
    ) -> None:
        """Start a method of each object, with arguments by position and by name; see `end`."""
        keywords = by_name or [{}] * len(arguments)
        self._running = [
            actor.call.remote(method, args, others)
            for actor, args, others in zip(self._actors, arguments, keywords, strict=True)
        ]

    def end(self) -> list[Any]:
        """Return the results of the started methods. Raises what they raise."""
        import ray
        from ray.exceptions import RayError, RayTaskError

        try:
            return list(ray.get(self._running))
        except RayTaskError as error:
            raise error.cause from error
        except RayError as error:
            why = str(error).partition("\n")[0]
            raise WorkersError(f"a process of the cluster was lost: {why}") from error

    def call(
        self,
        method: str,
        arguments: Sequence[tuple[Any, ...]],
        by_name: Sequence[dict[str, Any]] | None = None,
    ) -> list[Any]:
        """Call a method of each object: `begin` and `end`."""
        self.begin(method, arguments, by_name)
        return self.end()

    def close(self) -> None:
        """End the processes."""
        import ray

        for actor in self._actors:
            ray.kill(actor)
        self._actors = []
        self._leave()


class RayTasks(ParallelBackendBase):  # type: ignore[misc] # joblib has no hints
    """A joblib backend of Ray tasks; Ray repeats those that are lost with a machine.

    Ray's own joblib backend is a pool of actors: it fails as soon as one machine fails.
    """

    supports_retrieve_callback = True

    def effective_n_jobs(self, n_jobs: int) -> int:
        import ray

        return n_jobs if n_jobs > 0 else max(1, int(ray.cluster_resources().get("CPU", 0)))

    def configure(self, n_jobs: int = 1, parallel: Any = None, **settings: Any) -> int:
        import ray

        def work(job: bytes) -> Any:  # sent as code: the machine may lack PackIt-Sim
            return pickle.dumps(pickle.loads(job)())  # Ray's own copies of arrays are read-only

        self.parallel = parallel
        self._task = ray.remote(num_cpus=1, max_retries=MAX_RETRIES)(work)
        self._running: set[Any] = set()
        self._ended: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        Thread(target=_call_each, args=(self._ended,), daemon=True).start()
        return self.effective_n_jobs(n_jobs)

    def submit(self, func: Callable[[], Any], callback: Callable[..., Any]) -> Future[Any]:
        from ray import cloudpickle

        running, ended = self._running, self._ended
        job = partial(_run_job, __version__, cloudpickle.dumps(func))
        task = self._task.remote(cloudpickle.dumps(job))
        running.add(task)

        def end(future: Future[Any]) -> None:
            running.discard(task)
            ended.put(partial(callback, future))

        future: Future[Any] = task.future()
        future.add_done_callback(end)
        return future

    def retrieve_result_callback(self, out: Future[Any]) -> Any:
        """Return a job's result. Raises what it raised, or WorkersError if it can't run."""
        from ray.exceptions import RayError, RayTaskError

        try:
            return pickle.loads(out.result())
        except RayTaskError as error:
            if isinstance(error.cause, ImportError):
                raise WorkersError(
                    f"a module is missing on a machine of the cluster: {error.cause}"
                ) from error
            raise error.cause from error
        except RayError as error:
            why = str(error).partition("\n")[0]
            raise WorkersError(f"the cluster gave up a job: {why}") from error

    def abort_everything(self, ensure_ready: bool = True) -> None:
        import ray

        for task in self._running.copy():
            ray.cancel(task, force=True)

    def terminate(self) -> None:
        self._ended.put(None)


def _call_each(calls: SimpleQueue[Callable[[], object] | None]) -> None:
    """Call joblib's callbacks, which start the next jobs, on a thread that Ray does not need."""
    for call in iter(calls.get, None):
        call()


def _run_job(version: str, job: bytes) -> Any:
    """Run a job on a machine of the cluster. The machine's errors contain its name."""
    try:
        if version != __version__:
            raise WorkersError(f"PackIt-Sim has version {__version__} here, not {version}")
        return pickle.loads(job)()
    except (PackItError, ImportError) as error:
        raise WorkersError(f"{platform.node()}: {error}") from error


@contextmanager
def _reporting_killed_workers() -> Iterator[None]:
    try:
        yield
    except TerminatedWorkerError as error:
        raise WorkersError(
            "a worker process was killed, most often because memory was short: repeat the "
            "command to resume, with fewer workers if necessary"
        ) from error


def _join_cluster(address: str | None) -> Callable[[], None]:
    """Join a cluster, unless this process is in one, and return the function that leaves it."""
    with needed_for("workers of the backend ray"):
        import ray
    joblib.register_parallel_backend("ray", RayTasks)
    if ray.is_initialized():
        return lambda: None
    host, _, port = (address or "").rpartition(":")
    try:
        if port.isdigit():
            socket.create_connection((host.rpartition("/")[2], int(port)), CONNECT_SECONDS).close()
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (OSError, RuntimeError, ValueError) as error:
        raise WorkersError(f"there is no Ray cluster at {address!r}: {error}") from error
    return ray.shutdown
