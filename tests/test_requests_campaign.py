"""The campaign of requests finds planted defects, and its page has its results."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from campaigns.common import read_results, table_in_page
from campaigns.requests import bench as bench_module
from campaigns.requests.__main__ import run, table
from campaigns.requests.kinds import KINDS, Broken


@contextmanager
def naive_server() -> Iterator[str]:
    """A server that takes the body of a refused request for the next one."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with connection:
                    connection.settimeout(0.3)
                    data = b""
                    try:
                        while more := connection.recv(65536):
                            data += more
                    except TimeoutError:
                        pass
                    for _ in range(data.count(b" HTTP/1.1\r\n")):
                        connection.sendall(b"HTTP/1.1 404 no\r\n\r\n{}")

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
    thread.join()


def test_a_request_that_is_hidden_in_a_body_is_found() -> None:
    with naive_server() as host:
        bench: Any = SimpleNamespace(host=host)
        for name in ("request in a refused body", "wrong length"):
            with pytest.raises(Broken, match="2 answers"):
                KINDS[name].send(bench, np.random.default_rng(0), "m")


def test_answers_that_are_not_right_are_found() -> None:
    state = {"files": [{"number": 5}]}
    for name, answer in (
        ("upload", (422, b"other.stl: too large", {})),
        ("upload that can't be read", (200, b"{}", {})),
        ("upload with a path", (500, b"m", {})),
        ("removal", (400, b"there is no file 6", {})),
        ("order", (500, b"error", {})),
        ("order that can't be read", (200, b"{}", {})),
        ("stop", (404, b"", {})),
        ("poll", (200, b"[]", {})),
        ("download", (200, b"{}", {"Content-Disposition": "another"})),
    ):
        bench: Any = SimpleNamespace(ask=lambda *_, found=answer: found, state=lambda: state)
        with pytest.raises(Broken):
            KINDS[name].send(bench, np.random.default_rng(0), "m")


@pytest.mark.slow
def test_the_workbench_keeps_its_promises_and_a_missing_limit_is_found(monkeypatch) -> None:
    results = run(150, 7)
    assert results["problems"] == []
    assert "| all requests |  | 150 |  | 0 |" in table(results)
    no_limits = bench_module.SERVER.replace(repr(bench_module.LIMITS), "{}")
    monkeypatch.setattr(bench_module, "SERVER", no_limits)
    problems = run(150, 7)["problems"]
    assert any(problem.startswith("at all times: ") for problem in problems)


def test_the_page_has_the_results() -> None:
    results = read_results("requests")
    assert json.loads(json.dumps(results))["requests"] >= 10_000
    assert table_in_page("requests").strip() == table(results).strip()
