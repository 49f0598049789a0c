"""The summary of packed parts as text: a table of the parts, and the numbers of the packing."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from packit_sim.core.length_units import UNITS_CM
from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.balance import off_middle
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.handling.separability import linked_pairs, links_in_words
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.powder import Powder
from packit_sim.parts.reading.sizes import container_text
from packit_sim.parts.results.check import Check


def summary(packed: PackedParts, found: Check | None = None) -> dict[str, str]:
    """Return the numbers of a packing as text, by name.

    Parameters
    ----------
    found : Check, optional
        The result of `check`; without it the summary says that the check is not done.

    Returns
    -------
    dict of str to str
        The texts, with units.
    """
    task, unit = packed.task, packed.task.unit
    boxes = [packing.container for packing in packed.packings]
    texts = {
        "packed": packed.packed_of_asked,
        "boxes": ", ".join(f"{box.name} {container_text(box, unit)}" for box in boxes) or "none",
        "volume": f"{packed.volume:.6g} {unit}³",
        "density": f"{packed.density:.3f}",
        "height": f"{packed.height:.5g} {unit}",
    }
    if found is not None and not found.problems:  # items in conflict are not linked but wrong
        texts["linked pairs"] = _linked(packed)
    if found is not None and found.distance is not None:
        stretched = f", with z times {task.stretch:.4g}" if task.stretch != 1 else ""
        texts["smallest distance"] = f"{found.distance:.4g} {unit}{stretched}"
    texts["mass"] = "unknown" if packed.mass is None else f"{packed.mass:.5g} g"
    limits = [
        task.limits(each).text(task.masses_in(each), off_middle(task, each).tolist())
        for each in packed.packings
    ]
    if any(limits):
        numbered = [f"box {n}: {text}" for n, text in enumerate(limits, start=1) if text]
        texts["limits"] = limits[0] if len(limits) == 1 else "; ".join(numbered)
    if task.settings.powder is not None:
        texts["powder"] = _powder(packed, task.settings.powder)
    texts |= deliveries(packed)
    by = "mass" if packed.mass is not None else "volume"
    for number, packing in enumerate(packed.packings, start=1):
        name = "centre of gravity" if len(boxes) == 1 else f"centre, box {number}"
        place = ", ".join(f"{each:.4g}" for each in packed.centre_of_gravity(packing))
        texts[name] = f"({place}) {unit}, by {by}"
    if found is None:
        texts["check"] = "not done"
    else:
        count = f"{len(found.problems)} problem{'s' * (len(found.problems) > 1)}"
        texts["check"] = count if found.problems else f"no problems ({found.how})"
    return texts


def _powder(packed: PackedParts, powder: Powder) -> str:
    """Return how much powder the builds of all boxes take."""
    cm3 = UNITS_CM[packed.task.unit] ** 3
    boxes = ((each, each.container) for each in packed.packings)
    bed = plain_sum(each.height * box.volume / box.size[2] for each, box in boxes)
    return powder.text(bed * cm3, packed.volume * cm3, packed.mass or 0.0)


def deliveries(packed: PackedParts) -> dict[str, str]:
    """Return the door of the boxes if it is not the top, and how many parts each stop gets."""
    texts: dict[str, str] = {}
    task = packed.task
    if task.settings.door != "z+":
        texts["door"] = task.settings.door
    counts = Counter(task.stops[one.type] for _, one in packed.placements if task.stops)
    if counts:
        texts["deliveries"] = ", ".join(f"stop {n}: {counts[n]}" for n in sorted(counts))
    return texts


def _linked(packed: PackedParts) -> str:
    """Name the parts that can't be moved apart from each other without turning."""
    found = []
    first = len(packed.task.fixed)
    for number, contents in enumerate(packed.contents, start=1):
        names = []
        for n, one in enumerate(contents.placements, start=-first):
            where = "fixed" if n < 0 else f"part {n} of box {number}"
            names.append(f"{packed.part(one).part.name} ({where})")
        pairs = linked_pairs(contents)
        found += [links_in_words(pairs, names)] if pairs else []
    return "; ".join(found) or "none"


def part_rows(packed: PackedParts) -> list[tuple[str, str, str, str]]:
    """Return for each part its name, how many were asked for and packed, and why others are not.

    Returns
    -------
    list of (str, str, str, str)
        The rows, in the order of the parts. Of a part of which as many as fit are packed, "max" is
        asked, and copies are not missed.
    """
    rows = []
    for n, each in enumerate(packed.task.parts):
        is_max, count = each.part.as_many_as_fit, packed.counts[n]
        why = "" if is_max and count else _why_left_out(packed, each.part)
        rows.append((each.part.name, "max" if is_max else f"{each.part.count}", f"{count}", why))
    return rows


def table(packed: PackedParts, found: Check | None = None) -> str:
    """Return the summary as text, a line for each part, for each number and for each note.

    Parameters
    ----------
    found : Check, optional
        The result of `check`.

    Returns
    -------
    str
        The lines.
    """
    rows = [("part", "asked", "packed", "left out, and why"), *part_rows(packed)]
    rows += [(Path(one.source).name, "", "0", f"file: {one.reason}") for one in packed.unread]
    widths = [max(len(row[n]) for row in rows) for n in range(3)]
    lines = [
        f"{name:<{widths[0]}}  {asked:>{widths[1]}}  {count:>{widths[2]}}  {why}".rstrip()
        for name, asked, count, why in rows
    ]
    lines.append("")
    lines += [f"{name:<18} {value}" for name, value in summary(packed, found).items()]
    lines += [f"note: {note}" for note in packed.notes]
    return "\n".join(lines)


def _why_left_out(packed: PackedParts, part: Part) -> str:
    """Return how many of a part are left out, if it has a count, and why."""
    found = [each for each in packed.left_out if each.name == part.name]
    if part.as_many_as_fit:
        return "; ".join(each.reason for each in found)
    return "; ".join(f"{each.count}: {each.reason}" for each in found)
