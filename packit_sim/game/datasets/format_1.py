"""Version 1 of the pack format, rewritten as version 2.

In version 1 the field "made" was a free-form object instead of a typed provenance record.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from packit_sim.core.errors import PackFormatError

FORMAT = 1
"""The version that this module reads."""

_PLAYED = ("task", "task_digest", "seed", "return", "end", "seconds", "weights", "pieces", "split")


def pack(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Rewrite a pack of version 1 as one of version 2.

    Parameters
    ----------
    raw : Mapping[str, Any]
        The pack in JSON's types, unchecked.

    Returns
    -------
    dict
        The pack for `Pack`, still unchecked.

    Raises
    ------
    PackFormatError
        If the field "made" is not an object.
    """
    fields = dict(raw)
    made = fields.pop("made", {})
    if not isinstance(made, dict):
        raise PackFormatError(f"field 'made' is {made!r:.80}: expected object")
    return {**fields, "provenance": _provenance(made)}


def _provenance(made: Mapping[str, Any]) -> dict[str, Any]:
    if "results" in made:
        return _played(made)
    producer = made.get("by")
    rest = {key: value for key, value in made.items() if key != "by"}
    settings = made.get("settings")
    climbed = isinstance(settings, dict) and settings.get("search") == "climbing"  # removed since
    if not climbed and producer in ("evolution", "random chromosome", "the original PackIt"):
        return {"kind": producer, **rest}
    split = {"split": rest.pop("split")} if "split" in rest else {}
    notes = {"notes": json.dumps(rest, ensure_ascii=False)} if rest else {}
    author = {} if producer is None else {"author": str(producer)}
    return {"kind": "other", **author, **notes, **split}


def _agent(name: Any) -> Any:
    """Return the name of an agent, which may have been renamed since."""
    return name.replace("packnn-prospects", "packnn-placement") if isinstance(name, str) else name


def _played(made: Mapping[str, Any]) -> dict[str, Any]:
    """Rewrite a rollout; numbers that are not fields of `Played` are scores."""
    if made["results"] != FORMAT:
        raise PackFormatError(f"field 'made.results' is {made['results']!r:.40}: expected {FORMAT}")
    fields = {key: made[key] for key in _PLAYED if key in made}
    rules = {key: made[key] for key in ("easy", "kinematic") if key in made}
    own = {"results", "by", "easy", "kinematic", *_PLAYED}
    scores = {
        key: value
        for key, value in made.items()
        if key not in own and isinstance(value, int | float) and not isinstance(value, bool)
    }
    agent = {"agent": _agent(made["by"])} if "by" in made else {}
    return {"kind": "rollout", **agent, **fields, "rules": rules, "scores": scores}
