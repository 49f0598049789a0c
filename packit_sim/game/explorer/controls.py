"""The control panel of the explorer: sliders, lists and buttons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from packit_sim.game.explorer.arm_replay import INTERVAL
from packit_sim.game.explorer.collection import PackView
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL, STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import UP_AXES
from packit_sim.render.coloring import COLORINGS
from packit_sim.render.looks import Cut

if TYPE_CHECKING:
    from packit_sim.web.web_page import GuiApi, GuiInputHandle

NOTHING = "nothing"
_WIDTH = 360
_EXPLODE = 1.5


@dataclass(frozen=True)
class ViewRequest:
    """The state of the panel: what it requests.

    Attributes
    ----------
    pack : int
        The number of the pack.
    second : int | None
        The number of the pack next to it.
    step : int
        The number of items in the box.
    seconds : float | None
        The simulated time of the arm; None for the box without the arm.
    explode : float
        The distance by which items are moved apart; 0 for "Why not here?", which needs locations.
    cut : Cut | None
        The plane that cuts the box open.
    coloring : str
        The name of the rule that colours items.
    chosen : int | None
        The number of the selected item.
    wanted : int | None
        The number of the item that "Why not here?" is about.
    """

    pack: int
    second: int | None
    step: int
    seconds: float | None
    explode: float
    cut: Cut | None
    coloring: str
    chosen: int | None
    wanted: int | None
    rotation: int
    location: Triple


class Controls:
    """Sliders, lists and buttons.

    Parameters
    ----------
    gui : GuiApi
        Viser's panel.
    titles : Sequence[str]
        Titles of the packs.
    pack : int
        The number of the pack that is shown at first.
    second : int | None
        The number of the pack next to it.
    changed : Callable[[], None]
        Called after each change of a control, also by the program.
    """

    def __init__(
        self,
        gui: GuiApi,
        titles: Sequence[str],
        pack: int,
        second: int | None,
        changed: Callable[[], None],
    ) -> None:
        self._titles = titles
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_WIDTH)
        self._pack = gui.add_dropdown("pack", titles, initial_value=titles[pack])
        switch = gui.add_button_group("", ("previous", "next"), visible=len(titles) > 1)
        switch.on_click(lambda event: self.switch_pack(-1 if switch.value == "previous" else 1))
        side = NOTHING if second is None else titles[second]
        self.second = gui.add_dropdown(
            "second pack", tuple(dict.fromkeys((NOTHING, side))), initial_value=side
        )
        self.second.visible = len(titles) > 1
        self._step = gui.add_slider("step", 0, 1, 1, 1, hint="how many items are in the box")
        self.arm = gui.add_checkbox("show the arm", False, visible=False)
        self._seconds = gui.add_slider(
            "seconds", 0.0, 1.0, INTERVAL, 0.0, visible=False, hint="simulated time"
        )
        self.play = gui.add_button("Play")
        self.notice = gui.add_markdown("", visible=False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Items"):
            self.item = gui.add_dropdown("item", (NOTHING,), hint="or click it in the box")
            self.items = gui.add_html("")
        with tabs.add_tab("Look"):
            self.explode = gui.add_slider("explode", 0.0, _EXPLODE, 0.05, 0.0)
            self.axis = gui.add_dropdown("cut across", (NOTHING, *UP_AXES))
            self._at = gui.add_slider("cut at", 0.0, 1.0, STEP * CELL / 4, 0.5, disabled=True)
            self._color = gui.add_dropdown("colours", tuple(COLORINGS))
            self.legend = gui.add_html("")
        with tabs.add_tab("Why not here?"):
            self.wanted = gui.add_dropdown("item outside", (NOTHING,))
            self._rotation = gui.add_slider("rotation", 0, rotations.COUNT - 1, 1, 0)
            self._location = tuple(gui.add_slider(axis, 0, 24, 1, 0) for axis in UP_AXES)
            self.first = gui.add_button("To the first free place")
            self.answer = gui.add_markdown("")
        with tabs.add_tab("About"):
            self.facts = gui.add_html("")
        handles: list[GuiInputHandle[Any]] = [
            self._pack,
            self.second,
            self.item,
            self.axis,
            self.arm,
            self._seconds,
        ]
        handles += [self._color, self.wanted, self._step, self.explode, self._at, self._rotation]
        handles += self._location
        for handle in handles:
            _on_update(handle, changed)

    @property
    def request(self) -> ViewRequest:
        """The current state of all controls."""
        axis = next((axis for axis in UP_AXES if axis == self.axis.value), None)
        x, y, z = (slider.value for slider in self._location)
        wanted = _number(self.wanted.value)
        return ViewRequest(
            self._titles.index(self._pack.value),
            None if self.second.value == NOTHING else self._titles.index(self.second.value),
            self._step.value,
            self._seconds.value if self.arm.value else None,
            self.explode.value if wanted is None else 0.0,
            None if axis is None else Cut(axis, max(self._at.value, CELL)),
            self._color.value,
            _number(self.item.value),
            wanted,
            self._rotation.value,
            (x, y, z),
        )

    def set_rivals(self, rivals: Sequence[int], second: int | None) -> None:
        """Offer packs for the place next to the first one, and select one."""
        self.second.options = (NOTHING, *(self._titles[n] for n in rivals))
        _set(self.second, NOTHING if second is None else self._titles[second])

    def set_steps(self, steps: int) -> None:
        """Set the number of steps, and show all of them."""
        self._step.max = max(1, steps)
        _set(self._step, steps)

    def set_seconds(self, seconds: float) -> None:
        """Show a moment of the arm."""
        _set(self._seconds, seconds)

    def set_arm(self, offered: bool) -> None:
        """Offer the arm, if one packed the box, or do not."""
        self.arm.visible = offered
        _set(self.arm, False)

    def set_replay(self, last: float | None) -> None:
        """Show the slider of the arm's time up to its last moment, or the one of steps."""
        self._step.visible, self._seconds.visible = last is None, last is not None
        if last is not None:
            self._seconds.max = last

    def set_pack(self, view: PackView) -> None:
        """Offer the items and the extents of another pack, with nothing selected."""
        _set(self.item, NOTHING)
        _set(self.wanted, NOTHING)
        self.item.options = (NOTHING, *(label(view, n) for n in range(len(view.items))))
        self.axis.disabled = not view.is_on_grid
        self._at.max = max(view.cells) * CELL
        for slider, nodes in zip(self._location, grid_nodes(view.cells), strict=True):
            _set(slider, 0)
            slider.max = nodes - 1

    def set_outside(self, view: PackView, step: int) -> None:
        """Offer the items that are outside after a number of steps; none if the others settled."""
        first = min(step, len(view.placed)) if view.is_on_grid else len(view.items)
        options = (NOTHING, *(label(view, n) for n in range(first, len(view.items))))
        if options != self.wanted.options:
            self.wanted.options = options

    def enable(self, request: ViewRequest) -> None:
        """Enable the position of a cut if there is one, and the location if an item is wanted."""
        self._at.disabled = request.cut is None
        idle = request.wanted is None
        self.explode.disabled = not idle
        for handle in (self._rotation, *self._location, self.first):
            handle.disabled = idle

    def show_notice(self, notice: str) -> None:
        """Show a line above the lists, "" for none."""
        self.notice.visible = bool(notice)
        self.notice.content = notice

    def set_step(self, step: float) -> None:
        """Show a number of items."""
        _set(self._step, int(step))

    def choose(self, view: PackView, number: int) -> None:
        """Select an item, or none if it is selected already."""
        text = label(view, number)
        _set(self.item, NOTHING if self.item.value == text else text)

    def set_query(self, rotation: int, location: Triple) -> None:
        """Set the rotation and the location of "Why not here?"."""
        _set(self._rotation, rotation)
        for slider, node in zip(self._location, location, strict=True):
            _set(slider, node)

    def switch_pack(self, by: int) -> None:
        """Select another pack; the first follows the last."""
        number = self._titles.index(self._pack.value) + by
        _set(self._pack, self._titles[number % len(self._titles)])


def label(view: PackView, number: int) -> str:
    """Return an item's entry in a list."""
    left = "" if number < len(view.placed) else " (left outside)"
    return f"{number} {view.items[number].shape.id}{left}"


def _number(text: str) -> int | None:
    """Return the number of the item with this entry."""
    return None if text == NOTHING else int(text.partition(" ")[0])


def _set(handle: GuiInputHandle[Any], value: object) -> None:
    handle.value = value  # type: ignore[misc] # viser's setter stands apart from its property


def _on_update(handle: GuiInputHandle[Any], changed: Callable[[], None]) -> None:
    handle.on_update(lambda event: changed())
