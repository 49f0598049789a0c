"""The compilation of kernels: once per installation, cached on disk, and announced."""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
from numba.core import event, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.types.misc import unliteral

from packit_sim.core.inner_compilation import InnerCompiler
from packit_sim.core.locks import lock
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.version import __version__

_log = plain_logger("packit_sim")

_IMPORTS = re.compile(r"^from packit_(?:sim|agents)[\w.]* import (\([^)]*\)|.*)", re.MULTILINE)
"""Finds the names that a module imports of this project."""

LOCK_SECONDS = 60.0
"""Maximum time to wait for another process that compiles; after it this process compiles too."""

POLL_SECONDS = 0.02
"""Time between two attempts to lock the file."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of numbers and arrays at its first call, without Python objects.

    Returns
    -------
    callable
        The compiled function.

    Notes
    -----
    The machine code is cached next to the module, or else in the user's cache folder (or
    `NUMBA_CACHE_DIR`), for as long as neither the module changes nor one that it imports: numba
    alone would keep using machine code that contains old kernels of other modules.
    Processes that need the same kernel wait for the first one to compile it. If
    no folder is writable, each process compiles again. With `NUMBA_DISABLE_JIT=1` the function is
    not compiled, so that a debugger can stop in it.
    """
    if numba.config.DISABLE_JIT:
        return function
    try:
        compiled = numba.njit(cache=True, nogil=True, _nrt=True)(function)
    except RuntimeError:  # numba found no folder that is writable
        compiled = numba.njit(nogil=True, _nrt=True)(function)
    else:
        stamp(compiled, _digest(function.__module__))
    return _one_at_a_time(compiled)


def inner_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for other kernels only, in a fraction of the time: together with them.

    Parameters
    ----------
    function : callable
        The function; Python can't call it. It has no cache: the kernels that call it contain it.
        It creates no arrays: it gets those that it works on, and it returns none, and neither
        does what it calls. Else numba says `NRT required`, or a TypeError is raised.

    Returns
    -------
    callable
        The compiled function.

    Notes
    -----
    numba counts references to the array of each view and each field of a tuple, by atomic
    instructions. In a search for strips these took a fourth of the time; here none are counted.
    """
    return _inner(function, allocates=False)


def allocating_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for other kernels only that creates arrays or returns any.

    Parameters
    ----------
    function : callable
        The function; in all else it is like an `inner_kernel`.

    Returns
    -------
    callable
        The compiled function.
    """
    return _inner(function, allocates=True)


def _inner(function: Callable[..., Any], allocates: bool) -> Any:
    if numba.config.DISABLE_JIT:
        return function
    options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": allocates}
    compiled = numba.njit(nogil=True, pipeline_class=InnerCompiler, **options)(function)
    return _one_at_a_time(compiled if allocates else _without_arrays(compiled))


def _without_arrays(compiled: Any) -> Any:
    """Raise if a kernel that counts no references returns an array, or gets one.

    It would be freed while it is used, or never. numba's own functions of arrays, such as `max`,
    may create some: whether they can then be compiled depends on who calls them first.
    """
    compile_new = compiled.compile

    def checked(signature: Any) -> Any:
        entry = compile_new(signature)
        made = compiled.overloads[signature]
        kinds, calls = made.type_annotation.typemap, made.type_annotation.calltypes
        steps = [(step, call) for step, call in calls.items() if getattr(step, "op", "") == "call"]
        is_fault = any(_may_create(kinds[step.func.name], call) for step, call in steps)
        if is_fault or _has_arrays(made.signature.return_type):
            name = f"{compiled.py_func.__module__}.{compiled.py_func.__name__}"
            raise TypeError(
                f"{name} returns an array, or calls what creates one: make it an allocating_kernel"
            )
        return entry

    compiled.compile = checked
    return compiled


def _may_create(callee: Any, call: Any) -> bool:
    """Return whether a function that is called may create an array."""
    if isinstance(callee, types.Dispatcher):
        return _has_arrays(call.return_type)
    if isinstance(callee, types.BoundFunction):
        return isinstance(callee.this, types.Array) and callee.typing_key != "array.reshape"
    is_numpys = getattr(getattr(callee, "typing_key", None), "__module__", None) == "numpy"
    return is_numpys and any(map(_has_arrays, call.args))


def _has_arrays(kind: Any) -> bool:
    parts = getattr(kind, "types", ())  # of a tuple
    return isinstance(kind, types.Array) or any(map(_has_arrays, parts))


def _one_at_a_time(compiled: Any) -> Any:
    """Let one process compile a kernel, and once for all values of a type, constants among them."""
    compile_or_load = compiled.compile

    def alone(signature: Any) -> Any:
        with global_compiler_lock, _lock(compiled.py_func.__module__):
            return compile_or_load(tuple(unliteral(one) for one in signature))

    compiled.compile = alone
    return compiled


def stamp(compiled: Any, digest: str) -> None:
    """Use numba's cached machine code of a kernel only if it was stored with the same digest.

    This is the one place that uses private names of numba: `_cache._cache_file._source_stamp` of a
    dispatcher, a digest of the kernel's own file until it is replaced here. No public setting does
    the same: `NUMBA_CACHE_LOCATOR_CLASSES` would also replace the stamps of users' functions.
    `tests/test_hooks.py` lists the versions with which it was tried.
    """
    if hasattr(compiled._cache, "_cache_file"):
        compiled._cache._cache_file._source_stamp = digest


@cache
def _digest(module: str) -> str:
    """Return a digest of the source of a module and of all that it imports of this project.

    A name counts as what it stands for, in the module that defines it: a face, such as `placement`,
    may offer it together with names that have nothing to do with kernels.
    """
    source = Path(sys.modules[module].__file__ or "").read_bytes()
    digest = hashlib.sha256(source)
    own = vars(sys.modules[module])
    for names in _IMPORTS.findall(source.decode()):
        for value in (own[name] for name in re.findall(r"\w+", names) if name in own):
            home = value.__name__ if isinstance(value, ModuleType) else _home(value)
            content = repr(value) if home is None else _digest(home)
            digest.update(content.encode())
    return digest.hexdigest()


def _home(value: object) -> str | None:
    """Return the module of this project that defines a value; None for constants."""
    home = getattr(value, "__module__", None)
    return home if str(home).partition(".")[0] in ("packit_sim", "packit_agents") else None


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a small function as a part of each kernel that calls it, which saves the calls.

    Parameters
    ----------
    function : callable
        The function; it has one `return`.

    Returns
    -------
    callable
        The function, for kernels.
    """
    return function if numba.config.DISABLE_JIT else numba.njit(inline="always")(function)


@cache  # once per process, where no file can be written
def announce() -> None:
    """Log that kernels are compiled, once per installation."""
    if _is_first():
        _log.warning("compiling the placement engine, once per installation: 30 s to 2 minutes")


def _probe() -> None:
    """Find the cache folder of this module."""


@cache
def kernel_folder() -> Path | None:
    """Return the folder of this module's cache; None if none is writable."""
    try:
        return Path(numba.njit(cache=True)(_probe).stats.cache_path)
    except RuntimeError:
        return None


class _ProcessLock:
    """A lock file for all processes that compile, only used by the holder of numba's lock.

    If the file can't be created, nothing is locked: compiling twice only costs time. It is not a
    `filelock`, whose lock around fork() would be taken before numba's, and within it here.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._depth = 0
        self._descriptor: int | None = None

    def __enter__(self) -> None:
        self._depth += 1
        if self._depth == 1:
            self._descriptor = self._locked()

    def __exit__(self, *raised: object) -> None:
        self._depth -= 1
        if self._depth == 0 and self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _locked(self) -> int | None:
        """Return the descriptor of the locked file."""
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None
        end = time.monotonic() + LOCK_SECONDS
        while time.monotonic() < end:
            try:
                lock(descriptor, wait=False)
                return descriptor
            except BlockingIOError:
                time.sleep(POLL_SECONDS)
            except OSError:  # a file system without locks
                break
        os.close(descriptor)
        return None


@cache
def _lock(module: str) -> AbstractContextManager[None]:
    """Return the lock of a module's kernels; those that it calls never call it."""
    folder = kernel_folder()
    return nullcontext() if folder is None else _ProcessLock(folder / f"{module}.lock")


def _is_first() -> bool:
    """Return whether this process is the first that compiles here, with these versions."""
    folder = kernel_folder()
    if folder is None:
        return True
    versions = f"{__version__}-{numba.__version__}-{sys.implementation.cache_tag}"
    try:
        (folder / f"packit-sim-{versions}.announced").touch(exist_ok=False)
    except FileExistsError:
        return False
    except OSError:
        return True
    return True


class _Announcement(event.Listener):  # type: ignore[misc] # numba's own hints are not read
    """Announces that kernels are compiled; loading cached ones is silent."""

    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"].py_func.__module__.startswith(("packit_sim", "packit_agents")):
            announce()

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcement())

if sys.platform != "win32":
    os.register_at_fork(  # a child would wait forever for a thread that was compiling
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )
