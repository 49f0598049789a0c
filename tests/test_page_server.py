"""The server of a local page: its connections and bodies, and its answers when they are wrong."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from packit_sim.core.errors import ArgumentError
from packit_sim.web import http_server, limited_server
from packit_sim.web.http_server import HttpRoute, HttpServer, WebAnswer, WebRequest

NEXT = b"GET /ok HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"


def _refuse(request: WebRequest) -> WebAnswer:
    raise ArgumentError("no")


def _echo(request: WebRequest) -> WebAnswer:
    return WebAnswer(request.body.read(), "text/plain")


@pytest.fixture(name="server")
def _server() -> Iterator[HttpServer]:
    routes = {
        ("GET", "/ok"): HttpRoute(lambda request: WebAnswer(b"fine", "text/plain")),
        ("POST", "/refused"): HttpRoute(_refuse, 1000),
        ("POST", "/ignored"): HttpRoute(lambda request: WebAnswer(b"", "text/plain"), 1000),
        ("POST", "/echo"): HttpRoute(_echo, 2**22),
    }
    server = HttpServer(routes)
    yield server
    server.close()


def connected(server: HttpServer) -> socket.socket:
    host, port = server.address.removeprefix("http://").split(":")
    return socket.create_connection((host, int(port)), timeout=20)


def post(path: str, body: bytes, *more: str) -> bytes:
    lines = (f"POST {path} HTTP/1.1", "Host: localhost", f"Content-Length: {len(body)}", *more)
    return "\r\n".join([*lines, "", ""]).encode() + body


def everything(connection: socket.socket) -> bytes:
    data = b""
    while more := connection.recv(65536):
        data += more
    return data


@pytest.mark.parametrize(
    ("request_", "statuses"),
    [
        (post("/refused", NEXT), [400]),
        (post("/ignored", NEXT), [200]),
        (post("/nothing", NEXT), [404]),
        (post("/ok", NEXT), [404]),
        (post("/refused", NEXT, "Content-Length: 3"), [400]),
        (post("/refused", NEXT, "Transfer-Encoding: chunked"), [411]),
        (post("/refused", NEXT, "Origin: http://evil.example"), [403]),
        (post("/refused", NEXT * 20), [413]),
        (b"NONSENSE / HTTP/1.1\r\nHost: localhost\r\n\r\n", [501]),
        (post("/echo", NEXT), [200, 200]),
        (NEXT.replace(b"Connection: close\r\n", b"Content-Length: 70\r\n"), [413]),
    ],
)
def test_a_body_that_is_not_read_is_never_the_next_request(server, request_, statuses) -> None:
    with connected(server) as connection:
        connection.sendall(request_ + NEXT)
        found = everything(connection)
    assert [int(part[:3]) for part in found.split(b"HTTP/1.1 ")[1:]] == statuses
    assert (b"fine" in found) == (statuses == [200, 200])


def test_a_large_body_that_is_refused_does_not_lose_the_answer(server) -> None:
    for _ in range(5):
        with connected(server) as connection:
            connection.sendall(b"POST /refused HTTP/1.1\r\nHost: localhost\r\n")
            connection.sendall(b"Content-Length: 4000000\r\n\r\n" + bytes(4_000_000))
            assert everything(connection).startswith(b"HTTP/1.1 413")


def test_connections_are_limited_and_their_places_used_again(server, monkeypatch) -> None:
    monkeypatch.setattr(limited_server, "MAX_CONNECTIONS", 8)
    held = [connected(server) for _ in range(8)]
    deadline = time.monotonic() + 10
    while True:
        with connected(server) as one_more:
            answer = one_more.recv(100)
        if answer.startswith(b"HTTP/1.1 503") or time.monotonic() > deadline:
            break
    assert answer.startswith(b"HTTP/1.1 503")
    held[0].sendall(NEXT)
    assert b"fine" in everything(held[0])
    for each in held:
        each.close()
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with connected(server) as again, contextlib.suppress(ConnectionError):
            again.sendall(NEXT)
            if b"fine" in everything(again):
                return
    pytest.fail("no place was free again")


def test_a_silent_connection_is_closed(monkeypatch) -> None:
    monkeypatch.setattr(http_server, "SILENT_SECONDS", 0.1)
    server = HttpServer({("POST", "/echo"): HttpRoute(_echo, 1000)})
    for sent in (b"", b"POST /echo HT", post("/echo", b"x" * 9)[:-3]):
        with connected(server) as connection:
            connection.sendall(sent)
            assert everything(connection) == b""
    server.close()


def test_no_other_page_can_show_it_and_it_loads_nothing_else(server) -> None:
    with connected(server) as connection:
        connection.sendall(NEXT)
        answer = everything(connection)
    for policy in (b"default-src 'none'", b"script-src 'self'", b"frame-ancestors 'none'"):
        assert policy in answer


def test_closing_ends_requests_that_are_being_received() -> None:
    server = HttpServer({("POST", "/echo"): HttpRoute(_echo, 1000)})
    before = threading.active_count()
    with connected(server) as connection:
        connection.sendall(b"POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nx")
        while threading.active_count() == before:
            time.sleep(0.01)
        start = time.monotonic()
        server.close()
        assert time.monotonic() - start < 4
    assert threading.active_count() < before


def test_a_connection_that_is_reset_prints_nothing(server, capfd) -> None:
    for sent in (b"", b"GET /ok HT", post("/echo", b"x" * 9)[:-3], NEXT):
        connection = connected(server)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        connection.sendall(sent)
        connection.close()
    with connected(server) as connection:
        connection.sendall(NEXT)
        assert b"fine" in everything(connection)
    time.sleep(0.1)
    assert capfd.readouterr() == ("", "")
