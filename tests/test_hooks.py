"""Hooks into other libraries that these do not promise to keep: each still does its job."""

import asyncio
import os
import subprocess
import sys
from importlib.metadata import version
from typing import Literal, NamedTuple

import msgspec
import numba
import numpy as np
import pytest

from packit_sim.core import typed_json
from packit_sim.core.compilation import allocating_kernel, inner_kernel
from packit_sim.core.errors import PackFormatError

TRIED = {
    "msgspec": ("0.19.0", "0.20.0", "0.21.1", "0.22.0"),
    "numba": ("0.68.1",),
    "viser": ("1.1.1",),
    "websockets": ("16.1.1",),
}
"""The versions with which the tests below were run."""


@pytest.mark.parametrize("library", TRIED)
def test_the_installed_version_was_tried(library) -> None:
    if version(library) not in TRIED[library]:
        pytest.skip(
            f"{library} {version(library)} is new here: tried with {', '.join(TRIED[library])}; "
            "if the other tests of this file pass, add it to TRIED"
        )


KERNELS = """
import sys
from numba import njit
from packit_sim.core.compilation import stamp

@njit(cache=True)
def double(number):
    return 2 * number

stamp(double, sys.argv[1])
assert double(21) == 42
print(sum(double.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_numba_uses_cached_code_only_with_the_same_stamp(tmp_path) -> None:
    (tmp_path / "kernels.py").write_text(KERNELS, encoding="utf-8")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def hits(stamp: str) -> int:
        command = [sys.executable, str(tmp_path / "kernels.py"), stamp]
        run = subprocess.run(command, capture_output=True, check=True, env=environment, text=True)
        return int(run.stdout)

    assert [hits(stamp) for stamp in ("one", "one", "two", "two")] == [0, 1, 0, 1]


INNER = """
import numpy as np
from numba.core import event
from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel

compiled = []
class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())

@allocating_kernel
def scaled(values, factor):
    total = np.zeros(2)
    for value in values:
        total[0] += value * factor
    return total[0]

@inner_kernel
def sum_of(one, other):
    return one + other

@kernel
def both(values, factor):
    return sum_of(scaled(values, factor), sum_of(scaled(values, 2), 0.0))

names = ("both", "scaled", "sum_of")
print(both(np.ones(3), 5), [name for name in compiled if name in names])
"""


@pytest.mark.slow
def test_kernels_for_kernels_are_compiled_once_and_only_where_they_are_called(tmp_path) -> None:
    """A constant is an argument like others, and what is cached needs no inner kernel."""
    (tmp_path / "kernels.py").write_text(INNER, encoding="utf-8")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def output() -> str:
        command = [sys.executable, str(tmp_path / "kernels.py")]
        run = subprocess.run(command, capture_output=True, check=True, env=environment, text=True)
        return run.stdout

    assert output() == "21.0 ['both', 'scaled', 'sum_of']\n"
    assert output() == "21.0 []\n"
    assert len(list((tmp_path / "cache").rglob("*.nbc"))) == 1


class Pair(NamedTuple):
    """Two arrays."""

    one: np.ndarray
    two: np.ndarray


def rest(pair):
    return pair.one[1:]


def last(pair):
    return pair, pair.two[-1]


def total(pair):
    found = 0.0
    longer = pair.one
    for n in range(len(pair.one)):
        longer = pair.two if n % 2 else longer[:2]
        found += longer[0] * pair.two[n]
    return found


@pytest.mark.parametrize(("decorator", "counts"), [(inner_kernel, 0), (allocating_kernel, 1)])
def test_only_inner_kernels_count_no_references(decorator, counts) -> None:
    inner = decorator(total)

    @numba.njit
    def outer(pair):
        return inner(pair)

    assert outer(Pair(np.array([1.0, 3.0, 2.0]), np.array([1.0, 10.0, 100.0]))) == 111
    (code,) = inner.inspect_llvm().values()
    assert ("NRT_incref" in code) == counts


def gets_rest(pair):
    return len(ALLOCATING[0](pair))


def largest(pair):
    return pair.one.max()


def largest_by_numpy(pair):
    return np.max(pair.one)


def gets_last(pair):
    return ALLOCATING[1](pair)[1]


FAULT = "returns an array, or calls what creates one: make it an allocating_kernel"
ALLOCATING = allocating_kernel(rest), allocating_kernel(last)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (rest, "Only accept returning of array passed"),  # by numba
        (last, f"last {FAULT}"),
        (gets_rest, f"gets_rest {FAULT}"),
        (largest, f"largest {FAULT}"),
        (largest_by_numpy, f"largest_by_numpy {FAULT}"),
        (gets_last, f"gets_last {FAULT}"),
    ],
)
def test_inner_kernels_neither_return_arrays_nor_get_any_from_kernels(function, words) -> None:
    inner, pair = inner_kernel(function), Pair(np.arange(3.0), np.arange(3.0))
    outer = numba.njit(lambda pair: inner(pair))
    numba.njit(largest)(pair)  # else numba refuses to compile its own `max` without references
    with pytest.raises((TypeError, numba.TypingError), match=words):
        outer(pair)


class Record(msgspec.Struct, forbid_unknown_fields=True):
    name: Literal["a", "b"]
    sizes: tuple[float, ...] = ()
    count: int = 0


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{}", "field 'name' is missing"),
        ('{"name": "a", "nam": 1}', "field 'nam' is unknown"),
        ('{"name": "c"}', "field 'name' is 'c': choose from a, b"),
        ('{"name": "a", "sizes": [1, "x"]}', "field 'sizes[1]' is 'x': expected float, got str"),
        ('{"name": "a", "count": 1.5}', "field 'count' is 1.5: expected int, got float"),
        ("[]", "it must be a JSON object, not list"),
    ],
)
def test_messages_of_msgspec_are_understood(text, sentence) -> None:
    with pytest.raises(PackFormatError) as error:
        typed_json.decode(text, Record, PackFormatError)
    assert str(error.value) == sentence


def test_texts_that_no_field_reads_are_in_utf_8_too() -> None:
    with pytest.raises(PackFormatError, match="not text in UTF-8"):
        typed_json.format_of(b'{"format": "a", "note": "\xff"}', PackFormatError)


def test_viser_serves_by_the_function_that_is_guarded() -> None:
    pytest.importorskip("viser")
    from websockets.asyncio import client, server
    from websockets.exceptions import InvalidStatus

    from packit_sim.web.web_page import WebPage

    serve = server.serve
    page = WebPage()
    assert server.serve is serve

    async def connect() -> None:
        address = page.address.replace("http", "ws")
        async with client.connect(address, origin="http://elsewhere.example"):
            pass

    try:
        with pytest.raises(InvalidStatus) as refused:
            asyncio.run(connect())
        assert refused.value.response.status_code == 403
    finally:
        page.close()
