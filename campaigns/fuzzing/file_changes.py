"""Changes of files that know the file's structure: TOML, tokens of text, ZIP, headers.

A mutator takes a file's bytes, a random generator, and a function that changes bytes without
knowing what they are; it raises ValueError if the bytes are not of its structure.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from random import Random

from campaigns.fuzzing.hostile_values import NUMBERS, TEXTS, Change, Mutator, encoded
from campaigns.fuzzing.json_changes import json_tree

_TOKEN = re.compile(rb"[^\s<>\"'=/,\[\](){}:]+")
_SETTING = re.compile(r"(?m)^(\s*[^=\n\[]+=\s*)(.*)$")


def toml(data: bytes, rng: Random, change: Change) -> bytes:
    """Change the values and the lines of a TOML file."""
    text = data.decode()
    found = list(_SETTING.finditer(text))
    if not found or rng.random() < 0.3:
        return (
            encoded(lines(data, rng, change), rng)
            if rng.random() < 0.1
            else lines(data, rng, change)
        )
    one = rng.choice(found)
    deep = rng.choice((3, 50, 600))
    value = rng.choice(
        (
            rng.choice(NUMBERS),
            json.dumps(rng.choice(TEXTS), ensure_ascii=rng.random() < 0.5),
            "[" * deep + "]" * deep,
            "{a=" * deep + "1" + "}" * deep,
            "{" + ".".join("a" * deep) + "=1}",
            "1979-05-27T07:32:00Z",
            "07:32:00",
            rng.choice(found)[2],
        )
    )
    name = one[1] if rng.random() < 0.8 else rng.choice((".".join("a" * deep) + " = ", '"" = '))
    return (text[: one.start()] + name + value + text[one.end() :]).encode("utf-8", "replace")


def tokens(data: bytes, rng: Random, change: Change) -> bytes:
    """Replace words and numbers of a text, or change its lines."""
    found = list(_TOKEN.finditer(data))
    if not found or rng.random() < 0.3:
        return lines(data, rng, change)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        one = rng.choice(found)
        new = rng.choice(
            (
                rng.choice(NUMBERS).encode(),
                rng.choice(TEXTS).encode("utf-8", "surrogatepass"),
                rng.choice(found)[0],
                str(rng.randrange(-3, 40)).encode(),
                str(rng.uniform(-2, 2)).encode(),
            )
        )
        data = data[: one.start()] + new + data[one.end() :]
        found = list(_TOKEN.finditer(data)) or found
    return data


def lines(data: bytes, rng: Random, change: Change) -> bytes:
    """Repeat, remove, exchange or join lines."""
    parts = re.split(rb"(?<=[\n>])", data)
    one, other = rng.randrange(len(parts)), rng.randrange(len(parts))
    match rng.randrange(5):
        case 0:
            parts[one:one] = [parts[other]] * rng.choice((1, 2, 30))
        case 1:
            del parts[one]
        case 2:
            parts[one], parts[other] = parts[other], parts[one]
        case 3:
            del parts[min(one, other) : max(one, other)]
        case _:
            parts[one] = change(parts[one])
    return b"".join(parts)


def unstructured(data: bytes, rng: Random, change: Change) -> bytes:
    """Change bytes, and numbers of two, four and eight bytes."""
    if len(data) < 8 or rng.random() < 0.5:
        return change(data)
    kind = rng.choice(("<H", "<I", "<Q", "<f", "<d", ">I"))
    size = struct.calcsize(kind)
    at = rng.randrange(min(len(data), rng.choice((128, len(data)))) - size + 1)
    if kind in ("<f", "<d"):
        value: float = rng.choice((0.0, float("nan"), float("inf"), 1e30, -1e-38, 0.5))
    else:
        most = 256**size - 1
        value = rng.choice((0, 1, 2, 255, most, most >> 1, (most >> 1) + 1, rng.randrange(most)))
    return data[:at] + struct.pack(kind, value) + data[at + size :]


def parts(separator: bytes, mutator: Mutator) -> Mutator:
    """Return a mutator of one of several files, which stand one after the other in the bytes."""

    def mutate(data: bytes, rng: Random, change: Change) -> bytes:
        files = data.split(separator)
        number = rng.randrange(len(files))
        files[number] = mutator(files[number], rng, change)
        return separator.join(files)

    return mutate


def glb(data: bytes, rng: Random, change: Change) -> bytes:
    """Change the JSON or the rest of a GLB file, and its lengths with it."""
    (length,) = struct.unpack_from("<I", data, 12) if len(data) >= 20 else (0,)
    head, body = data[20 : 20 + length], data[20 + length :]
    if rng.random() < 0.8:
        head = json_tree(head, rng, change)
        head += b" " * (-len(head) % 4)
    else:
        body = unstructured(body, rng, change)
    total = struct.pack("<4sII", b"glTF", 2, 20 + len(head) + len(body))
    return total + struct.pack("<I4s", len(head), b"JSON") + head + body


def safetensors(data: bytes, rng: Random, change: Change) -> bytes:
    """Change the JSON header of safetensors, also the JSON in its metadata, and the length."""
    (length,) = struct.unpack_from("<Q", data) if len(data) >= 8 else (0,)
    head, body = data[8 : 8 + length], data[8 + length :]
    if rng.random() < 0.2:
        return data[: 8 + length] + unstructured(body, rng, change)
    header = json.loads(head)
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    if isinstance(metadata, dict) and metadata and rng.random() < 0.7:
        key = rng.choice(sorted(metadata))
        text = str(metadata[key]).encode("utf-8", "replace")
        try:
            metadata[key] = json_tree(text, rng, change).decode("utf-8", "replace")
        except ValueError:
            metadata[key] = rng.choice((*NUMBERS, *TEXTS))
        head = json.dumps(header).encode()
    else:
        head = json_tree(head, rng, change)
    return struct.pack("<Q", len(head)) + head + body


def archive(mutator: Mutator) -> Mutator:
    """Return a mutator of a member of a ZIP archive, which is packed again."""

    def mutate(data: bytes, rng: Random, change: Change) -> bytes:
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as found:
                members = [(name, found.read(name)) for name in found.namelist()]
        except Exception as error:  # whatever a damaged archive makes zipfile raise
            raise ValueError("no archive") from error
        number = rng.randrange(len(members)) if members else 0
        kind = rng.random()
        if members and kind < 0.85:
            members[number] = members[number][0], mutator(members[number][1], rng, change)
        elif members and kind < 0.9:
            del members[number]
        elif members:
            members.append((rng.choice((*TEXTS[:30], members[number][0])), members[number][1]))
        out = io.BytesIO()
        stored = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
        with zipfile.ZipFile(out, "w", stored) as made:
            for name, content in members:
                entry = zipfile.ZipInfo(name.encode("utf-8", "replace").decode())
                entry.compress_type = stored
                made.writestr(entry, content)
        return out.getvalue()

    return mutate


def npy(data: bytes, rng: Random, change: Change) -> bytes:
    """Change the header of an array of NumPy, and its length with it, or the values."""
    (length,) = struct.unpack_from("<H", data, 8) if len(data) >= 10 else (0,)
    head, body = data[10 : 10 + length], data[10 + length :]
    if rng.random() < 0.5:
        head = tokens(head, rng, change)
    elif body:
        body = unstructured(body, rng, change)
    return data[:8] + struct.pack("<H", len(head) % 65536) + head + body
