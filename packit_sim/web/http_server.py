"""A small web server for one local page: routes, limited bodies, no requests from other pages."""

from __future__ import annotations

import io
import json
import os
import shutil
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any, BinaryIO
from urllib.parse import parse_qs, unquote, urlsplit

from packit_sim.core.errors import PackItError
from packit_sim.core.plain_text import plain_logger
from packit_sim.web.limited_server import LimitedServer
from packit_sim.web.origins import EVERYWHERE, LOOPBACK, is_own_host, is_own_page, refused

SILENT_SECONDS = 60.0
"""Timeout of a silent connection."""

_CHUNK = 2**20

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

_log = plain_logger(__name__)


class RequestError(PackItError, ValueError):
    """A request that can't be answered.

    Parameters
    ----------
    message : str
        The reason.
    status : HTTPStatus
        The status of the answer.
    """

    def __init__(self, message: str, status: HTTPStatus = HTTPStatus.BAD_REQUEST) -> None:
        super().__init__(message)
        self.status = status


class RequestBody:
    """The body of a request, of which never more is read than its length.

    Attributes
    ----------
    left : int
        Bytes that are not read.
    """

    def __init__(self, source: io.BufferedIOBase, length: int) -> None:
        self._source = source
        self.left = length

    def read(self, size: int = sys.maxsize) -> bytes:
        """Read at most so many bytes; less only if the client has sent no more."""
        data = self._source.read(min(size, self.left))
        self.left -= len(data)
        return data


@dataclass(frozen=True)
class WebRequest:
    """A request of a page.

    Attributes
    ----------
    path : str
        The path after that of the route, decoded.
    query : mapping of str to str
        The values behind the question mark.
    """

    path: str
    query: Mapping[str, str]
    body: RequestBody


@dataclass(frozen=True)
class WebAnswer:
    """The answer to a request.

    Attributes
    ----------
    data : bytes or BinaryIO
        The content, or an open file that has it, which is closed when it is sent.
    type : str
        The media type.
    headers : mapping of str to str
        Further headers.
    """

    data: bytes | BinaryIO
    type: str
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_json(cls, value: Any) -> WebAnswer:
        """Return a value as JSON."""
        return cls(json.dumps(value, ensure_ascii=False).encode(), "application/json")


@dataclass(frozen=True)
class HttpRoute:
    """The handler of the requests to a path.

    Attributes
    ----------
    answer : callable
        Returns the answer to a request; raises PackItError for one clear sentence instead.
    max_body_bytes : int
        Maximum size of a request's body.
    """

    answer: Callable[[WebRequest], WebAnswer]
    max_body_bytes: int = 0


class HttpServer:
    """A server in its own thread. Close it; it ends with the process.

    Parameters
    ----------
    routes : mapping of (str, str) to HttpRoute
        The routes by method and path; a path that ends with "/" stands for all paths below it.
    host : str
        The IPv4 address or name to listen at: everyone who can reach it can use the page.
    port : int, optional
        1 to 65535, by default a free one.

    Attributes
    ----------
    address : str
        The page's URL for a browser on this machine.

    Raises
    ------
    RenderError
        If the host and the port are not available.
    """

    def __init__(
        self,
        routes: Mapping[tuple[str, str], HttpRoute],
        host: str = LOOPBACK,
        port: int | None = None,
    ) -> None:
        class Handler(_Handler):
            own_host = host
            own_routes = routes
            timeout = SILENT_SECONDS

        try:
            self._server = LimitedServer((host, port or 0), Handler)
        except (OSError, OverflowError) as error:
            raise refused(host, port, error) from error
        shown = LOOPBACK if host == EVERYWHERE else host
        self.address = f"http://{shown}:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the server and its connections."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._server.end_connections()


class _Handler(BaseHTTPRequestHandler):
    own_host: str
    own_routes: Mapping[tuple[str, str], HttpRoute]
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:  # the name that http.server calls
        """Answer a request."""
        self._respond()

    def do_POST(self) -> None:
        """Answer a request."""
        self._respond()

    def _respond(self) -> None:
        self._body: RequestBody | None = None
        try:
            answer = self._answer()
        except RequestError as error:
            self._fail(error.status, str(error))
        except PackItError as error:
            self._fail(HTTPStatus.BAD_REQUEST, str(error))
        except (ConnectionError, TimeoutError) as error:
            self.close_connection = True
            _log.debug("a request was not received: %s", error)
        except Exception as error:
            _log.exception("a request failed")
            self._fail(HTTPStatus.INTERNAL_SERVER_ERROR, f"unexpected error: {error!r}")
        else:
            self._send(HTTPStatus.OK, answer)

    def _answer(self) -> WebAnswer:
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or not is_own_host(hosts[0], self.own_host):
            raise RequestError("not a host of this server", HTTPStatus.FORBIDDEN)
        if not is_own_page(self.headers.get_all("Origin") or [], hosts, self.own_host):
            raise RequestError("not a page of this server", HTTPStatus.FORBIDDEN)
        try:
            url = urlsplit(self.path)
        except ValueError:
            raise RequestError("not an address of this server") from None
        folder = url.path[: url.path.rfind("/") + 1]
        name = url.path[len(folder) :]
        route = self.own_routes.get((self.command, url.path))
        if route is None and folder != "/":
            route = self.own_routes.get((self.command, folder))
        if route is None:
            raise RequestError(f"there is no {url.path}", HTTPStatus.NOT_FOUND)
        length = self._length()
        if length > route.max_body_bytes:
            raise RequestError(
                f"{length:,} bytes are too many: at most {route.max_body_bytes:,}",
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            )
        query = {key: values[-1] for key, values in parse_qs(url.query).items()}
        self._body = RequestBody(self.rfile, length)
        return route.answer(WebRequest(unquote(name), query, self._body))

    def _length(self) -> int:
        """Return the length of the body."""
        if "Transfer-Encoding" in self.headers:
            raise RequestError("a body needs its length", HTTPStatus.LENGTH_REQUIRED)
        texts = self.headers.get_all("Content-Length") or ["0"]
        text = texts[0]
        if len(texts) > 1 or not (text.isascii() and text.isdigit()) or len(text) > 15:
            raise RequestError(f"a body can't have the length {', '.join(texts)!r}")
        return int(text)

    def _fail(self, status: HTTPStatus, message: str) -> None:
        answer = WebAnswer.of_json({"error": message})
        self._send(status, answer)

    def _send(self, status: HTTPStatus, answer: WebAnswer) -> None:
        if self._body is None or self._body.left:  # would be taken for the next request
            self.close_connection = True
        data = answer.data
        with io.BytesIO(data) if isinstance(data, bytes) else data as source:
            length = source.seek(0, os.SEEK_END)
            source.seek(0)
            try:
                self.send_response(status)
                for name, value in {**_HEADERS, **answer.headers}.items():
                    self.send_header(name, value)
                self.send_header("Content-Type", answer.type)
                self.send_header("Content-Length", str(length))
                if self.close_connection:
                    self.send_header("Connection", "close")
                self.end_headers()
                shutil.copyfileobj(source, self.wfile, _CHUNK)
            except OSError as error:
                self.close_connection = True
                _log.debug("an answer was not sent: %s", error)

    def log_message(self, format: str, *args: Any) -> None:
        """Log a request; by default http.server prints it."""
        _log.debug(format, *args)
