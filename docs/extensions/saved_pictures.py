"""Pictures of the gallery: the PNG and GIF files that an example saves, and pages in 3D.

An example shows what a user would write, `scene.snapshot().save("packed.png")`, and the file is
moved to the page. The report page of a folder that `export` writes becomes a frame in it.
"""

from __future__ import annotations

import html
import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst

REPORT = "packing.html"
"""The page of a packing in a folder."""


def saved_pictures(
    block: tuple[Any, ...], block_vars: dict[str, Any], gallery_conf: dict[str, Any]
) -> str:
    """Move the pictures that a block of an example saved next to its page.

    Parameters
    ----------
    block : tuple
        The block; not used.
    block_vars : dict
        What sphinx-gallery knows about it: the example's file, the paths for its pictures.
    gallery_conf : dict
        The gallery's settings.

    Returns
    -------
    str
        reStructuredText that shows the pictures; empty if there are none.
    """
    folder = Path(block_vars["src_file"]).parent
    if reports := sorted(folder.glob(f"*/{REPORT}")):
        return "".join(map(_framed, reports))
    moved = []
    for saved in sorted(
        (file for suffix in ("*.png", "*.gif") for file in folder.glob(suffix)),
        key=lambda file: file.stat().st_mtime_ns,
    ):
        target = Path(next(block_vars["image_path_iterator"])).with_suffix(saved.suffix)
        shutil.move(saved, target)
        moved.append(str(target))
    title = next(
        line
        for line in Path(block_vars["src_file"]).read_text("utf-8").splitlines()
        if line.strip('"')
    )
    return figure_rst(moved, gallery_conf["src_dir"], title)


def _framed(report: Path) -> str:
    """Return a frame with a report page, whose folder is removed."""
    content = html.escape(report.read_text("utf-8")).replace("\n", "&#10;")
    shutil.rmtree(report.parent)
    frame = f'<iframe class="turnable" title="The packed box in 3D" srcdoc="{content}"></iframe>'
    return f"\n.. raw:: html\n\n    {frame}\n\n"
