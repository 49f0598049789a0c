"""Text from template files, by Jinja."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def render(
    template: Path,
    content: Mapping[str, Any],
    *,
    html: bool = False,
    filters: Mapping[str, Callable[..., str]] | None = None,
) -> str:
    """Fill in a template; a name that the content lacks is an error.

    Parameters
    ----------
    template : Path
        The template file.
    content : Mapping[str, Any]
        The values by the names that the template uses.
    html : bool
        Whether values are escaped for HTML; the filter `safe` marks values that are HTML already.
    filters : Mapping[str, Callable[..., str]] | None
        Functions that the template uses as filters.

    Returns
    -------
    str
        The text.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(filters or {})
    return environment.get_template(template.name).render(content)
