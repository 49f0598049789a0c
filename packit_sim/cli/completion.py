"""Names that the shell completes: of datasets, instances, and the parts of agents."""

from __future__ import annotations

from packit_sim.core.entry_points import announced
from packit_sim.game.datasets.builtin import BUILTIN_DATASETS
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES

_STAGES = ("shape", "rotation", "location")


def datasets(incomplete: str) -> list[str]:
    """Complete the name of a dataset; the shell itself completes paths."""
    return [name for name in BUILTIN_DATASETS if name.startswith(incomplete)]


def instances(incomplete: str) -> list[str]:
    """Complete the name of a built-in instance."""
    return [name for name in BUILTIN_NAMES if name.startswith(incomplete)]


def agents(incomplete: str) -> list[str]:
    """Complete the part of an agent's name that is typed: a policy of each kind, or a search."""
    plain, plus, search = incomplete.rpartition("+")
    if plus:
        names = announced("packit_sim.searches")
        return [f"{plain}+{name}=" for name in names if name.startswith(search)]
    done = incomplete.split("/")[:-1]
    if len(done) >= len(_STAGES):
        return []
    names = announced(f"packit_sim.{_STAGES[len(done)]}_policies")
    texts = ("/".join((*done, name)) for name in names)
    return [text for text in texts if text.startswith(incomplete)]
