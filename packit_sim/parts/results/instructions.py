"""Packing instructions: printable pages with pictures, a step for each part."""

from __future__ import annotations

import base64
import io
import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from packit_sim.core import templates
from packit_sim.core.choices import BoxStyle, Door
from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import replace_text
from packit_sim.core.progress import Progress, unseen
from packit_sim.core.version import __version__
from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.motions import IDENTITY
from packit_sim.geometry.shapes import Item
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.order import require_known_ways, ways_in
from packit_sim.parts.handling.sweeps import PartSweeps, sweeps_of
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.posed_parts import contents, outline_items
from packit_sim.parts.results.wording import (
    DOORS,
    place_in_words,
    turn_in_words,
    way_in_words,
)
from packit_sim.render.cameras import Camera
from packit_sim.render.coloring import Color, Colors
from packit_sim.render.defaults import RGB
from packit_sim.render.image_files import RGBImage
from packit_sim.render.looks import Look
from packit_sim.scene import Scene

WHITE: RGB = (255, 255, 255)

NEW: Color = (0.90, 0.45, 0.0)
"""The colour of the part of a step."""

OLD: Color = (0.66, 0.70, 0.75)
"""The colour of the parts that are in the box already."""

LARGE, SMALL = (1000, 720), (420, 340)
"""Pixels of the picture of a step, and of the small ones below it."""

_COLORS = 128
"""Colours of a picture file."""

FROM_THE_FRONT = Camera(azimuth=-68.0, elevation=32.0)
"""The front wall, y = 0, and a little of the right one."""

FROM_THE_DOOR: Mapping[Door, Camera] = {
    "x-": Camera(azimuth=-125.0, elevation=32.0),
    "x+": Camera(azimuth=-55.0, elevation=32.0),
}
"""The same for doors that it does not show well."""

OTHER_VIEWS = Camera(azimuth=-112.0, elevation=32.0), Camera(azimuth=-68.0, elevation=60.0)
"""Cameras for steps whose part other parts hide: from the left, and from higher up."""

_VISIBLE = 0.01
"""The share of a picture that the part of its step should have."""

FROM_ABOVE = Camera(azimuth=-90.0, elevation=89.9, fov=20.0)
"""The front wall at the lower edge."""


@dataclass(frozen=True)
class Step:
    """A step of packing.

    Attributes
    ----------
    number : int
        From 1 on, in its box.
    name : str
        The part's name.
    stop : int, optional
        The stop at which it is delivered.
    turn, way, place : str
        How to turn it, how to put it in, and where it is then.
    picture, above, own, turned : str
        Pictures as data URIs: the box, the box from above, the part as in its file and as packed.
    """

    number: int
    name: str
    stop: int | None
    turn: str
    way: str
    place: str
    picture: str
    above: str
    own: str
    turned: str


@dataclass(frozen=True)
class BoxSteps:
    """The steps of packing one box.

    Attributes
    ----------
    name : str
        The name of the box.
    size : str
        Its sides, with the unit.
    door : str
        Where parts come in.
    parts : tuple of (str, int or None, int)
        The names of its parts, the stop of each, and how many of it.
    picture : str
        The packed box, as a data URI.
    """

    name: str
    size: str
    door: str
    parts: tuple[tuple[str, int | None, int], ...]
    steps: tuple[Step, ...]
    picture: str


def write_instructions(packed: PackedParts, path: Path | str, progress: Progress = unseen) -> Path:
    """Write printable instructions for packing parts, as one self-contained HTML file.

    Parameters
    ----------
    path : Path or str
        The HTML file.
    progress : callable, optional
        Called with the number of steps that are drawn.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ArgumentError
        If nothing is packed.
    OSError
        If the file can't be written.
    """
    several = len(packed.contents) > 1
    boxes = [
        (f"Box {n}: {contents.container.name}" if several else "Box", contents)
        for n, contents in enumerate(packed.contents, start=1)
    ]
    constraints = packed.task.constraints
    return packing_instructions(
        path, boxes, packed.task.unit, constraints=constraints, progress=progress
    )


def packing_instructions(
    path: Path | str,
    boxes: Sequence[tuple[str, Packing]],
    unit: str = "mm",
    title: str = "Packing instructions",
    constraints: Constraints | None = None,
    progress: Progress = unseen,
) -> Path:
    """Write printable instructions for any packings, as one self-contained HTML file.

    Parameters
    ----------
    path : Path or str
        The HTML file.
    boxes : sequence of (str, Packing)
        The names of boxes, and their packings; a packing of several boxes becomes several.
    unit : str, default: "mm"
        The name of the unit of length.
    constraints : Constraints, optional
        The constraints that the packings meet: the door through which parts come in and by which
        moves, and the stops at which they are delivered. The fixed parts are in the box from the
        start, if there is one packing.
    progress : callable, optional
        Called with the number of steps that are drawn.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ArgumentError
        If there is no part to pack.
    OSError
        If the file can't be written.
    """
    if not any(packing.placements for _, packing in boxes):
        raise ArgumentError("there are no instructions for a packing without parts")
    for name, packing in boxes:
        require_known_ways("instructions", name, packing)
    met = constraints or Constraints()
    total = sum(len(packing.placements) for _, packing in boxes) - len(met.fixed)
    drawn = itertools.count()

    def next_step() -> None:
        progress("drawing the instructions", next(drawn), total)

    steps = [one for name, packing in boxes for one in _boxes(name, packing, unit, met, next_step)]
    here = Path(__file__).parent
    content = {
        "title": title,
        "version": __version__,
        "boxes": steps,
        "style": (here / "instructions.css").read_text(encoding="utf-8"),
    }
    path = Path(path)
    replace_text(path, templates.render(here / "instructions.html", content, html=True))
    return path


def _boxes(
    name: str,
    packing: Packing,
    unit: str,
    constraints: Constraints,
    next_step: Callable[[], object],
) -> Iterator[BoxSteps]:
    """Yield the steps of each box of a packing."""
    sweeps = sweeps_of(packing)
    numbers = sorted({placement.box for placement in packing.placements})
    for count, box in enumerate(numbers, start=1):
        own = [n for n, placement in enumerate(packing.placements) if placement.box == box]
        label = name if len(numbers) == 1 else f"{name}, {count} of {len(numbers)}"
        yield _box(label, sweeps, own, unit, constraints, next_step)


def _box(
    name: str,
    sweeps: PartSweeps,
    own: Sequence[int],
    unit: str,
    constraints: Constraints,
    next_step: Callable[[], object],
) -> BoxSteps:
    packing, fixed = sweeps.packing, constraints.fixed
    order, routes = ways_in(sweeps, own, constraints)
    whole, lines = contents(packing, order), outline_items(packing)
    box: BoxStyle = "none" if lines else "edges"
    start = len(fixed.intersection(own))
    front = FROM_THE_DOOR.get(constraints.door, FROM_THE_FRONT)
    steps = []
    alone: dict[tuple[str, bytes], str] = {}
    with Scene(BoxState(whole.cells, ())) as scene:
        for n, part in enumerate(order[start:], start=start):
            next_step()
            placement, item = packing.placements[part], whole.placed[n]
            scene.update(BoxState(whole.cells, (*lines, *whole.placed[: n + 1])))
            picture = _step_picture(scene, n + len(lines), box, front)
            from_above = Look(FROM_ABOVE, WHITE, box, coloring=_new)
            above = _data(scene.snapshot(*SMALL, from_above).image)
            file = _alone(scene, _as_in_file(item), alone)
            packed = _alone(scene, item, alone)
            way = (
                way_in_words(routes[part], unit)
                if part in routes
                else "No straight way in was found: put it in together with the parts around it."
            )
            steps.append(
                Step(
                    n + 1 - start,
                    packing.types[placement.type].name,
                    constraints.stops.get(placement.type),
                    turn_in_words(placement.pose.rotation),
                    way,
                    place_in_words(sweeps.low[part] * sweeps.unit, unit),
                    picture,
                    above,
                    file,
                    packed,
                )
            )
        scene.update(BoxState(whole.cells, (*whole.placed, *lines)))
        last = _data(scene.snapshot(*LARGE, Look(front, WHITE, box)).image)
    counts = Counter((step.name, step.stop) for step in steps)
    parts = tuple((*each, count) for each, count in counts.items())
    size, door = _size(packing.container, unit), DOORS[constraints.door]
    return BoxSteps(name, size, door, parts, tuple(steps), last)


def _size(container: Container, unit: str) -> str:
    if isinstance(container, CylinderContainer):
        return f"cylinder of {container.diameter:g} x {container.height:g} {unit}"
    x, y, z = container.size
    height = "open at the top" if container.is_strip else f"{z:g}"
    return f"{x:g} x {y:g} x {height} {unit}"


def _step_picture(scene: Scene, new: int, box: BoxStyle, front: Camera) -> str:
    """Draw a box so that one of its parts is visible."""
    best, most = None, -1.0
    for camera in (front, *OTHER_VIEWS):
        found = scene.snapshot(*LARGE, Look(camera, WHITE, box, coloring=_new))
        share = float((found.segmentation == new).mean())
        if share > most:
            best, most = found, share
        if most >= _VISIBLE:
            break
    assert best is not None
    return _data(best.image)


def _new(items: Sequence[Item]) -> Colors:
    """Give the last item its own colour."""
    return Colors((*(OLD,) * (len(items) - 1), NEW) if items else ())


def _as_in_file(item: PosedItem) -> PosedItem:
    """Return an item in the orientation of its file."""
    return PosedItem.at(item.item, IDENTITY)


def _alone(scene: Scene, item: PosedItem, known: dict[tuple[str, bytes], str]) -> str:
    """Draw a part alone, each orientation once."""
    key = item.item.shape.digest, item.linear.round(9).tobytes()
    if key not in known:
        scene.update(BoxState((1, 1, 1), (item,)))
        look = Look(FROM_THE_FRONT, WHITE, "none", coloring=_new)
        known[key] = _data(scene.snapshot(*SMALL, look).image)
    return known[key]


def _data(image: RGBImage) -> str:
    """Encode a picture as a data URI."""
    file = io.BytesIO()
    flat = Image.fromarray(image).quantize(_COLORS, Image.Quantize.FASTOCTREE)
    flat.save(file, format="PNG")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
