"""Pages of the site that were not written for it.

Some include a file of the project's root, such as `CONTRIBUTING.md`. Links between such files work
in a checkout; on the site they lead to the pages that include them. Others are tables that
`packit reproduce` wrote.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

PAGES = {
    "ARCHITECTURE.md": "docs/project/architecture.md",
    "CHANGELOG.md": "docs/project/changelog.md",
    "CONTRIBUTING.md": "docs/project/contributing.md",
    "assets/README.md": "docs/reference/datasets.md",
}
"""The page of each file that the included ones link to."""


def relink(app: Sphinx, path: Path, page: str, content: list[str]) -> None:
    """Change the links of an included file.

    Parameters
    ----------
    app : Sphinx
        The application.
    path : Path
        The path of the file, from the sources of the site.
    page : str
        The name of the page that includes it.
    content : list of str
        Its text, changed in place.
    """
    for file, target in PAGES.items():
        content[0] = content[0].replace(f"]({file}", f"]({target}")


def promote(app: Sphinx, page: str, source: list[str]) -> None:
    """Give a page that `packit reproduce` wrote, whose heading is of level 2, one of level 1.

    Parameters
    ----------
    app : Sphinx
        The application.
    page : str
        The name of the page.
    source : list of str
        Its text, changed in place.
    """
    if page.startswith("reproduced/") and source[0].startswith("## "):
        source[0] = source[0][1:]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the handlers with Sphinx.

    Parameters
    ----------
    app : Sphinx
        The application.

    Returns
    -------
    dict
        That the extension may run in parallel.
    """
    app.connect("include-read", relink)
    app.connect("source-read", promote)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
