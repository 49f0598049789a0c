"""What the product computes from the same meshes in each trial, computed once.

Most forgeries leave the meshes as they are. What is remembered depends on nothing but the content
of a file, or on a mesh and its settings; links, paths and digests are read anew in each trial.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import wraps
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from cachetools import LRUCache

from packit_sim.libraries import mesh_files
from packit_sim.parts.filling import preparation
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.reading import prepared
from packit_sim.parts.reading.masses import centre_of_mass
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import PreparedPart, prepare
from packit_sim.parts.results import check

MOST = 2000
"""Values of each function; each of a mesh of a dozen triangles."""

_DERIVED = "vertices", "faces", "volume", "low", "high", "shape", "digest"
"""Attributes of a type of items that depend on its mesh."""


@contextmanager
def remembered() -> Iterator[None]:
    """Remember what is computed from meshes; errors are not remembered."""
    read, build = mesh_files._read, ItemType.__post_init__
    types: LRUCache[Hashable, ItemType] = LRUCache(MOST)

    @_by(lambda content, suffix, *_: (content, suffix))
    def scene(*given: Any) -> Any:
        mesh = read(*given).joined()
        return SimpleNamespace(joined=lambda: mesh)

    def built(own: ItemType, volume: float | None, repaired: bool) -> None:
        key = _mesh_key(own), own.name, volume, repaired
        known = types.get(key)
        if known is None:
            build(own, volume, repaired)
            types[key] = own
        else:
            own._check_settings()
            vars(own).update({k: v for k, v in vars(known).items() if k in _DERIVED})

    @_by(lambda part, *given: (_mesh_key(part.mesh), _settings(part), *given))
    def once(part: Part, *given: Any) -> PreparedPart:
        return prepare(part, *given)

    changes: list[tuple[Any, str, Any]] = [
        (mesh_files, "_read", scene),
        (ItemType, "__post_init__", built),
        (preparation, "prepare", lambda part, *given: replace(once(part, *given), part=part)),
        (prepared, "centre_of_mass", _by(lambda own: own.digest)(centre_of_mass)),
        (check, "_Original", _by(_original_key)(check._Original)),
    ]
    with ExitStack() as stack:
        for where, name, new in changes:
            stack.enter_context(patch.object(where, name, new))
        yield


def _by(key: Callable[..., Hashable]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function whose values are remembered by a key."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        values: LRUCache[Hashable, Any] = LRUCache(MOST)

        @wraps(function)
        def found(*given: Any) -> Any:
            own = key(*given)
            if own not in values:
                values[own] = function(*given)
            return values[own]

        return found

    return decorate


def _mesh_key(mesh: Any) -> Hashable:
    arrays = mesh.vertices, mesh.faces
    return tuple((each.shape, each.dtype.str, each.tobytes()) for each in arrays)


def _settings(part: Part) -> Hashable:
    others = {"mesh", "file", "copy", "digest"}
    return tuple(repr(value) for name, value in vars(part).items() if name not in others)


def _original_key(own: PreparedPart, unit: float) -> Hashable:
    part, copy = own.part, own.part.copy
    content = copy and (copy.digest, part.file and part.file.suffix, part.node)
    closed = own.is_closed, own.filled_holes
    return part.name, content, _mesh_key(part.mesh), own.scale, *closed, unit
