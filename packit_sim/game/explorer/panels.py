"""The lists next to a box on a page, as HTML: facts, items and the legend of colours."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from html import escape

from packit_sim.game.explorer.collection import PackView
from packit_sim.render.coloring import Color, ColorKey, Legend, ramp
from packit_sim.web.box_view import rgb

_TABLE = "width:100%;border-collapse:collapse;font-size:12px;line-height:1.35"
_NUMBER = "text-align:right;padding:1px 4px;font-variant-numeric:tabular-nums;white-space:nowrap"
_NAME = "text-align:left;padding:1px 4px;overflow-wrap:break-word"
_HEAD = "font-weight:600;border-bottom:1px solid #adb5bd"
_CHOSEN = "background:#fff3bf;color:#212529"
_AWAY = "opacity:0.5"
_SWATCH = "display:inline-block;width:11px;height:11px;border-radius:2px"
_STEPS = 12
"""Stripes in the colour ramp of a scale."""


def facts(view: PackView) -> str:
    """Render what the pack records about itself, a row for each name and value."""
    rows = "".join(
        f'<tr><td style="{_NAME};opacity:0.65">{escape(name)}</td>'
        f'<td style="{_NAME}">{escape(value)}</td></tr>'
        for name, value in view.facts
    )
    return f'<table style="{_TABLE}">{rows}</table>'


def items(view: PackView, colors: Sequence[Color], step: int, chosen: int | None) -> str:
    """Render all items: colour, number, name, category, volume and reward.

    Parameters
    ----------
    colors : Sequence[Color]
        The colour of each item.
    step : int
        The number of items in the box; the others are pale.
    chosen : int | None
        The number of the item that is marked.

    Returns
    -------
    str
        A table.
    """
    names = ("", "#", "item", "category", "volume", "reward")
    heads = [(name, _NUMBER if name in ("#", "volume", "reward") else _NAME) for name in names]
    head = "".join(f'<th style="{style};{_HEAD}">{name}</th>' for name, style in heads)
    rows = "".join(
        _row(view, n, color, n < min(step, len(view.placed)), n == chosen)
        for n, color in enumerate(colors)
    )
    return (
        f'<table style="{_TABLE}"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
        '<div style="font-size:11px;opacity:0.65;padding:4px">volume: share of the box; '
        "reward: share of all items; pale: not in the box</div>"
    )


def legend(meaning: Legend | None) -> str:
    """Render the legend of colours; "" if they only distinguish items."""
    if meaning is None:
        return ""
    if isinstance(meaning, ColorKey):
        return _lines(f"{_swatch(color)} {escape(name)}" for name, color in meaning.entries)
    stripes = "".join(
        f'<span style="flex:1;background:rgb{rgb(ramp(n / (_STEPS - 1)))}"></span>'
        for n in range(_STEPS)
    )
    return (
        f'<div style="font-size:12px;padding:4px">{escape(meaning.title)}'
        f'<div style="display:flex;height:12px">{stripes}</div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>{escape(meaning.low)}</span><span>{escape(meaning.high)}</span></div></div>"
    )


def _row(view: PackView, number: int, color: Color, inside: bool, chosen: bool) -> str:
    item = view.items[number]
    box = 1e-6 * view.cells[0] * view.cells[1] * view.cells[2]
    cells = (
        (_swatch(color), _NAME),
        (str(number), _NUMBER),
        (escape(item.shape.id), _NAME),
        (escape(item.shape.category), _NAME),
        (f"{item.volume / box:.2%}", _NUMBER),
        (f"{view.reward(number):.1%}", _NUMBER),
    )
    style = ";".join(itertools.compress((_CHOSEN, _AWAY), (chosen, not inside)))
    return (
        f'<tr style="{style}">'
        + "".join(f'<td style="{how}">{what}</td>' for what, how in cells)
        + "</tr>"
    )


def _swatch(color: Color) -> str:
    return f'<span style="{_SWATCH};background:rgb{rgb(color)}"></span>'


def _lines(lines: Iterable[str]) -> str:
    body = "".join(f"<div>{line}</div>" for line in lines)
    return f'<div style="font-size:12px;padding:4px;columns:2">{body}</div>'
