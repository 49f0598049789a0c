"""`packit train`: train PackNN on packs with PPO."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from packit_sim.cli.options import AddressOption
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.extras import needed_for
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import terminal
    from packit_sim.render import plots

if TYPE_CHECKING:
    from packit_agents.learning.training import Progress
    from packit_sim.game.evaluation.learning_curves import CurvePoint


def train_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the training.")],
    config: Annotated[
        Path | None, typer.Option(help="TOML file with settings by name; network is a table.")
    ] = None,
    set: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Setting NAME=VALUE, such as network.width=64; may be repeated."
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="Device: cpu, cuda, or auto.")] = "auto",
    ray_workers: Annotated[
        int, typer.Option(min=0, help="Number of processes of a Ray cluster for the environments.")
    ] = 0,
    address: AddressOption = None,
    logger: Annotated[
        list[str] | None,
        typer.Option(help="Logger of another package, by its name; may be repeated."),
    ] = None,
) -> None:
    """Train a network to choose shapes; its best weights are best.safetensors in the folder.

    The command can be stopped at any time: repeat it to resume. The final weights are the same.
    The agent learned@FOLDER/best.safetensors/aligned/blbf plays with the weights.

    Example: packit train --set steps=100000 --out trainings/first
    """
    with needed_for("trainings"):
        from packit_agents.learning.training import Training
        from packit_agents.learning.training_settings import read_settings
    plots.require()
    settings = read_settings(config, set or [])
    with (
        stoppable(RESUMABLE),
        closing(Training(settings, out, device, ray_workers, address, logger or ())) as training,
    ):
        with terminal.progress_bars() as progress:
            bar = progress.add_task("training", total=settings.steps, note="")

            def show(at: Progress) -> None:
                reward = "" if at.reward is None else f"return {at.reward:.3f}"
                best = "" if at.best is None else f", best {at.best.validation.mean:.3f}"
                progress.update(bar, completed=at.steps, note=reward + best)

            training.run(show)
        draw(training.curve, out / "curve.png")
    best = training.best
    assert best is not None
    terminal.console.print(
        f"best after {best.steps} steps: Average Reward {best.validation.mean:.3f} in validation; "
        f"wrote {out / 'best.safetensors'} and curve.png"
    )


def draw(curve: list[CurvePoint], path: Path) -> None:
    """Draw a learning curve: validation with its interval, and training.

    Parameters
    ----------
    path : Path
        The picture to write.
    """
    with plots.drawn(path, [["reward"]], 8, 5) as (_, axes):
        ax = axes["reward"]
        steps = [point.steps for point in curve]
        validation = [point.validation for point in curve]
        plots.line(ax, steps, validation, color=plots.COLORS[0], marker="o", label="validation")
        known = [(point.steps, point.reward) for point in curve if point.reward is not None]
        if known:
            ax.plot(*zip(*known, strict=True), color=plots.COLORS[1], label="training, sampled")
        ax.set(xlabel="Shape-Selection steps", ylabel="Average Reward", title="Learning curve")
        ax.legend()
