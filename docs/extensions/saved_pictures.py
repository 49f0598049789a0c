"""Pictures of the gallery: the PNG and GIF files that an example saves.

An example shows what a user would write, `scene.snapshot().save("packed.png")`, and the file is
moved to the page.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst


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
