"""A server of HTTP with a limited number of connections, which answers before it closes one."""

from __future__ import annotations

import socket
import sys
import threading
import time
from contextlib import suppress
from http.server import ThreadingHTTPServer
from typing import Any

from packit_sim.core.plain_text import plain_logger
from packit_sim.web.origins import MAX_CONNECTIONS

_LINGER = 1.0
"""Most seconds in which a connection that is closed still takes what its client sends: otherwise
the system would reset it, and the client might lose the answer."""

_CLOSING = 5.0
"""Most seconds in which the requests that are being answered may end when the server closes."""

_CHUNK = 2**20

_FULL = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"

_log = plain_logger(__name__)


class LimitedServer(ThreadingHTTPServer):
    """Serves a limited number of connections, each in its own thread."""

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, *settings: Any) -> None:
        self._open: set[socket.socket] = set()
        self._changed = threading.Condition()
        super().__init__(*settings)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection, unless there are too many."""
        with self._changed:
            if is_full := len(self._open) >= MAX_CONNECTIONS:
                _log.debug("refused a connection: there are %d already", MAX_CONNECTIONS)
            else:
                self._open.add(request)
        if is_full:
            with suppress(OSError):
                request.sendall(_FULL)
            self.close_request(request)
        else:
            super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection so that its client gets the answer, whatever it is still sending."""
        with suppress(OSError):
            request.shutdown(socket.SHUT_WR)
            request.settimeout(_LINGER)
            end = time.monotonic() + _LINGER
            while request.recv(_CHUNK) and time.monotonic() < end:
                pass
        self.close_request(request)

    def close_request(self, request: Any) -> None:
        """Close a connection, and give its place to another one."""
        super().close_request(request)
        with self._changed:
            self._open.discard(request)
            self._changed.notify_all()

    def end_connections(self) -> None:
        """Let all connections end, and wait for their threads, though not for ever."""
        with self._changed:
            for each in self._open:
                with suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
            self._changed.wait_for(lambda: not self._open, _CLOSING)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log what ended a connection; by default a traceback is printed."""
        _log.debug("a connection ended early: %r", sys.exc_info()[1])
