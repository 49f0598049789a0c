"""Addresses of local pages, and checks that a request comes from such a page.

Other pages in the same browser may send requests, too.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from collections.abc import Sequence
from urllib.parse import urlsplit

from packit_sim.core.errors import RenderError

LOOPBACK = "127.0.0.1"
"""The address that only this machine reaches."""

EVERYWHERE = "0.0.0.0"
"""The wildcard for all addresses of this machine."""

MAX_CONNECTIONS = 64
"""Most connections of a page's server at a time; a browser opens about six."""


def refused(host: str, port: int | None, reason: object) -> RenderError:
    """Return the error for a page that can't be served at a host and a port, 0 or None for any."""
    text = (reason.strerror if isinstance(reason, OSError) else None) or reason
    return RenderError(
        f"the page can't be served at host {host!r}, port {port or 'any'}: {text}; choose "
        "another port, or none for a free one, and a host of this machine"
    )


def is_own_host(asked: str, host: str) -> bool:
    """Return whether the `Host` of a request is this server's.

    Parameters
    ----------
    asked : str
        The request's `Host`.
    host : str
        The name or address at which the server listens.

    Returns
    -------
    bool
        Whether it is an address, "localhost" or a name of this machine: anyone may let their own
        domain name point to this server (DNS rebinding).
    """
    try:
        name = urlsplit(f"//{asked.lower()}").hostname or ""
    except ValueError:
        return False
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    own = {host, socket.gethostname(), socket.getfqdn()}
    return name == "localhost" or name in map(str.lower, own)


def is_own_page(origins: Sequence[str], hosts: Sequence[str], host: str) -> bool:
    """Return whether a request is of a page that this server served, or not of a page at all.

    Parameters
    ----------
    origins : sequence of str
        The request's headers `Origin`.
    hosts : sequence of str
        Its headers `Host`.
    host : str
        The name or address at which the server listens.

    Returns
    -------
    bool
        Whether there is no `Origin`, as of programs that are not browsers, or it is the request's
        `Host`, and that is this server's (see `is_own_host`).
    """
    if not origins:
        return True
    if len(origins) != 1 or len(hosts) != 1:
        return False
    try:
        page = urlsplit(origins[0].lower())
    except ValueError:
        return False
    is_same = page.scheme in ("http", "https") and page.netloc == hosts[0].lower()
    return is_same and is_own_host(hosts[0], host)
