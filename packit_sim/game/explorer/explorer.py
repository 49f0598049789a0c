"""A web page to explore packs and results: step by step, cut open, side by side."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import PackItError
from packit_sim.game.explorer import panels
from packit_sim.game.explorer.arm_replay import FPS, INTERVAL, ArmReplay
from packit_sim.game.explorer.collection import PackCollection, PackView
from packit_sim.game.explorer.controls import Controls, ViewRequest
from packit_sim.game.explorer.markers import FitMarkers
from packit_sim.game.explorer.query import FitQuery
from packit_sim.game.explorer.redraw_thread import RedrawThread
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, ORIGIN, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.render.coloring import COLORINGS, UNKNOWN_COLOR, ByShare, Color, Legend, by_order
from packit_sim.web.box_view import BoxView, DisplaySettings, over, reach
from packit_sim.web.origins import LOOPBACK
from packit_sim.web.web_page import WebPage

PACE = 0.5
"""Seconds between two items during playback."""

_GAP = 0.35
"""Distance between two boxes, as a share of the first one's width."""

_BLOCKING = 0.35
"""Opacity of blockers, so that the blocked item is visible through them."""

_NODES = ("/first", "/second")
"""Names of the two boxes' nodes in the scene."""

_HINT = "Choose an item that is outside. At an earlier step there are more of them."

_SETTLED_HINT = "These items settled off the grid: there is no box at an earlier step to ask about."


class Explorer:
    """A web page that shows the packs of a collection.

    Close it, or use it in a `with` statement.

    Parameters
    ----------
    collection : PackCollection
        The packs that the page offers.
    pack : int
        The number of the pack that is shown at first.
    second : int | None
        The number of the pack next to it.
    host : str
        The address at which the page is served, see `WebPage`.
    port : int | None
        The same.

    Raises
    ------
    PackItError
        If the collection has no such pack.
    RenderError
        If the page cannot be served.

    Examples
    --------
    >>> from packit_sim import Explorer, PackCollection
    >>> with Explorer(PackCollection.read("starter"), pack=2) as explorer:
    ...     print(explorer.address)
    http://127.0.0.1:...
    """

    address: str
    """The page's URL for a browser on this machine."""

    def __init__(
        self,
        collection: PackCollection,
        pack: int = 0,
        second: int | None = None,
        *,
        host: str = LOOPBACK,
        port: int | None = None,
    ) -> None:
        self._collection = collection
        self.views = [collection[n] for n in (pack, second) if n is not None]
        self._drawn: ViewRequest | None = None
        self._boxes: list[BoxView] = []
        self._query: FitQuery | None = None
        self._replay: ArmReplay | None = None
        self._due: float | None = None
        self._playing = False
        self._thread = RedrawThread(self._work)
        self.page = WebPage(host, port)
        self.address = self.page.address
        try:
            server = self.page.server
            self.controls = Controls(server.gui, collection.titles, pack, second, self._thread.wake)
            self._markers = FitMarkers(server, "/markers")
            self.controls.play.on_click(lambda event: self.play(not self._playing))
            self.controls.first.on_click(lambda event: self.to_first())
            self._thread.start()
        except BaseException:
            self.page.close()
            raise
        self.wait()

    @property
    def boxes(self) -> tuple[BoxView, ...]:
        """The one or two boxes in the scene."""
        return tuple(self._boxes)

    def play(self, playing: bool = True) -> None:
        """Start playback, from the beginning if it is at the end; or stop it."""
        self._playing = playing
        self._thread.wake()

    def wait(self, timeout: float = 60.0) -> None:
        """Wait until the page shows what is requested; raise TimeoutError after `timeout` s."""
        self._thread.wait(timeout)

    def close(self) -> None:
        """End the page, its server and its threads; calling it again does nothing."""
        self._thread.close()
        self.page.close()

    def __enter__(self) -> Explorer:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _work(self) -> float | None:
        """Draw what is requested; return the seconds until the next step of playback."""
        try:
            with self.page.server.atomic():
                request = self._apply_request()
                if request != self._drawn:
                    self._draw(request)
                    self._drawn = request
        except PackItError as error:
            self._playing = False
            self.controls.show_notice(f"**This can't be shown:** {error}")
            return None
        self.controls.show_notice("")
        return self._play_on(request)

    def _apply_request(self) -> ViewRequest:
        """Set lists and ranges to the requested packs, and return the resulting request."""
        request, drawn = self.controls.request, self._drawn
        other = drawn is None or request.pack != drawn.pack
        if other:
            rivals = self._collection.rivals(request.pack)
            second = request.second if request.second in rivals else None
            self.controls.set_rivals(rivals, second)
            request = self.controls.request
        if drawn is None or (request.pack, request.second) != (drawn.pack, drawn.second):
            numbers = [n for n in (request.pack, request.second) if n is not None]
            self.views = [self._collection[n] for n in numbers]
            if other:
                self._replay = None
                self.controls.set_arm(self.views[0].has_arm)
                self.controls.set_pack(self.views[0])
                self.controls.facts.content = panels.facts(self.views[0])
            self.controls.set_steps(self._steps)
            self._create_boxes()
            request = self.controls.request
        view = self.views[0]
        request = self.controls.request
        if request.seconds is not None and self._replay is None:
            self._replay = ArmReplay.of(self._collection.trajectory(request.pack))
        if drawn is None or (request.seconds is None) != (drawn.seconds is None):
            shown = self._replay if request.seconds is not None else None
            self.controls.set_replay(None if shown is None else shown.seconds)
        self.controls.set_outside(view, request.step)
        request = self.controls.request
        if request.wanted is not None and (drawn is None or request.wanted != drawn.wanted):
            placed = view.placed[request.wanted] if request.wanted < len(view.placed) else None
            if isinstance(placed, PlacedItem):
                self.controls.set_query(placed.item.rotation, placed.location)
            else:
                self.controls.set_query(0, ORIGIN)
        return self.controls.request

    @property
    def _steps(self) -> int:
        return max(len(view.placed) for view in self.views)

    def _create_boxes(self) -> None:
        """Create the boxes of the packs."""
        for box in self._boxes:
            box.remove()
        self._boxes = [
            BoxView(self.page.server, name, partial(self.choose, n))
            for n, name in enumerate(_NODES[: len(self.views)])
        ]

    def _arrange(self, request: ViewRequest) -> None:
        """Arrange the boxes side by side, with titles, and move cameras so that all is in view."""
        explode = request.explode
        places = _places([view.cells for view in self.views], explode)
        seen = []
        for view, box, place in zip(self.views, self._boxes, places, strict=True):
            box.move(place)
            points = reach(view.contents(), explode)
            if len(self._boxes) > 1:
                head = over(view.cells, points)
                box.title(view.name, head)
                points = np.vstack((points, head))
            seen.append(points + place)
        if request.seconds is not None and self._replay is not None:
            seen.append(self._replay.at(0.0).points)
        self.page.frame(np.concatenate(seen))

    def _draw(self, request: ViewRequest) -> None:
        first, drawn = self.views[0], self._drawn
        where = _arrangement(request)
        if drawn is None or where != _arrangement(drawn):
            self._arrange(request)
        colors, legend = _colored(self.views, request.coloring)
        self._query = self._query_of(request)
        for n, (view, box) in enumerate(zip(self.views, self._boxes, strict=True)):
            inside, focus = len(view.placed), self._focus(n, view, request)
            display = DisplaySettings(
                request.step,
                request.explode,
                request.cut if view.is_on_grid else None,
                colors[n][:inside],
                focus,
                1.0 if self._query is None else _BLOCKING,
            )
            if n == 0 and request.seconds is not None and self._replay is not None:
                replay = self._replay
                display = DisplaySettings(colors=replay.colors, layout=replay.at(request.seconds))
                box.show(replay.contents, display)
                box.label(None)
                continue
            box.show(view.contents(), display)
            chosen = None if request.chosen is None else first.items[request.chosen]
            same = [] if chosen is None else sorted(view.same(chosen))
            box.label(next((m for m in same if m < request.step), None))
        self.controls.enable(request)
        self.controls.legend.content = panels.legend(legend)
        self.controls.items.content = panels.items(first, colors[0], request.step, request.chosen)
        if self._query is None:
            self._markers.remove()
            self.controls.answer.content = _HINT if first.is_on_grid else _SETTLED_HINT
        else:
            self._markers.show(self._query, request.location)
            answer = self._query.answer(request.location)
            self.controls.answer.content = f"**{answer}**\n\n{self._query.summary()}"

    def _focus(self, n: int, view: PackView, request: ViewRequest) -> frozenset[int] | None:
        """Return the items that stay opaque: blockers of the wanted item, or the selected one."""
        if self._query is not None:
            found = self._query.blockers(request.location)
            return frozenset((*found.items, *found.above)) if n == 0 else None
        if request.chosen is None:
            return None
        same = frozenset([request.chosen])
        if n > 0:
            same = view.same(self.views[0].items[request.chosen])
        return same if any(m < min(request.step, len(view.placed)) for m in same) else None

    def _query_of(self, request: ViewRequest) -> FitQuery | None:
        """Return the requested query, the previous one if nothing but the location changed."""
        if request.wanted is None:
            return None
        drawn, view = self._drawn, self.views[0]
        if (
            self._query is not None
            and drawn is not None
            and replace(drawn, location=request.location) == request
        ):
            return self._query
        item = view.items[request.wanted].turned(request.rotation)
        return FitQuery(view.box(request.step), item)

    def _play_on(self, request: ViewRequest) -> float | None:
        """Take the next step of playback if it is due; return the seconds until then."""
        now = time.monotonic()
        if request.seconds is None or self._replay is None:
            at, last, by, pace = float(request.step), float(self._steps), 1.0, PACE
            show: Callable[[float], None] = self.controls.set_step
        else:
            at, last, by, pace = request.seconds, self._replay.seconds, INTERVAL, 1 / FPS
            show = self.controls.set_seconds
        if not self._playing:
            self._due = None
        elif self._due is None:
            self._due = now + pace
            if at >= last:
                show(0)
        elif at >= last:
            self._playing, self._due = False, None
        elif now >= self._due:
            self._due = now + pace
            show(min(at + by, last))
        self.controls.play.label = "Pause" if self._playing else "Play"
        return None if self._due is None else max(0.0, self._due - now)

    def choose(self, n: int, number: int) -> None:
        """Select the clicked item of one of the boxes in the first one."""
        first, view = self.views[0], self.views[n]
        if self._drawn is not None and self._drawn.seconds is not None and n == 0:
            return
        item = view.items[number]
        same = [number] if n == 0 else [m for m, one in enumerate(first.items) if _same(one, item)]
        if same:
            self.controls.choose(first, same[0])

    def to_first(self) -> None:
        """Ask about the first location at which the item outside fits."""
        query = self._query
        if query is not None and query.first is not None:
            self.controls.set_query(query.item.rotation, query.first)


def _places(cells: Sequence[Triple], explode: float) -> npt.NDArray[np.float64]:
    """Compute positions (n, 3) of one or two boxes, clear of each other's items."""
    places = np.zeros((len(cells), 3))
    if len(cells) > 1:  # on the right, as the camera sees it
        first, second = cells[0][0], cells[1][0]
        places[1, 0] = -CELL * (second + _GAP * first + explode * (first + second) / 2)
    return places


def _arrangement(request: ViewRequest) -> tuple[object, ...]:
    """Return what decides where boxes are, and what is in view."""
    return request.pack, request.second, request.explode, request.seconds is not None


def _same(a: Item, b: Item) -> bool:
    return (a.shape, a.scale) == (b.shape, b.scale)


def _colored(views: Sequence[PackView], name: str) -> tuple[list[tuple[Color, ...]], Legend | None]:
    """Colour the items of each pack by the same rule, and return the legend."""
    if name == "order":
        ordered = [by_order([placed.item for placed in e.placed]) for e in views]
        left = [(UNKNOWN_COLOR,) * len(view.outside) for view in views]
        return [o.of + rest for o, rest in zip(ordered, left, strict=True)], ordered[0].legend
    rule = ByShare(views[0].total) if name == "share" else COLORINGS[name]
    both = rule([item for view in views for item in view.items])
    middle = len(views[0].items)
    return [both.of[:middle], both.of[middle:]][: len(views)], both.legend
