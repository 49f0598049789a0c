"""Changes of the tree of a JSON text, also to what is not valid, such as NaN and repeated keys."""

from __future__ import annotations

import copy
import json
from random import Random
from typing import Any

from campaigns.fuzzing.hostile_values import NUMBERS, TEXTS, Change, encoded


class _Raw(str):
    """A piece of JSON text."""


class _Object(list[list[Any]]):
    """An object of JSON: pairs, of which two may have one key."""


def json_tree(data: bytes, rng: Random, change: Change) -> bytes:
    """Change the tree of a JSON text, or of one line of JSON Lines."""
    lines = data.split(b"\n")
    chosen = [n for n, line in enumerate(lines) if line.strip()]
    try:
        text = _changed_json(data, rng)
    except ValueError:
        number = rng.choice(chosen or [0])
        lines[number] = _changed_json(lines[number], rng)
        if rng.random() < 0.1:
            lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
        text = b"\n".join(lines)
    return encoded(text, rng) if rng.random() < 0.02 else text


def _changed_json(data: bytes, rng: Random) -> bytes:
    tree = json.loads(
        data,
        object_pairs_hook=lambda pairs: _Object([list(pair) for pair in pairs]),
        parse_float=_Raw,
        parse_int=_Raw,
        parse_constant=_Raw,
    )
    root = [tree]
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        _change_node(root, rng)
    return _text(root[0], rng.random() < 0.7).encode("utf-8", "surrogatepass")


def _change_node(root: list[Any], rng: Random) -> None:
    slots = list(_slots(root))
    place, at = rng.choice(slots)
    match rng.randrange(10):
        case 0 | 1:
            place[at] = _Raw(rng.choice(NUMBERS))
        case 2:
            place[at] = rng.choice(TEXTS)
        case 3:
            other, where = rng.choice(slots)
            place[at] = copy.deepcopy(other[where])
            if len(_text(root[0], True)) > 100_000:  # copies of copies
                place[at] = None
        case 4:
            deep = rng.choice((10, 500, 1500, 6000))
            opening, closing = rng.choice((("[", "]"), ('{"a":', "}")))
            place[at] = _Raw(opening * deep + "1" + closing * deep)
        case _:
            objects = [p[i] for p, i in slots if isinstance(p[i], list) and p[i]]
            if objects:
                _change_members(rng.choice(objects), rng)


def _change_members(node: list[Any], rng: Random) -> None:
    """Remove, repeat, rename or move a member of an object or a list."""
    at = rng.randrange(len(node))
    match rng.randrange(4):
        case 0:
            del node[at]
        case 1:
            copy = list(node[at]) if isinstance(node, _Object) else node[at]
            node[at:at] = [copy] * rng.choice((1, 1, 20))
        case 2 if isinstance(node, _Object):
            node[at][0] = rng.choice((*TEXTS, rng.choice(node)[0]))
        case _:
            rng.shuffle(node)


def _slots(node: list[Any]) -> Any:
    """Yield each place of a value in a tree, as the list that holds it and its number."""
    left = [node]
    while left:
        one = left.pop()
        if isinstance(one, _Object):
            inside = [(pair, 1) for pair in one]
        else:
            inside = [(one, n) for n in range(len(one))]
        for place, at in inside:
            yield place, at
            if isinstance(place[at], list):
                left.append(place[at])


def _text(node: Any, plain: bool) -> str:
    if isinstance(node, _Raw):
        return str(node)
    if isinstance(node, _Object):
        members = (f"{json.dumps(k, ensure_ascii=plain)}:{_text(v, plain)}" for k, v in node)
        return "{" + ",".join(members) + "}"
    if isinstance(node, list):
        return "[" + ",".join(_text(one, plain) for one in node) + "]"
    return json.dumps(node, ensure_ascii=plain)
