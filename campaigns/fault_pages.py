"""The workbench as a command of the campaign of faults: a client orders and reads two packings.

The temporary files of the process, and so all files of the workbench, are in the folder that is
disturbed. Nothing may be left in it at the end, or after the next start.
"""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaigns.disturbed import OUT, Command
from packit_sim.cli.app import main
from packit_sim.parts.results.verification import verify_record

SECONDS = 100.0
"""Most seconds in which an order is answered."""

FOLDERS = "packit-workbench-*"
"""The temporary folders of workbenches."""


@dataclass(frozen=True)
class PageCommand(Command):
    """`packit workbench`, to which a client in the same process sends meshes and two orders."""

    serves: bool = True

    def run(self, workers: int = 1, arguments: Iterable[str] | None = None) -> None:
        """Run the workbench until its client is done, in the working directory."""
        tempfile.tempdir = str(Path(OUT).absolute())
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        client = _Client(port)
        client.start()
        signal.signal(signal.SIGINT, signal.default_int_handler)  # shells may ignore it
        sys.argv = ["packit", "workbench", "--no-browser", "--port", str(port)]
        try:
            main()
        except SystemExit as end:
            if not client.is_done:
                raise
            if client.refusal:
                print(f"error: {client.refusal}", file=sys.stderr)
                end.code = 2
            elif client.problem:
                print(client.problem, file=sys.stderr)
                end.code = 3
            raise
        finally:
            tempfile.tempdir = None


class _Client(threading.Thread):
    """Sends meshes and orders, and reads what the page offers.

    Attributes
    ----------
    refusal : str
        What the page said that was not possible.
    problem : str
        What is wrong with the page.
    """

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self._port = port
        self.refusal = self.problem = ""
        self.is_done = False

    def run(self) -> None:
        try:
            self._work()
        except (ConnectionError, http.client.HTTPException):  # the workbench was ended
            return
        except Exception as error:
            self.problem = f"{type(error).__name__}: {error}"
        self.is_done = True
        os.kill(os.getpid(), signal.SIGINT)

    def _work(self) -> None:
        files = []
        for file in sorted(Path("meshes").iterdir()):
            answer = self._ask("POST", f"/parts?name={file.name}", file.read_bytes())
            if "number" not in answer:
                self.refusal = f"{answer['error']}, in {OUT}/"  # it names the file alone
                continue
            files.append({"number": answer["number"], "count": 1, "rotations": "fixed"})
        for n in (2, 3):
            order = {"box": [{"size": "4x4x4"}], "unit": "mm", "seconds": 0.05, "files": files[:n]}
            answer = self._ask("POST", "/pack", json.dumps(order).encode())
            if "error" in answer:
                self.refusal = self.refusal or answer["error"]
                continue
            state = self._rest()
            if state["message"].startswith("error: "):
                self.refusal = state["message"].removeprefix("error: ")
            elif not state["message"].startswith("done"):
                self.problem = state["message"]
            self._check(state.get("result", {}).get("downloads", []))

    def _rest(self) -> dict[str, Any]:
        """Wait until no search is running."""
        end = time.monotonic() + SECONDS
        while (state := self._ask("GET", "/state?seen=-1"))["busy"]:
            if time.monotonic() > end:
                raise TimeoutError("the page is still busy")
            time.sleep(0.01)
        return state

    def _check(self, names: list[str]) -> None:
        """Check that the result that is offered is there, and verifies."""
        for name in names:
            if not self._raw("GET", f"/files/{name}"):
                self.problem = f"{name} is offered, but not there"
        if names:
            folder = max(_own_folder().glob("packing-*"))  # others are being removed
            report = verify_record(folder / "packing.json")
            if report.problems or report.unchecked:
                self.problem = f"the result: {[*report.problems, report.not_judged][0]}"

    def _ask(self, method: str, path: str, body: bytes | None = None) -> Any:
        return json.loads(self._raw(method, path, body))

    def _raw(self, method: str, path: str, body: bytes | None = None) -> bytes:
        end = time.monotonic() + SECONDS
        while True:
            connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=SECONDS)
            try:
                connection.request(method, path, body)
                answer = connection.getresponse()
                data = answer.read()
                return data if answer.status in (200, 400, 409, 422) else b""
            except ConnectionRefusedError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.01)
            finally:
                connection.close()


def _own_folder() -> Path:
    """Return the temporary folder of the workbench in this process, which keeps it open."""
    descriptors = Path("/proc/self/fd")
    opened = (os.path.realpath(descriptors / name) for name in os.listdir(descriptors))
    return next(Path(path) for path in opened if Path(path).match(FOLDERS))
