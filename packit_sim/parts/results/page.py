"""The report page of a packing: the summary, the parts, and the boxes in 3D."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from packit_sim.core import templates
from packit_sim.core.files import replace_text
from packit_sim.core.length_units import Unit
from packit_sim.core.sums import plain_sum
from packit_sim.core.version import __version__
from packit_sim.geometry.lattice import CELL
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.layers import layers
from packit_sim.parts.packings.outlines import outline
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.results.check import Check
from packit_sim.parts.results.pictures import part_colors, shown
from packit_sim.parts.results.summary import part_rows, summary
from packit_sim.web.page_models import Models, page_texts


def add_box(models: Models, contents: Packing) -> int:
    """Add a box with all that is in it to the models of a page; return its number."""
    state = shown(contents)
    total = plain_sum(p.item.volume for p in state.placed)
    lines = outline(contents.container) * (max(state.cells) * CELL / contents.container.longest)
    return models.add(state.cells, state.placed, total, part_colors(contents), lines)


def _plot(packing: Packing, unit: Unit) -> dict[str, Any]:
    """Return the numbers of the plot of a box's layers: shares of its base, by height."""
    found, container = layers(packing), packing.container
    base = container.volume / container.size[2] if form_of(container) != "mesh" else 0.0
    most = base or float(found.areas.max(initial=0.0)) or 1.0
    return {
        "shares": (found.areas / most).tolist(),
        "counts": found.counts.tolist(),
        "top": f"{packing.height:.5g} {unit}",
        "base": f"{most:.6g} {unit}²",
        "variation": f"{found.variation:.3f}",
        "most": int(found.counts.max(initial=0)),
    }


def write_page(packed: PackedParts, found: Check | None, path: Path) -> Path:
    """Write the page as one self-contained HTML file.

    Parameters
    ----------
    found : Check, optional
        The result of their check.

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
            "name": packing.container.name,
            "model": add_box(models, contents),
            "count": len(packing.placements),
            "layers": _plot(packing, packed.task.unit),
        }
        for packing, contents in zip(packed.packings, packed.contents, strict=True)
    ]
    copies: dict[int, list[str]] = {}
    for box, contents in zip(boxes, packed.contents, strict=True):
        for n, one in enumerate(contents.placements):
            copies.setdefault(one.type, []).append(f"{box['model']}:{n}")
    shown_parts = [
        {"name": packed.task.all_parts[n].part.name, "copies": copies[n]} for n in sorted(copies)
    ]
    content = {
        "version": __version__,
        "summary": summary(packed, found),
        "parts": part_rows(packed),
        "problems": packed.unread,
        "notes": packed.notes,
        "found": found.problems if found else (),
        "boxes": boxes,
        "shown_parts": shown_parts,
        **page_texts(),
        "models": models.to_json(),
    }
    replace_text(path, templates.render(here / "page.html", content, html=True))
    return path
