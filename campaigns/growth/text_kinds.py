"""Kinds of repetition in texts, in JSON and in XML: found in a small file of each."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from lxml import etree

from campaigns.growth.repetition import Repetition, repeated

_MARK = "@repeated@"
"""Stands in a text for what is repeated there."""

_BITS = (
    b" ",
    b"\n",
    b"\t",
    b"\r\n",
    b"#\n",
    b"# \n",
    b"# x\n",
    b"\\\n",
    b"'",
    b'"',
    b"(",
    b"[",
    b"{",
    b"<",
)
"""What is repeated in any text: blanks, ends of lines, comments, quotes and brackets."""

_WORD = re.compile(rb"[^\s<>\"'=/,;\[\](){}:]+")

_MOST_LINES = 8

_MOST_WORDS = 8


def text(data: bytes) -> Iterator[Repetition]:
    """Yield the repetitions of bits, of each line and of each word of a text."""
    first_line = data.find(b"\n") + 1
    word = _WORD.search(data)
    places = {"at the start": 0, "after the first line": first_line, "at the end": len(data)}
    if word is not None:
        places |= {"after the first word": word.end()}
    places |= {"before the last line": data.rstrip().rfind(b"\n") + 1}
    for where, at in places.items():
        for bit in _BITS:
            yield repeated(f"{_shown(bit)} {where}", data[:at], bit, data[at:])
            if where.startswith("after"):
                yield repeated(f"{_shown(bit)} {where}, then x", data[:at], bit, b"x")
    at = 0
    seen: set[bytes] = set()
    for line in data.splitlines(keepends=True):
        at += len(line)
        if line not in seen and len(seen) < _MOST_LINES:
            seen.add(line)
            yield repeated(f"line {_shown(line)}", data[: at - len(line)], line, data[at:])
    seen = set()
    for match in _WORD.finditer(data):
        own = match[0]
        if own in seen or len(seen) == _MOST_WORDS:
            continue
        seen.add(own)
        head, tail = data[: match.end()], data[match.end() :]
        yield repeated(f"word {_shown(own)}", head, b" " + own, tail)
        yield repeated(f"last letter of {_shown(own)}", head, own[-1:], tail)


def json_text(data: bytes) -> Iterator[Repetition]:
    """Yield the repetitions of a JSON text, or of the first line of JSON Lines."""
    try:
        tree, behind = json.loads(data), b""
    except ValueError:
        line, _, rest = data.partition(b"\n")
        tree, behind = json.loads(line), b"\n" + rest
        yield repeated("line", b"", line + b"\n", behind)
    plain = json.dumps(tree).encode()
    for bit in (b" ", b"\n", b"[", b'{"a":', b'"', b"-", b"\\"):
        yield repeated(f"{_shown(bit)} at the start", b"", bit, plain + behind)
        yield repeated(f"{_shown(bit)} at the end", plain, bit, behind)
    for path, head, value, tail in _values(tree):
        yield from _in_value(path, head, value, tail + behind)


def _values(tree: Any) -> Iterator[tuple[str, bytes, Any, bytes]]:
    """Yield each value of a tree whose path is new: its path, and the text before and behind it."""
    root = [tree]
    seen = set()
    waiting: list[tuple[str, Any, Any]] = [("all", root, 0)]
    while waiting:
        path, place, key = waiting.pop(0)
        if path in seen:
            continue
        seen.add(path)
        value, place[key] = place[key], _MARK
        head, _, tail = json.dumps(root[0]).encode().partition(json.dumps(_MARK).encode())
        place[key] = value
        yield path, head, value, tail
        if isinstance(value, list):
            waiting += [(f"{path}[]", value, n) for n in range(len(value))]
        elif isinstance(value, dict):
            waiting += [(f"{path}.{name}", value, name) for name in value]


def _in_value(path: str, head: bytes, value: Any, tail: bytes) -> Iterator[Repetition]:
    """Yield the repetitions in a value of JSON, given the text before and behind it."""
    own = json.dumps(value).encode()
    yield repeated(f"lists around {path}", head, b"[", tail, b"]", own)
    if isinstance(value, str):
        yield repeated(f"letters of {path}", head + own[:-1], b"a", b'"' + tail)
        yield repeated(f"escapes in {path}", head + own[:-1], b"\\u0031", b'"' + tail)
        yield repeated(f"blanks in {path}", head + own[:-1], b" ", b'"' + tail)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield repeated(f"digits of {path}", head + own, b"0", tail)
        yield repeated(f"decimals of {path}", head + b"0.", b"1", tail)
    elif isinstance(value, list) and value:
        first = json.dumps(value[0]).encode()
        yield repeated(f"elements of {path}", head + own[:-1], b"," + first, b"]" + tail)
    elif isinstance(value, dict) and value:
        name = next(iter(value))
        member = json.dumps(name).encode() + b":" + json.dumps(value[name]).encode()
        yield repeated(f"equal members of {path}", head + own[:-1], b"," + member, b"}" + tail)
        yield Repetition(
            f"different members of {path}",
            lambda n: (
                head
                + own[:-1]
                + b"".join(b',"a%d":%s' % (k, json.dumps(value[name]).encode()) for k in range(n))
                + b"}"
                + tail
            ),
        )


def xml(data: bytes) -> Iterator[Repetition]:
    """Yield the repetitions of elements, attributes, texts and comments of an XML text."""
    root = etree.fromstring(data)
    seen = set()
    for element in [root, *root.iter("*")]:
        name = etree.QName(element).localname
        if name in seen:
            continue
        seen.add(name)
        if element is not root:
            yield _in_tree(root, element, "element")
        for kind in ("nested", "attributes", "text", "comments", "processing instructions"):
            yield _in_tree(root, element, kind)
        for key in element.attrib:
            yield _in_tree(root, element, "letters", key)
            yield _in_tree(root, element, "words", key)
    yield from (one for one in text(data) if not one.name.startswith(("line", "last", "word")))


def _in_tree(root: Any, element: Any, kind: str, key: str = "") -> Repetition:
    """Return a repetition in a tree, which is not changed."""
    place = list(root.iter()).index(element)
    copy = etree.fromstring(etree.tostring(root))
    own = list(copy.iter())[place]
    name = etree.QName(element).localname
    if key:
        value = own.get(key)
        own.set(key, value + _MARK)
        letters = (value[-1:] if kind == "letters" else f" {value}") or "a"
        head, tail = _split(copy)
        return repeated(f"{kind} of {name}@{key}", head, letters.encode(), tail)
    if kind == "element":
        behind, own.tail = own.tail, None
        unit = etree.tostring(own)
        own.tail = _MARK + (behind or "")
        head, tail = _split(copy)
        return repeated(f"element {name}", head, unit, tail)
    if kind == "attributes":
        own.set("repeated", _MARK)
        head, tail = _split(copy)
        return Repetition(
            f"attributes of {name}",
            lambda n: head + b'" ' + b" ".join(b'a%d="1"' % k for k in range(n)) + b' z="' + tail,
        )
    own.text = _MARK + (own.text or "")
    head, tail = _split(copy)
    if kind == "nested":
        tag = etree.QName(element).localname.encode()
        return repeated(f"{name} in itself", head, b"<" + tag + b">", tail, b"</" + tag + b">")
    units = {"text": b"1 ", "comments": b"<!-- -->", "processing instructions": b"<?a b?>"}
    return repeated(f"{kind} in {name}", head, units[kind], tail)


def _split(root: Any) -> tuple[bytes, bytes]:
    head, _, tail = etree.tostring(root).partition(_MARK.encode())
    return head, tail


def _shown(data: bytes) -> str:
    """Return bytes as a table shows them."""
    text = data.decode("utf-8", "replace")
    names = {" ": "blank", "\n": "newline", "\t": "tab", "\r\n": "CR LF"}
    return names.get(text) or repr(text)[1:-1][:40]
