"""The report page of a packing: the summary, the parts, and the boxes in 3D."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from packit_sim.core import templates
from packit_sim.core.files import replace_text
from packit_sim.core.sums import plain_sum
from packit_sim.core.version import __version__
from packit_sim.parts.filling.answers import FilledBox
from packit_sim.parts.results.box_pictures import shown
from packit_sim.web.page_models import Models, page_texts

if TYPE_CHECKING:
    from packit_sim.parts.results.packed import PackedParts


def add_box(models: Models, packed: PackedParts, box: FilledBox) -> int:
    """Add a box with all that is in it to the models of a page; return its number."""
    state = shown(packed.contents(box))
    return models.add(state.cells, state.placed, plain_sum(p.item.volume for p in state.placed))


def write_page(packed: PackedParts, path: Path) -> Path:
    """Write the page as one self-contained HTML file.

    Parameters
    ----------
    packed : PackedParts
        The packed parts.
    path : Path
        The file.

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    OSError
        If the file can't be written.
    """
    here = Path(__file__).parent
    models = Models()
    boxes = [
        {
            "name": box.type.name,
            "model": add_box(models, packed, box),
            "count": len(box.packing.placements),
        }
        for box in packed.boxes
    ]
    placed = packed.task.counts([one for _, one in packed.placements])
    parts = [
        {
            "name": each.part.name,
            "asked": each.part.count,
            "packed": placed.get(n, 0),
            "why": "; ".join(
                f"{out.count}: {out.reason}"
                for out in packed.left_out
                if out.name == each.part.name
            ),
        }
        for n, each in enumerate(packed.task.parts)
    ]
    content = {
        "version": __version__,
        "summary": packed.summary(),
        "parts": parts,
        "problems": packed.problems,
        "notes": packed.notes,
        "found": packed.check.problems,
        "boxes": boxes,
        **page_texts(),
        "models": models.to_json(),
    }
    replace_text(path, templates.render(here / "packing_page.html", content, html=True))
    return path
