"""Links from docstrings to the public names, wherever these are defined.

Signatures name a class by the module that defines it, `packit_sim.geometry.shapes.Item`, or as the
docstring's author wrote it, `Item`. The reference documents it as `packit_sim.Item`.
"""

from __future__ import annotations

from typing import Any

from docutils.nodes import Element
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain
from sphinx.environment import BuildEnvironment

import packit_sim


def link(app: Sphinx, env: BuildEnvironment, node: pending_xref, text: Element) -> Element | None:
    """Find the public name that a reference means.

    Parameters
    ----------
    app : Sphinx
        The application.
    env : BuildEnvironment
        Its environment.
    node : pending_xref
        The reference that Sphinx could not resolve.
    text : Element
        What it shows.

    Returns
    -------
    Element or None
        The link; None if the name is not public.
    """
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"].lstrip("~.")
    parts = target.split(".")
    known = env.domains.python_domain.objects
    for first in range(len(parts)):
        if parts[first] in packit_sim.__all__:
            public = ".".join(["packit_sim", *parts[first:]])
            if public in known:
                domain: PythonDomain = env.domains.python_domain
                return domain.resolve_xref(
                    env, node["refdoc"], app.builder, "obj", public, node, text
                )
    return None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the handler with Sphinx.

    Parameters
    ----------
    app : Sphinx
        The application.

    Returns
    -------
    dict
        That the extension may run in parallel.
    """
    app.connect("missing-reference", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
