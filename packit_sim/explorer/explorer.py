"""A page on which packs and results are explored: step by step, cut open, side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from packit_sim.box import Box
from packit_sim.core.errors import PackItError
from packit_sim.engine.feasibility import ORIGIN
from packit_sim.explorer import panels
from packit_sim.explorer.answers import ShownAnswer
from packit_sim.explorer.controls import Asked, Controls
from packit_sim.explorer.exhibits import Collection, Exhibit
from packit_sim.explorer.questions import Question
from packit_sim.explorer.workers import Worker
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.render.coloring import COLORINGS, UNKNOWN, ByShare, Color, Legend, by_order
from packit_sim.viewer.boxes import Display, ShownBox, over, reach
from packit_sim.viewer.pages import LOOPBACK, Page

PACE = 0.5
"""Seconds between two items while the sequence is played."""

_GAP = 0.35
"""Between two boxes, as a share of the first one's width."""

_BLOCKING = 0.35
"""How opaque items are that are in another's way: it can be seen through them."""

_NAMES = ("/first", "/second")
"""Of the two boxes' nodes in the scene."""

_HOW_TO_ASK = "Choose an item that is outside, or go back some steps to have more of them."


class Explorer:
    """A collection on a web page of its own.

    pack: what is shown at first. beside: what stands at its side. host, port: where the page
    listens (see `Page`). Close it, or use it in a `with`. Raises PackItError where the collection
    has no such pack, and RenderError where there can be no page.
    """

    address: str
    """Where a browser on this machine finds the page."""

    def __init__(
        self,
        collection: Collection,
        pack: int = 0,
        beside: int | None = None,
        *,
        host: str = LOOPBACK,
        port: int | None = None,
    ) -> None:
        self._collection = collection
        self._exhibits = [collection[n] for n in (pack, beside) if n is not None]
        self._drawn: Asked | None = None
        self._boxes: list[ShownBox] = []
        self._question: Question | None = None
        self._due: float | None = None
        self._playing = False
        self._worker = Worker(self._work)
        self._page = Page(host, port)
        self.address = self._page.address
        try:
            server = self._page.server
            self.controls = Controls(server.gui, collection.titles, pack, beside, self._worker.wake)
            self._answer = ShownAnswer(server, "/answer")
            self.controls.play.on_click(lambda event: self.play(not self._playing))
            self.controls.first.on_click(lambda event: self._to_first())
            self._worker.start()
        except BaseException:
            self._page.close()
            raise
        self.settle()

    @property
    def boxes(self) -> tuple[ShownBox, ...]:
        """What is in the scene, one or two."""
        return tuple(self._boxes)

    def play(self, playing: bool = True) -> None:
        """Plays the sequence from where it is, from the start at its end; or stops it."""
        self._playing = playing
        self._worker.wake()

    def settle(self, timeout: float = 60.0) -> None:
        """Waits until the page shows what it is asked for. Raises TimeoutError."""
        self._worker.settle(timeout)

    def close(self) -> None:
        """Ends the page, its server and its threads, and frees the port; once more does nothing."""
        self._worker.close()
        self._page.close()

    def __enter__(self) -> Explorer:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _work(self) -> float | None:
        """Draws what is asked for; returns when to go on where the sequence is played."""
        try:
            with self._page.server.atomic():
                asked = self._arranged()
                if asked != self._drawn:
                    self._draw(asked)
                    self._drawn = asked
        except PackItError as error:
            self._playing = False
            self.controls.tell(f"**This can't be shown:** {error}")
            return None
        self.controls.tell("")
        return self._play_on(asked.step)

    def _arranged(self) -> Asked:
        """What is asked for, once the lists and the ranges are those of the packs asked for."""
        asked, drawn = self.controls.asked, self._drawn
        other = drawn is None or asked.pack != drawn.pack
        if other:
            rivals = self._collection.rivals(asked.pack)
            beside = asked.beside if asked.beside in rivals else None
            self.controls.offer_rivals(rivals, beside)
            asked = self.controls.asked
        if drawn is None or (asked.pack, asked.beside) != (drawn.pack, drawn.beside):
            numbers = [n for n in (asked.pack, asked.beside) if n is not None]
            self._exhibits = [self._collection[n] for n in numbers]
            if other:
                self.controls.offer_pack(self._exhibits[0])
                self.controls.facts.content = panels.facts(self._exhibits[0])
            self.controls.offer_steps(self._steps)
            self._put_up()
            asked = self.controls.asked
        exhibit = self._exhibits[0]
        self.controls.offer_outside(exhibit, asked.step)
        asked = self.controls.asked
        if asked.wanted is not None and (drawn is None or asked.wanted != drawn.wanted):
            if asked.wanted < len(exhibit.placed):
                placed = exhibit.placed[asked.wanted]
                self.controls.ask(placed.item.rotation, placed.location)
            else:
                self.controls.ask(0, ORIGIN)
        return self.controls.asked

    @property
    def _steps(self) -> int:
        return max(len(exhibit.placed) for exhibit in self._exhibits)

    def _put_up(self) -> None:
        """Boxes for the exhibits."""
        for box in self._boxes:
            box.remove()
        self._boxes = [
            ShownBox(self._page.server, name, partial(self._choose, n))
            for n, name in enumerate(_NAMES[: len(self._exhibits)])
        ]

    def _stand(self, explode: float) -> None:
        """The boxes side by side, with titles, and cameras that see all that is in them whole."""
        places = _places([exhibit.cells for exhibit in self._exhibits], explode)
        seen = []
        for exhibit, box, place in zip(self._exhibits, self._boxes, places, strict=True):
            box.move(place)
            points = reach(exhibit.at(len(exhibit.placed)), explode)
            if len(self._boxes) > 1:
                head = over(exhibit.cells, points)
                box.title(exhibit.name, head)
                points = np.vstack((points, head))
            seen.append(points + place)
        self._page.frame(np.concatenate(seen))

    def _draw(self, asked: Asked) -> None:
        first, drawn = self._exhibits[0], self._drawn
        where = asked.pack, asked.beside, asked.explode
        if drawn is None or where != (drawn.pack, drawn.beside, drawn.explode):
            self._stand(asked.explode)
        colors, legend = _colored(self._exhibits, asked.coloring)
        self._question = self._questioned(asked)
        for n, (exhibit, box) in enumerate(zip(self._exhibits, self._boxes, strict=True)):
            inside, focus = len(exhibit.placed), self._focus(n, exhibit, asked)
            display = Display(
                asked.step,
                asked.explode,
                asked.cut,
                colors[n][:inside],
                focus,
                1.0 if self._question is None else _BLOCKING,
            )
            box.show(exhibit.at(inside), display)
            chosen = None if asked.chosen is None else first.items[asked.chosen]
            same = [] if chosen is None else sorted(exhibit.same(chosen))
            box.label(next((m for m in same if m < asked.step), None))
        self.controls.enable(asked)
        self.controls.legend.content = panels.legend(legend)
        self.controls.items.content = panels.items(first, colors[0], asked.step, asked.chosen)
        if self._question is None:
            self._answer.remove()
            self.controls.answer.content = _HOW_TO_ASK
        else:
            self._answer.show(self._question, asked.location)
            answer = self._question.answer(asked.location)
            self.controls.answer.content = f"**{answer}**\n\n{self._question.summary()}"

    def _focus(self, n: int, exhibit: Exhibit, asked: Asked) -> frozenset[int] | None:
        """The items that stay solid: what is in the way of a wanted one, or what is chosen."""
        if self._question is not None:
            found = self._question.blockers(asked.location)
            return frozenset((*found.items, *found.above)) if n == 0 else None
        if asked.chosen is None:
            return None
        same = frozenset([asked.chosen])
        if n > 0:
            same = exhibit.same(self._exhibits[0].items[asked.chosen])
        return same if any(m < min(asked.step, len(exhibit.placed)) for m in same) else None

    def _questioned(self, asked: Asked) -> Question | None:
        """The question asked, the same as before where it is the same."""
        if asked.wanted is None:
            return None
        drawn, exhibit = self._drawn, self._exhibits[0]
        if (
            self._question is not None
            and drawn is not None
            and replace(drawn, location=asked.location) == asked
        ):
            return self._question
        box = Box(exhibit.cells, kinematic=exhibit.kinematic)
        box.restore(exhibit.at(asked.step))
        return Question(box, exhibit.items[asked.wanted].turned(asked.rotation))

    def _play_on(self, step: int) -> float | None:
        """The next step of the sequence, where it is due; returns the seconds until then."""
        now = time.monotonic()
        if not self._playing:
            self._due = None
        elif self._due is None:
            self._due = now + PACE
            if step >= self._steps:
                self.controls.set_step(0)
        elif step >= self._steps:
            self._playing, self._due = False, None
        elif now >= self._due:
            self._due = now + PACE
            self.controls.set_step(step + 1)
        self.controls.play.label = "Pause" if self._playing else "Play"
        return None if self._due is None else max(0.0, self._due - now)

    def _choose(self, n: int, number: int) -> None:
        """What a click on an item of one of the boxes does: it is chosen in the first one."""
        first, exhibit = self._exhibits[0], self._exhibits[n]
        item = exhibit.items[number]
        same = [number] if n == 0 else [m for m, one in enumerate(first.items) if _same(one, item)]
        if same:
            self.controls.choose(first, same[0])

    def _to_first(self) -> None:
        question = self._question
        if question is not None and question.first is not None:
            self.controls.ask(question.item.rotation, question.first)


def _places(cells: Sequence[Triple], explode: float) -> npt.NDArray[np.float64]:
    """(n, 3) where one or two boxes of such cells stand, clear of each other's items."""
    places = np.zeros((len(cells), 3))
    if len(cells) > 1:  # on the right, as the camera sees it
        first, second = cells[0][0], cells[1][0]
        places[1, 0] = -CELL * (second + _GAP * first + explode * (first + second) / 2)
    return places


def _same(a: Item, b: Item) -> bool:
    return (a.shape, a.scale) == (b.shape, b.scale)


def _colored(
    exhibits: Sequence[Exhibit], name: str
) -> tuple[list[tuple[Color, ...]], Legend | None]:
    """The colours of each exhibit's items, by the same rule, and what they mean."""
    if name == "order":
        ordered = [by_order([placed.item for placed in e.placed]) for e in exhibits]
        left = [(UNKNOWN,) * len(exhibit.outside) for exhibit in exhibits]
        return [o.of + rest for o, rest in zip(ordered, left, strict=True)], ordered[0].legend
    rule = ByShare(exhibits[0].total) if name == "share" else COLORINGS[name]
    both = rule([item for exhibit in exhibits for item in exhibit.items])
    middle = len(exhibits[0].items)
    return [both.of[:middle], both.of[middle:]][: len(exhibits)], both.legend
