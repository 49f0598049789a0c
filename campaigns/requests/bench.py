"""A workbench in a separate process, and what is checked of it from outside."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from packit_sim.parts.packings.packing_files import verify_packing

LIMITS = {"MAX_FILES": 6, "MAX_BYTES": 20_000, "MAX_BYTES_TOGETHER": 40_000}
"""Limits of the workbench, small enough that requests meet them all the time."""

CLIENTS = 12
"""Threads that send requests."""

SECONDS = 60.0
"""Most seconds in which an answer comes, and in which a workbench that is left alone is at rest."""

SERVER = f"""
from packit_sim.cli import app
from packit_sim.parts.results import exports
from packit_sim.parts.workbench import uploads, workbench
vars(uploads).update({LIMITS!r})
exports.draw = lambda packing, path, keep_out: path.write_bytes(b"")
app.main()
"""
"""The command with these limits; its routes take files of any size, and draw no pictures."""

MEMORY = 400e6
"""Most bytes by which the memory may grow after the first rest."""


class Bench:
    """A running workbench.

    Attributes
    ----------
    host : str
        Its address and port.
    looks : int
        How often the watcher looked at its folder.
    rests : int
        How often it was checked at rest.
    samples : list of dict
        Its threads, descriptors and memory at each rest.
    """

    def __init__(self) -> None:
        self._tmp = tempfile.TemporaryDirectory(prefix="requests-")
        self._folder = Path(self._tmp.name)
        settings = {"TMPDIR": self._tmp.name, "COLUMNS": "400", "PYTHONUNBUFFERED": "1"}
        with (self._folder / "errors").open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVER, "workbench", "--no-browser"],
                env=os.environ | settings,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        assert self.process.stdout is not None
        self.host = self.process.stdout.readline().split("http://")[1].split()[0]
        (self._own,) = self._folder.glob("packit-workbench-*")
        self.looks = self.rests = 0
        self.samples: list[dict[str, int]] = []
        self._found: set[str] = set()
        self._is_over = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *raised: object) -> None:
        self._is_over.set()
        self.process.kill()
        self.process.communicate()
        self._watcher.join()
        self._tmp.cleanup()

    def ask(
        self, method: str, path: str, body: bytes | None = None
    ) -> tuple[int, bytes, dict[str, str]]:
        """Send a request on a new connection; wait while there are too many connections."""
        end = time.monotonic() + SECONDS
        while True:
            connection = http.client.HTTPConnection(self.host, timeout=SECONDS)
            try:
                connection.request(method, path, body)
                answer = connection.getresponse()
                found = answer.status, answer.read(), dict(answer.getheaders())
            except ConnectionError:
                found = 503, b"", {}
            finally:
                connection.close()
            if found[0] != 503 or time.monotonic() > end:
                return found
            time.sleep(0.05)

    def state(self) -> dict[str, Any]:
        """Ask for the whole state."""
        found: dict[str, Any] = json.loads(self.ask("GET", "/state?seen=-1")[1])
        return found

    def watched(self) -> list[str]:
        """Return what the watcher has found since the last call."""
        found, self._found = self._found, set()
        return sorted(found)

    def at_rest(self) -> list[str]:
        """Let the workbench come to rest, and return what is then wrong."""
        self.rests += 1
        end = time.monotonic() + SECONDS
        while (state := self.state())["busy"]:
            self.ask("POST", "/stop")
            if time.monotonic() > end:
                return ["it is still busy"]
            time.sleep(0.1)
        problems = list(self._results(state))
        for each in state["files"]:
            self.ask("POST", "/remove", json.dumps({"number": each["number"]}).encode())
        while (left := os.listdir(self._own / "parts")) and time.monotonic() < end:
            time.sleep(0.1)  # files that are still being sent
        if left:
            problems.append(f"{len(left)} files are left")
        if text := (self._folder / "errors").read_text():
            problems.append(f"it printed {text[-300:]!r}")
        self.samples.append(self._sample())
        first = self.samples[0]
        while time.monotonic() < end and self._grown(first):
            time.sleep(0.2)
        self.samples[-1] = self._sample()
        return problems + self._grown(first)

    def end(self) -> list[str]:
        """End the workbench by SIGTERM, and return what is wrong."""
        self._is_over.set()
        self._watcher.join()
        self.process.send_signal(signal.SIGTERM)
        try:
            code = self.process.wait(SECONDS)
        except subprocess.TimeoutExpired:
            return ["it did not end"]
        left = [name for name in os.listdir(self._folder) if name != "errors"]
        return [f"exit code {code}"] * (code != 143) + [f"{name} is left" for name in left]

    def _results(self, state: dict[str, Any]) -> list[str]:
        """Check the last result: what can be downloaded is what is on the disk, and verifies."""
        end = time.monotonic() + SECONDS
        while len(folders := list(self._own.glob("packing-*"))) > 1 and time.monotonic() < end:
            time.sleep(0.1)  # the result before is being removed
        names = state.get("result", {}).get("downloads", [])
        if len(folders) != bool(names):
            return [f"{len(folders)} folders of results, {len(names)} files to download"]
        problems = []
        for folder in folders:
            for name in names:
                status, data, _ = self.ask("GET", f"/files/{name}")
                if status != 200 or data != (folder / name).read_bytes():
                    problems.append(f"{name} is not the file of the result: {status}")
            found = verify_packing(folder / "packing.json").problems
            problems += [f"the result: {each.sentence}" for each in found]
        shown = state.get("result", {}).get("problems", [])
        return problems + [f"the result: {each}" for each in shown]

    def _sample(self) -> dict[str, int]:
        process = Path("/proc", str(self.process.pid))
        memory = int((process / "statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
        threads, files = (len(os.listdir(process / name)) for name in ("task", "fd"))
        return {"threads": threads, "descriptors": files, "memory": memory}

    def _grown(self, first: dict[str, int]) -> list[str]:
        """Return what the process holds more than at its first rest."""
        now = self._sample()
        found = [name for name in ("threads", "descriptors") if now[name] > first[name] + 2]
        found += ["memory"] * (now["memory"] > first["memory"] + MEMORY)
        return [f"{name}: {now[name]:,}, at first {first[name]:,}" for name in found]

    def _watch(self) -> None:
        """Look at the folder all the time."""
        while not self._is_over.is_set():
            self.looks += 1
            self._look()
            time.sleep(0.002)

    def _look(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            sizes = []
            for folder in os.listdir(self._own / "parts"):
                with contextlib.suppress(FileNotFoundError):
                    own = self._own / "parts" / folder
                    sizes += [(own / name).lstat().st_size for name in os.listdir(own)]
            if len(sizes) > LIMITS["MAX_FILES"] or sum(sizes) > LIMITS["MAX_BYTES_TOGETHER"]:
                self._found.add(f"{len(sizes)} files of {sum(sizes):,} bytes")
            outside = {name.partition("-")[0] for name in os.listdir(self._own)}
            outside |= set(os.listdir(self._folder)) - {self._own.name}
            self._found |= {f"{n} in the folder" for n in outside - {"parts", "packing", "errors"}}
