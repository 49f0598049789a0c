"""Requests to a workbench, as its page sends them."""

import http.client
import json
import time
from collections.abc import Callable
from typing import Any
from urllib.parse import quote

import trimesh

from packit_sim.parts.workbench.workbench import Workbench

ORDER = {"box": [{"size": "20x10x15"}], "unit": "mm", "seconds": 1.0, "clearance": "0.5"}


def ask(
    bench: Workbench, method: str, path: str, body: bytes | None = None, **headers: str
) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(bench.address.removeprefix("http://"), timeout=60)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


def post(bench: Workbench, path: str, value: Any) -> tuple[int, Any]:
    status, data = ask(bench, "POST", path, json.dumps(value).encode())
    return status, json.loads(data)


def send(bench: Workbench, name: str, mesh: trimesh.Trimesh) -> int:
    status, data = ask(bench, "POST", f"/parts?name={quote(name)}", stl(mesh))
    assert status == 200, data
    number: int = json.loads(data)["number"]
    return number


def stl(mesh: trimesh.Trimesh) -> bytes:
    return bytes(mesh.export(file_type="stl"))


def state(bench: Workbench, seen: int = -1) -> dict[str, Any]:
    status, data = ask(bench, "GET", f"/state?seen={seen}")
    assert status == 200
    found: dict[str, Any] = json.loads(data)
    return found


def wait(bench: Workbench, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    deadline = time.monotonic() + 200
    while not holds(found := state(bench)):
        assert time.monotonic() < deadline, found["message"]
        time.sleep(0.1)
    return found


def is_done(found: dict[str, Any]) -> bool:
    return not found["busy"] and bool(found.get("result", {}).get("downloads"))
