"""Kinds of requests, good and bad, each of which knows the answers that are right."""

from __future__ import annotations

import io
import json
import socket
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np
from trimesh import creation

from campaigns.requests.bench import LIMITS, SECONDS, Bench


class Broken(Exception):
    """An answer that is not right."""


Sender = Callable[[Bench, np.random.Generator, str], None]


@dataclass(frozen=True)
class Kind:
    """A kind of request, what is promised, and a function that sends it and checks the answer."""

    promise: str
    send: Sender


def _mesh(rng: np.random.Generator) -> bytes:
    if rng.random() < 0.3:
        return bytes(creation.icosphere(2, float(rng.integers(3, 9))).export(file_type="stl"))
    return bytes(creation.box(rng.integers(3, 12, 3)).export(file_type="stl"))


def _expect(status: int, allowed: tuple[int, ...], data: bytes, mark: str = "") -> None:
    if status not in allowed or (status >= 400 and mark.encode() not in data):
        raise Broken(f"{status} {data[:200]!r}, for {mark!r}")


def _number(bench: Bench, rng: np.random.Generator) -> int:
    files = bench.state()["files"]
    return int(rng.choice([each["number"] for each in files])) if files else 1


def _upload(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    status, data, _ = bench.ask("POST", f"/parts?name={mark}.stl", _mesh(rng))
    _expect(status, (200, 422), data, mark)


def _broken_upload(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    data = _mesh(rng)
    name, data = [
        (f"{mark}.exe", data),
        (f"{mark}.stl", data[: len(data) // 2]),
        (f"{mark}.stl", rng.bytes(300)),
        (f"{mark}.stl", rng.bytes(LIMITS["MAX_BYTES"] + 1)),
        (f"{mark}.3mf", data),
    ][rng.integers(5)]
    status, found, _ = bench.ask("POST", f"/parts?name={quote(name)}", data)
    _expect(status, (422,), found, mark)


def _outside(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    name = rng.choice(["../", "../../", "/tmp/", "..\\", "C:\\", "a/../../"]) + mark
    status, data, _ = bench.ask("POST", f"/parts?name={quote(name, safe='')}.stl", _mesh(rng))
    _expect(status, (200, 422), data, mark)
    status, data, _ = bench.ask("GET", f"/files/{quote('../parts/' + mark, safe='')}")
    _expect(status, (404,), data, mark)


def _connected(bench: Bench) -> socket.socket:
    host, port = bench.host.split(":")
    return socket.create_connection((host, int(port)), timeout=SECONDS)


def _head(bench: Bench, line: str, *lines: str) -> bytes:
    return "\r\n".join([f"{line} HTTP/1.1", f"Host: {bench.host}", *lines, "", ""]).encode()


def _answers(connection: socket.socket) -> list[bytes]:
    """Read answers until the server closes the connection; none if it has reset it."""
    data = b""
    try:
        while more := connection.recv(65536):
            data += more
    except ConnectionError:
        pass
    return data.split(b"HTTP/1.1 ")[1:]


def _in_pieces(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    data = _mesh(rng)
    more = (f"Content-Length: {len(data)}", "Connection: close")
    with _connected(bench) as connection:
        try:
            connection.sendall(_head(bench, f"POST /parts?name={mark}.stl", *more))
            for piece in np.array_split(np.frombuffer(data, np.uint8), int(rng.integers(2, 6))):
                connection.sendall(piece.tobytes())
                time.sleep(rng.uniform(0, 0.05))
        except ConnectionError:
            return  # refused meanwhile
        answers = _answers(connection)
    if len(answers) > 1:
        raise Broken(f"{len(answers)} answers")
    for answer in answers:
        if not answer.startswith(b"503"):
            _expect(int(answer[:3]), (200, 422), answer, mark)


def _aborted(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    data = _head(bench, f"POST /parts?name={mark}.stl", "Content-Length: 9000") + rng.bytes(900)
    with _connected(bench) as connection:
        if rng.random() < 0.5:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        connection.sendall(data[: rng.integers(1, len(data))])
        time.sleep(rng.uniform(0, 0.1))


def _wrong_length(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    lines = [
        ("Content-Length: -1",),
        ("Content-Length: 5", "Content-Length: 9"),
        ("Transfer-Encoding: chunked",),
        (f"Content-Length: {10**12}",),
        ("Content-Length: 0x10",),
    ][rng.integers(5)]
    hidden = _head(bench, f"GET /hidden-{mark}")
    _refused(bench, _head(bench, f"POST /parts?name={mark}.stl", *lines) + hidden, mark)


def _hidden(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    hidden = _head(bench, f"GET /hidden-{mark}")
    path = rng.choice(["/parts?unit=ell&name=a.stl", "/parts?name=a.exe", "/stop", f"/no-{mark}"])
    more = [f"Content-Length: {len(hidden)}"]
    if rng.random() < 0.3:
        path, more = "/pack", [*more, "Origin: http://evil.example"]
    _refused(bench, _head(bench, f"POST {path}", *more) + hidden, mark)


def _refused(bench: Bench, data: bytes, mark: str) -> None:
    """Send a request that is refused, and in its body another one, which is none."""
    with _connected(bench) as connection:
        try:
            connection.sendall(data)
        except ConnectionError:
            return
        answers = _answers(connection)
    if len(answers) > 1 or any(f"hidden-{mark}".encode() in each for each in answers):
        raise Broken(f"{len(answers)} answers: {answers[-1][:200]!r}")
    for answer in answers:
        _expect(int(answer[:3]), (400, 403, 404, 411, 413, 422, 503), b"")


def _pipelined(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    count = int(rng.integers(2, 8))
    data = b""
    for n in range(count):
        body = json.dumps({"number": 10**9 + n}).encode()
        data += _head(bench, "POST /remove", f"Content-Length: {len(body)}") + body
    with _connected(bench) as connection:
        try:
            connection.sendall(data + _head(bench, f"GET /last-{mark}", "Connection: close"))
        except ConnectionError:
            return
        answers = _answers(connection)
    if not answers or answers[0].startswith(b"503"):
        return
    wanted = [str(10**9 + n).encode() for n in range(count)] + [f"/last-{mark}".encode()]
    if len(answers) != len(wanted) or any(
        each not in answer for each, answer in zip(wanted, answers, strict=True)
    ):
        raise Broken(f"{len(answers)} answers to {len(wanted)} requests, or in another order")


def _remove(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    number = _number(bench, rng)
    body = json.dumps({"number": number}).encode()
    status, data, _ = bench.ask("POST", "/remove", body)
    _expect(status, (200, 400), data, str(number))


def _random_order(bench: Bench, rng: np.random.Generator) -> dict[str, Any]:
    """Return an order that is possible, or nearly."""
    files: list[dict[str, Any]] = [
        {
            "number": each["number"],
            "count": int(rng.integers(1, 5)) if rng.random() < 0.9 else "max",
            "rotations": str(rng.choice(["cube", "fixed"])),
            "use": str(rng.choice(["part", "keep_out", "fixed"], p=[0.9, 0.05, 0.05])),
            "fields": {"mass": "9", "group": str(rng.integers(2))} if rng.random() < 0.7 else {},
        }
        for each in bench.state()["files"]
        if rng.random() < 0.7
    ]
    boxes: list[dict[str, Any]] = [{"size": "30x30x30"}, {"size": "cylinder:30x30"}]
    boxes += [{"file": each["number"]} for each in files[:1]]
    box = [boxes[rng.integers(len(boxes))]]
    if rng.random() < 0.2:
        box = [{"size": "20x20x20", "name": "A"}, {"size": "30x30x30", "name": "B", "count": 2}]
    settings: list[dict[str, Any]] = [
        {"clearance": "1", "clearance_z": "2", "wall_clearance": "sides=1,floor=0,top=2"},
        {"max_mass": ["20g"], "max_parts": ["3"]},
        {"groups": ["apart"], "objective": "boxes"},
        {"removable": True, "insertable": True, "separable": True},
        {},
    ]
    own = settings[rng.integers(len(settings))]
    return {"box": box, "unit": "mm", "seconds": 0.3, "files": files, **own}


def _order(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    order = _random_order(bench, rng)
    status, data, _ = bench.ask("POST", "/pack", json.dumps(order).encode())
    _expect(status, (200, 400, 409), data, "error")


def _kept_order(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    order = _random_order(bench, rng)
    if is_bad := rng.random() < 0.5:
        order["stable"] = mark
    status, data, _ = bench.ask("POST", "/order", json.dumps(order).encode())
    _expect(status, (200,), data)
    answer = json.loads(data)
    if is_bad and "" not in answer["faults"] and mark not in answer["faults"].get("stable", mark):
        raise Broken(f"another fault: {answer['faults']}")
    if not answer["faults"] and not answer["boxes"][0]["sides"]:
        raise Broken("no preview")


def _moves(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    state = bench.state()
    key = state.get("packing", mark)
    moves = [
        {"part": int(n), "shift": rng.normal(0, 5, 3).tolist(), "turns": int(rng.integers(4))}
        for n in rng.choice(4, rng.integers(1, 3), replace=False)
    ]
    asked = {"packing": key, "moves": moves, "accept": bool(rng.random() < 0.5)}
    status, data, _ = bench.ask("POST", "/moves", json.dumps(asked).encode())
    _expect(status, (200, 400, 409), data, "error")
    if status == 200 and not asked["accept"]:
        for each in json.loads(data)["conflicts"]:
            if not each["text"]:
                raise Broken(f"no reason: {each}")


def _step(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    name = str(rng.choice(["undo", "redo", "write", "lock"]))
    body = {"write": b"{}", "lock": b'{"part": 0, "locked": true}'}.get(name)
    status, data, _ = bench.ask("POST", f"/{name}", body)
    _expect(status, (200, 400, 409), data, "error")


def _bad_order(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    body = [
        json.dumps({mark: 1}).encode(),
        f'{{"box": "{mark}"'.encode(),
        json.dumps({"box": [{"size": "1x1x1"}], "unit": mark, "files": []}).encode(),
        b"[" * 1000,
        json.dumps({"box": [{"size": f"/etc/{mark}.stl"}], "unit": "mm", "files": []}).encode(),
        json.dumps({"box": [{"size": f"{mark * 9}.stl"}], "unit": "mm", "files": []}).encode(),
        json.dumps({"box": [{"size": "9x9x9"}] * 51, "unit": "mm", "files": []}).encode(),
    ][rng.integers(7)]
    status, data, _ = bench.ask("POST", "/pack", body)
    _expect(status, (400, 409), data, "error")


def _stop(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    status, data, _ = bench.ask("POST", "/stop")
    _expect(status, (200,), data)


def _poll(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    status, data, _ = bench.ask("GET", f"/state?seen={rng.integers(-1, 50)}")
    _expect(status, (200,), data)
    if "version" not in json.loads(data):
        raise Broken(f"not a state: {data[:200]!r}")


def _download(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    name = str(rng.choice(["packing.json", "packing.3mf", "packing.glb", f"{mark}.stl"]))
    status, data, headers = bench.ask("GET", f"/files/{name}")
    _expect(status, (200, 404), data, name)
    if status == 200 and headers["Content-Disposition"] != f'attachment; filename="{name}"':
        raise Broken(f"{name}: another file")
    if status == 200 and name == "packing.json":
        json.loads(data)
    if status == 200 and name == "packing.3mf" and zipfile.ZipFile(io.BytesIO(data)).testzip():
        raise Broken(f"{name}: a broken file")


def _many(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    held = [_connected(bench) for _ in range(int(rng.integers(5, 80)))]
    time.sleep(rng.uniform(0, 0.1))
    for each in held:
        each.close()


def _stranger(bench: Bench, rng: np.random.Generator, mark: str) -> None:
    line = str(rng.choice(["GET /state", "POST /stop", "GET /files/packing.json"]))
    with _connected(bench) as connection:
        try:
            connection.sendall(_head(bench, line, "Origin: http://evil.example"))
        except ConnectionError:
            return
        answers = _answers(connection)
    if len(answers) > 1 or any(each[:3] not in (b"403", b"503") for each in answers):
        raise Broken(f"answered {answers!r}")


KINDS = {
    "upload": Kind("kept, or refused by its name", _upload),
    "upload in pieces": Kind("kept, or refused by its name", _in_pieces),
    "upload that can't be read": Kind("refused by its name", _broken_upload),
    "upload with a path": Kind("no file outside the folder", _outside),
    "wrong length": Kind("refused; what follows is no request", _wrong_length),
    "request in a refused body": Kind("one answer", _hidden),
    "pipelined requests": Kind("an answer to each, in their order", _pipelined),
    "aborted connection": Kind("nothing is left", _aborted),
    "many connections": Kind("others are answered", _many),
    "another page": Kind("refused", _stranger),
    "removal": Kind("removed, or refused by its number", _remove),
    "order": Kind("a search, or one sentence", _order),
    "order that can't be read": Kind("one sentence", _bad_order),
    "order on the page": Kind("its faults by their fields, and a preview", _kept_order),
    "parts moved by hand": Kind("their conflicts, a result, or one sentence", _moves),
    "lock, undo, redo, write": Kind("done, or one sentence", _step),
    "stop": Kind("answered", _stop),
    "poll": Kind("a state", _poll),
    "download": Kind("the file, whole, or refused by its name", _download),
}
