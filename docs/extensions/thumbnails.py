"""Alternative texts of the gallery's thumbnails: the titles of their examples."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes

_THUMBNAIL = re.compile(r"sphx_glr_(\w+)_thumb\.")


def setup(app: Any) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("doctree-resolved", _describe)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _describe(app: Any, doctree: nodes.document, name: str) -> None:
    for image in doctree.findall(nodes.image):
        if found := _THUMBNAIL.search(image["uri"]):
            image["alt"] = app.env.titles[f"gallery/{found[1]}"].astext()
