"""A report as one self-contained HTML file, by Jinja."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packit_sim.core import templates
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.core.version import __version__
from packit_sim.game.reports import charts, tables
from packit_sim.game.reports.examples import Gallery
from packit_sim.game.reports.runs import Runs
from packit_sim.render import plots
from packit_sim.render.coloring import ramp
from packit_sim.web.page_models import page_texts


@dataclass(frozen=True)
class Headline:
    """The result in one sentence.

    Attributes
    ----------
    best : str
        The agent with the highest Average Reward.
    reward : str
        Its Average Reward and the interval, as text.
    """

    agents: int
    tasks: int
    best: str
    reward: str


def page(title: str, runs: Runs, gallery: Gallery | None, command: str) -> str:
    """Render the report; the same runs give the same text.

    Parameters
    ----------
    runs : Runs
        The results.
    gallery : Gallery | None
        The boxes to show, if any.
    command : str
        The command that reproduces the report.

    Returns
    -------
    str
        HTML.
    """
    plots.require()
    here = Path(__file__).parent

    content: dict[str, Any] = {
        "title": title,
        "version": __version__,
        "command": command,
        "headline": _headline(runs),
        "runs": runs,
        "gallery": gallery,
        "tables": tables,
        "charts": charts,
        "ramp": [f"rgb({', '.join(f'{255 * c:.0f}' for c in ramp(n / 8))})" for n in range(9)],
        "sorting": (here / "sorting.js").read_text(encoding="utf-8"),
        **page_texts(),
        "models": gallery.models.to_json() if gallery else None,
    }
    return templates.render(here / "page.html", content, html=True)


def _headline(runs: Runs) -> Headline | None:
    if not runs.played:
        return None
    found = [(Estimate.of([r.total for r in one.rollouts]), one.name) for one in runs.played]
    best, name = max(found, key=lambda pair: pair[0].mean)
    tasks = {rollout.task_digest for one in runs.played for rollout in one.rollouts}
    return Headline(len(found), len(tasks), name, format_estimate(best, ".3f"))
