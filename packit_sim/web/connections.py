"""Checks of a page server's connections: of the page that opens one, and of its messages.

Any page in a browser may open a WebSocket to any server. The browser sends the page's `Origin`:
without a check of it, every page that is open in the same browser could read the scene.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterator
from http import HTTPStatus
from typing import Any

from websockets.asyncio import server
from websockets.http11 import Request, Response

from packit_sim.core.plain_text import plain_logger
from packit_sim.web.origins import MAX_CONNECTIONS, is_own_page

_INVALID = 1007
"""The code with which a WebSocket closes after a malformed message (RFC 6455)."""

_SCHEME = b"""<script>
if (matchMedia("(prefers-color-scheme: dark)").matches) {
  const query = new URLSearchParams(location.search);
  query.set("darkMode", "");
  history.replaceState(null, "", `?${query}`);
}
</script>"""
"""Lets viser's page be dark where the system is: viser only reads its address."""

_log = plain_logger(__name__)

ConnectionHandler = Callable[[server.ServerConnection], Awaitable[None]]


@contextlib.contextmanager
def guarded(host: str, protocol: str) -> Iterator[list[int]]:
    """Guard the WebSocket servers that start within the block, and let pages follow the system.

    This is the one place that replaces a function of another library: viser calls
    `websockets.asyncio.server.serve` by that name and lets nobody check requests. While the block
    runs, the name stands for a function that checks them first. `tests/test_hooks.py` lists the
    versions with which it was tried.

    Parameters
    ----------
    host : str
        The name or address at which the server listens.
    protocol : str
        The subprotocol that clients must speak.

    Yields
    ------
    list of int
        Grows with each server that is guarded.
    """
    serve = server.serve
    started: list[int] = []

    def guarded_serve(
        handler: ConnectionHandler, *place: Any, process_request: Any, **settings: Any
    ) -> Any:
        def checked(connection: server.ServerConnection, request: Request) -> Response | None:
            headers = request.headers
            origins, hosts = headers.get_all("Origin"), headers.get_all("Host")
            if not is_own_page(origins, hosts, host):
                return connection.respond(HTTPStatus.FORBIDDEN, "not a page of this server\n")
            if len(connection.server.connections) >= MAX_CONNECTIONS:
                return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections\n")
            if "Accept-Encoding" in headers:
                del headers["Accept-Encoding"]  # the page is changed, and hardly compressible
            answer: Response | None = process_request(connection, request)
            if answer is not None and answer.status_code == HTTPStatus.OK:
                answer.body = answer.body.replace(b"<head>", b"<head>" + _SCHEME, 1)
                del answer.headers["Content-Length"]
                answer.headers["Content-Length"] = str(len(answer.body))
            return answer

        started.append(1)
        return serve(_quiet(handler, protocol), *place, process_request=checked, **settings)

    server.serve = guarded_serve  # type: ignore[assignment, misc] # viser calls it by this name
    try:
        yield started
    finally:
        server.serve = serve  # type: ignore[misc]


def _quiet(handler: ConnectionHandler, protocol: str) -> ConnectionHandler:
    """Let a handler close a connection that fails, with one line in the log."""

    async def handle(connection: server.ServerConnection) -> None:
        asyncio.get_running_loop().set_exception_handler(_report)
        if connection.subprotocol != protocol:
            _log.warning("the viewer refused a client that does not speak %s", protocol)
            await connection.close(_INVALID, f"this server speaks {protocol}")
            return
        try:
            await handler(connection)
        except Exception as error:  # a client's message may make the server raise anything
            _log.warning("the viewer closed a connection after a malformed message: %r", error)
            await connection.close(_INVALID, "not a message of this page")

    return handle


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log what a task of the server's loop raised, in one line."""
    _log.warning("viewer: %s: %r", context.get("message"), context.get("exception"))
