"""Text from template files, by Jinja."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from packit_sim.core.extras import needed_for


def check_installed() -> None:
    """Check that Jinja is installed, before there is work.

    Raises
    ------
    MissingPackageError
        If it is not.
    """
    with needed_for("pages"):
        import jinja2  # noqa: F401


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
        Whether values are escaped for HTML; the filter `safe` marks what is HTML already.
    filters : Mapping[str, Callable[..., str]] | None
        Functions that the template uses as filters.

    Returns
    -------
    str
        The text.
    """
    check_installed()
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
