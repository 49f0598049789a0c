"""JSON decoded into typed records by `msgspec`, with one clear error for a wrong field."""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeVar

import msgspec
from msgspec import inspect

from packit_sim.core.errors import PackItError

T = TypeVar("T")

_STEPS = re.compile(r"\.([^.\[]+)|\[(\d+)\]")

MAX_DIGITS = 39
"""Maximum digits of an integer: those of the 128 bits in the state of a random generator."""

_MANY_DIGITS = re.compile(rb"[0-9]{%d}" % (MAX_DIGITS + 1))


def decode(data: bytes | str, kind: type[T], error: type[PackItError], what: str = "it") -> T:
    """Read JSON text as a typed record.

    Parameters
    ----------
    data : bytes | str
        The text, in UTF-8.
    kind : type[T]
        A dataclass, a `msgspec.Struct` or any other type that msgspec knows.
    error : type[PackItError]
        The error to raise.
    what : str
        The name of the whole text in messages, such as "a pack".

    Returns
    -------
    T
        The record.

    Raises
    ------
    PackItError
        The given type, if the text is not JSON, or not of this kind. NaN and Infinity are not
        JSON, a bool is not a number, and an integer has at most `MAX_DIGITS` digits. The message
        names the field, its value and the valid values.
    """
    try:
        text = data.decode() if isinstance(data, bytes) else data
    except UnicodeDecodeError:  # msgspec does not look at texts that the record does not have
        raise error("not JSON: it is not text in UTF-8") from None
    refuse_long_integers(text, error)
    try:
        return msgspec.json.decode(text, type=kind)
    except msgspec.ValidationError as problem:
        raise error(_sentence(str(problem), _parsed(text), kind, what)) from None
    except (ValueError, RecursionError) as problem:
        raise error(f"not JSON: {problem}") from None


def convert(raw: Any, kind: type[T], error: type[PackItError], what: str = "it") -> T:
    """Convert a value of JSON's types to a typed record; otherwise like `decode`."""
    _refuse_large_integers(raw, error)
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as problem:
        raise error(_sentence(str(problem), raw, kind, what)) from None
    except UnicodeEncodeError as problem:
        half = problem.object[problem.start]
        raise error(f"a text holds {half!r}, which is half a character") from None


def check_names(
    values: Mapping[str, Any], kind: type, error: type[PackItError], table: str = ""
) -> None:
    """Check that the names of settings exist, also those of settings within settings.

    Parameters
    ----------
    values : Mapping
        Settings by name.
    kind : type
        The dataclass of the settings.
    error : type of PackItError
        The error to raise.
    table : str
        A prefix of the names in the message, such as "physics."; empty for the outermost.

    Raises
    ------
    PackItError
        The given type, if there is no setting of such a name; the message lists the valid ones.
    """
    known = {
        field.encode_name: field.type for field in getattr(inspect.type_info(kind), "fields", ())
    }
    for name, value in values.items():
        if name not in known:
            raise error(f"there is no setting {table + name!r}: choose from {', '.join(known)}")
        for one in _alternatives(known[name]):
            if isinstance(value, Mapping) and isinstance(one, inspect.DataclassType):
                check_names(value, one.cls, error, f"{table}{name}.")


def refuse_long_integers(data: bytes | str, error: type[PackItError]) -> None:
    """Raise an error if JSON text has an integer of more than `MAX_DIGITS` digits.

    Such an integer overflows in arithmetic with floats, and Python can't print the longest ones.

    Parameters
    ----------
    data : bytes | str
        The text; if it is not JSON, nothing is raised.
    error : type[PackItError]
        The error to raise.

    Raises
    ------
    PackItError
        The given type.
    """
    if not _MANY_DIGITS.search(data if isinstance(data, bytes) else data.encode()):
        return
    digits = [0]

    def count(text: str) -> int:
        digits.append(len(text.lstrip("-")))
        return 0

    with suppress(ValueError, RecursionError):  # what is not JSON is reported by `decode`
        json.loads(data, parse_int=count)
    if max(digits) > MAX_DIGITS:
        raise error(f"an integer of {max(digits)} digits is not possible: at most {MAX_DIGITS}")


class _Header(msgspec.Struct):
    format: Any = None


def format_of(data: bytes | str, error: type[PackItError], what: str = "it") -> Any:
    """Read the field "format" of a JSON object, unchecked; otherwise like `decode`."""
    return decode(data, _Header, error, what).format


@dataclass(frozen=True)
class JsonRecord:
    """A base of dataclasses that can be written as JSON."""

    def to_json(self) -> dict[str, Any]:
        """Return the fields in JSON's types."""
        fields: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return fields


def builtins(record: Any) -> Any:
    """Return a record in JSON's types."""
    return msgspec.to_builtins(record)


def encode(record: Any) -> str:
    """Write a record as one line of JSON; floats keep every bit, and must be finite."""
    return json.dumps(builtins(record), separators=(",", ":"), allow_nan=False)


def _refuse_large_integers(raw: Any, error: type[PackItError]) -> None:
    """Raise an error if a value of JSON's types has an integer of more than `MAX_DIGITS` digits."""
    left = [raw]
    while left:
        value = left.pop()
        if isinstance(value, int) and abs(value) >= 10**MAX_DIGITS:
            raise error(f"an integer of more than {MAX_DIGITS} digits is not possible")
        if isinstance(value, Mapping):
            left.extend(value.values())
        elif isinstance(value, list | tuple):
            left.extend(value)


def _parsed(data: bytes | str) -> Any:
    """Decode JSON without types; None if it can't be decoded."""
    try:
        return msgspec.json.decode(data)
    except (ValueError, RecursionError):
        return None


class _Problem(NamedTuple):
    """A message of msgspec: its sentence, the path of a field, and the kind of problem."""

    text: str
    path: str
    kind: str


_KINDS = {
    "missing": r"Object missing required field `(?P<name>.+)`",
    "unknown": r"Object contains unknown field `(?P<name>.+)`",
    "choice": r"Invalid .*",
    "type": r"Expected .*|.* out of range",
    "own": r".*",
}
"""The kinds of problems by the messages of msgspec; the last are those of a record's own checks."""


def _understood(message: str) -> _Problem:
    """Take a message of msgspec apart.

    This is the one place that depends on the wording of msgspec's messages: its errors have no
    fields. `tests/test_hooks.py` lists the versions with which it was tried.
    """
    text, _, path = message.partition(" - at `$")
    path = path.removesuffix("`").removesuffix("[...]")
    kind, match = next(
        (kind, found)
        for kind, pattern in _KINDS.items()
        if (found := re.fullmatch(pattern, text, re.DOTALL))
    )
    name = match.groupdict().get("name")
    return _Problem(text.replace("`", ""), path if name is None else f"{path}.{name}", kind)


def _sentence(message: str, raw: Any, record: Any, what: str) -> str:
    """Rewrite msgspec's message in our words."""
    text, path, kind = _understood(message)
    field = path.lstrip(".")
    if kind in ("missing", "unknown"):
        return f"field {field!r} is {kind}"
    if not path:
        if text.startswith("Expected object"):
            return f"{what} must be a JSON object, not {type(raw).__name__}"
        return text
    if kind == "choice":
        choices = ", ".join(dict.fromkeys(_choices(record, path)))
        return f"field {field!r} is {_value(raw, path)}: choose from {choices}"
    if kind == "type":
        return f"field {field!r} is {_value(raw, path)}: {text[0].lower()}{text[1:]}"
    return f"field {field!r}: {text}"


def _choices(kind: Any, path: str) -> Iterator[str]:
    """List the valid values of the field at a path: of literals, enums and tags."""
    nodes = list(_alternatives(inspect.type_info(kind)))
    for key, index in _STEPS.findall(path):
        below: list[Any] = []
        for node in nodes:
            if index:
                below += getattr(node, "item_types", ()) or [getattr(node, "item_type", None)]
            elif key == getattr(node, "tag_field", None):
                yield str(node.tag)
            else:
                below += [f.type for f in getattr(node, "fields", ()) if f.encode_name == key]
        nodes = [one for node in below for one in _alternatives(node)]
    for node in nodes:
        yield from map(str, getattr(node, "values", ()))
        if isinstance(node, inspect.EnumType):
            yield from (str(member.value) for member in node.cls)


def _alternatives(node: Any) -> Iterator[Any]:
    """Yield a type, or each type of a union, without its restrictions."""
    if isinstance(node, inspect.Metadata):
        yield from _alternatives(node.type)
    elif isinstance(node, inspect.UnionType):
        for one in node.types:
            yield from _alternatives(one)
    else:
        yield node


def _value(raw: Any, path: str) -> str:
    """Return the value at a path such as `.items[3].rotation`, as messages show it."""
    try:
        for key, index in _STEPS.findall(path):
            raw = raw[int(index)] if index else raw[key]
    except (KeyError, IndexError, TypeError):
        return "wrong"
    return reprlib.repr(raw)
