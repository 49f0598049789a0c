"""Local web pages that commands serve until Ctrl-C."""

from __future__ import annotations

import os
import time
import webbrowser
from contextlib import suppress
from typing import Annotated

import typer

from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.web.origins import LOOPBACK

with lazy_imports():
    from packit_sim.cli import terminal

HostOption = Annotated[
    str, typer.Option(help="Address to listen on; 0.0.0.0 allows other machines.")
]

PortOption = Annotated[
    int | None, typer.Option(min=1, max=65535, help="Port to listen on; default: a free one.")
]

BrowserOption = Annotated[
    bool, typer.Option(help="Open the page in the browser, if there is a screen.")
]

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Set where a browser can open a window."""


def serve_until_interrupt(what: str, address: str, host: str, browser: bool) -> None:
    """Print the address of a page, open it, and wait for Ctrl-C.

    Parameters
    ----------
    what : str
        The content of the page.
    address : str
        The page's URL.
    host : str
        The address at which its server listens.
    browser : bool
        Whether a browser opens it, if there is a screen.
    """
    has_screen = any(os.environ.get(name) for name in _DISPLAYS)
    with suppress(KeyboardInterrupt):
        terminal.console.print(f"{what} is shown at {address} until Ctrl-C", soft_wrap=True)
        if host == LOOPBACK and not has_screen:
            number = address.rpartition(":")[2]
            terminal.console.print(
                "there is no screen here: open the address in a browser on this machine, or on "
                f"yours after ssh -L {number}:{LOOPBACK}:{number} THIS_MACHINE",
                soft_wrap=True,
            )
        elif browser and has_screen:
            webbrowser.open(address)
        while True:  # an Event has a lock, which two signals at once would release twice
            time.sleep(3600)
