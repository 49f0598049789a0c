"""The plots of a report, as SVG with the page's colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from io import StringIO
from itertools import cycle, product
from typing import Any

from packit_sim.core.confidence import Estimate
from packit_sim.game.reports.runs import EvaluationRun, TrainingRun
from packit_sim.render import plots

WIDTH = 8.0
"""Width of a plot in inches; the page scales it."""

_LINES = ("-", "--", ":", "-.")
"""Line styles: after seven agents colours repeat, with the next style."""


def rewards(played: Sequence[EvaluationRun]) -> str:
    """Plot the Average Reward of each agent with its interval, the best on top."""
    found = sorted(
        ((Estimate.of([r.total for r in one.rollouts]), one.name) for one in played),
        key=lambda pair: pair[0].mean,
    )
    out = StringIO()
    with plots.inlined(out, [["rewards"]], WIDTH, 0.7 + 0.32 * len(found)) as (_, axes):
        ax = axes["rewards"]
        for y, (estimate, _) in enumerate(found):
            if estimate.low is not None and estimate.high is not None:
                ends = (estimate.low, estimate.high)
                ax.plot(
                    ends,
                    (y, y),
                    color=plots.COLORS[0],
                    linewidth=5,
                    alpha=0.35,
                    solid_capstyle="round",
                )
            ax.plot(estimate.mean, y, "o", color=plots.COLORS[0], markersize=6)
            ax.annotate(
                f"{estimate.mean:.3f}",
                (estimate.mean, y),
                (0, 7),
                ha="center",
                textcoords="offset points",
                fontsize=8,
            )
        ax.set_yticks(range(len(found)), [name for _, name in found])
        ax.set(ylim=(-0.6, len(found) - 0.3), xlabel="Average Reward, and its 95% interval")
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
        ax.spines["left"].set_visible(False)
    return out.getvalue()


def returns(played: Sequence[EvaluationRun]) -> str:
    """Plot the share of tasks with a return of x or more, Success@x, over x."""
    out = StringIO()
    with plots.inlined(out, [["returns"]], WIDTH, _height(len(played))) as (figure, axes):
        ax = axes["returns"]
        for one, style in zip(played, _styles(), strict=False):
            x, share = success([rollout.total for rollout in one.rollouts])
            ax.step(x, share, where="pre", label=one.name, **style)
        ax.set(xlabel="return x", ylabel="% of tasks with a return of x or more")
        ax.set(xlim=(0, 1.01), ylim=(0, 102))
        if len(played) > 1:
            figure.legend(loc="outside lower center", ncols=2)
    return out.getvalue()


def success(totals: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return the steps of Success@x in percent: each share holds from the previous x to its own."""
    count = len(totals)
    shares = [100 * (count - n) / count for n in range(count)]
    return [0.0, *sorted(totals), max(totals)], [100.0, *shares, 0.0]


def learning(learned: Sequence[TrainingRun]) -> str:
    """Plot validation rewards with intervals, and training rewards as thin lines, over steps."""
    out = StringIO()
    with plots.inlined(out, [["learning"]], WIDTH, _height(len(learned))) as (figure, axes):
        ax = axes["learning"]
        for one, style in zip(learned, _styles(), strict=False):
            curve = one.run.curve
            steps = [point.steps for point in curve]
            plots.line(
                ax,
                steps,
                [point.validation for point in curve],
                marker="o",
                markersize=3.5,
                label=one.name,
                **style,
            )
            known = [(point.steps, point.reward) for point in curve if point.reward is not None]
            if known:
                at, rewards = zip(*known, strict=True)
                ax.plot(at, rewards, color=style["color"], linewidth=0.9, alpha=0.7)
        ax.set(xlabel="steps", ylabel="Average Reward")
        if len(learned) > 1:
            figure.legend(loc="outside lower center", ncols=2)
    return out.getvalue()


def _height(curves: int) -> float:
    """Return the height in inches of a plot with a legend below it, two curves per line."""
    return 3.7 + 0.23 * ((curves + 1) // 2)


def _styles() -> Iterator[dict[str, Any]]:
    """Yield a colour and a line style for each curve, without end."""
    return cycle(
        {"color": color, "linestyle": line, "linewidth": 1.8}
        for line, color in product(_LINES, plots.COLORS)
    )
