"""The kinds of repetition of each reader's format."""

from __future__ import annotations

import io
import json
import struct
import warnings
import zipfile
from collections.abc import Callable, Iterator

from campaigns.fuzzing.reader import Reader
from campaigns.fuzzing.shape_readers import SEPARATOR
from campaigns.growth.repetition import Repetition, repeated, wrapped
from campaigns.growth.text_kinds import json_text, text, xml

_Kinds = Callable[[bytes], Iterator[Repetition]]


def kinds(reader: Reader) -> list[Repetition]:
    """Return the repetitions in the files of a reader, with names that differ."""
    found: dict[str, Repetition] = {}
    for number, data in enumerate(_valid_seeds(reader)):
        for one in _FORMATS.get(reader.name, json_text)(data):
            name = one.name if number == 0 else f"{one.name} (file {number + 1})"
            found.setdefault(name, Repetition(name, one.write))
    return list(found.values())


def _valid_seeds(reader: Reader) -> list[bytes]:
    """Return the small files that can be read, at most one of each beginning.

    If none is read to its end, because it is of another library, it is the first.
    """
    found: dict[bytes, bytes] = {}
    for data in reader.seeds():
        try:
            reader.read(data)
        except Exception:  # of a file that is broken on purpose
            continue
        found.setdefault(data[:_BEGINNING], data)
    return list(found.values())[:_MOST_FILES] or reader.seeds()[:1]


_BEGINNING = 5
"""Bytes by which ASCII and binary files of one format differ."""

_MOST_FILES = 2


def _archive(inside: _Kinds) -> _Kinds:
    """Return the repetitions of members of a ZIP archive, and those inside them."""

    def found(data: bytes) -> Iterator[Repetition]:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        yield Repetition(
            "members",
            lambda n: _zipped([*members.items(), *((f"m{k}.xml", b"") for k in range(n))]),
        )
        name = next(iter(members))
        yield Repetition(
            "equal members", lambda n: _zipped([*members.items(), *[(name, members[name])] * n])
        )
        yield Repetition("letters of a name", lambda n: _zipped([*members.items(), ("a" * n, b"")]))
        yield Repetition(
            "folders of a name", lambda n: _zipped([*members.items(), ("a/" * n, b"")])
        )
        yield repeated("bytes behind it", data, b"\0", b"")
        yield repeated("bytes before it", b"", b"\0", data)
        for name, content in members.items():

            def wrap(changed: bytes, name: str = name) -> bytes:
                return _zipped(list((members | {name: changed}).items()))

            for one in _quiet(inside, content):
                yield wrapped(f"{name}: ", one, wrap)

    return found


def _quiet(inside: _Kinds, content: bytes) -> Iterator[Repetition]:
    """Yield the repetitions of a member, if it is of the format."""
    try:
        yield from inside(content)
    except (ValueError, SyntaxError):  # also etree.XMLSyntaxError
        yield from text(content)


def _zipped(members: list[tuple[str, bytes]]) -> bytes:
    out = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w") as archive:
        warnings.simplefilter("ignore")  # of names that occur twice
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def _npy(data: bytes) -> Iterator[Repetition]:
    """Yield the repetitions in the header of an array of NumPy, and of its values."""
    (length,) = struct.unpack_from("<H", data, 8)
    head, body = data[10 : 10 + length], data[10 + length :]
    for one in text(head):
        yield wrapped(
            "", one, lambda head: data[:8] + struct.pack("<H", min(len(head), 65535)) + head + body
        )
    yield repeated("values", data, body[-8:], b"")


def _glb(data: bytes) -> Iterator[Repetition]:
    (length,) = struct.unpack_from("<I", data, 12)
    head, rest = data[20 : 20 + length], data[20 + length :]

    def joined(head: bytes) -> bytes:
        head += b" " * (-len(head) % 4)
        sizes = struct.pack("<II4s", 20 + len(head) + len(rest), len(head), b"JSON")
        return data[:8] + sizes + head + rest

    for one in json_text(head):
        yield wrapped("", one, joined)
    yield repeated("chunks", data, struct.pack("<I4s", 0, b"BIN\0"), b"")


def _safetensors(data: bytes) -> Iterator[Repetition]:
    (length,) = struct.unpack_from("<Q", data)
    head, body = data[8 : 8 + length], data[8 + length :]
    for one in json_text(head):
        yield wrapped("", one, lambda head: struct.pack("<Q", len(head)) + head + body)
    metadata = json.loads(head)["__metadata__"]
    for key, value in metadata.items():
        try:
            inner = list(json_text(value.encode()))
        except ValueError:
            continue

        def inside(changed: bytes, key: str = key) -> bytes:
            whole = json.loads(head)
            whole["__metadata__"][key] = changed.decode("utf-8", "replace")
            text = json.dumps(whole).encode()
            return struct.pack("<Q", len(text)) + text + body

        for one in inner:
            yield wrapped(f"{key}: ", one, inside)


def _library(data: bytes) -> Iterator[Repetition]:
    catalogue, _, splits = data.partition(SEPARATOR)
    for one in json_text(catalogue):
        yield wrapped("", one, lambda changed: changed + SEPARATOR + splits)
    for one in json_text(splits):
        yield wrapped("splits: ", one, lambda changed: catalogue + SEPARATOR + changed)


def _binary(data: bytes) -> Iterator[Repetition]:
    for byte in (b"\0", b"\n", b" ", b"\xff"):
        yield repeated(f"byte {byte[0]} at the start", b"", byte, data)
        yield repeated(f"byte {byte[0]} at the end", data, byte, b"")


def _mixed(data: bytes) -> Iterator[Repetition]:
    """Yield the repetitions of a mesh that is a text, or a binary file."""
    yield from text(data)
    yield from _binary(data)


_FORMATS: dict[str, _Kinds] = {
    "parts-csv": text,
    "parts-xlsx": _archive(xml),
    "boxes": text,
    "box-lists": text,
    "named-containers": text,
    "limits": text,
    "trajectories": _archive(_npy),
    "containers": text,
    "library-meshes": _archive(_npy),
    "libraries": _library,
    "3mf": _archive(xml),
    "dae": xml,
    "glb": _glb,
    "off": text,
    "obj": text,
    "ply": _mixed,
    "stl": _mixed,
    "step": text,
    "weights": _safetensors,
    "placement-weights": _safetensors,
    "settings": text,
    "recording-data": _binary,
}
"""The kinds of a format by the name of its reader; those of the others are those of JSON."""
