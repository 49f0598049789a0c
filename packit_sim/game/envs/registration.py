"""The ids of the environments, registered with Gymnasium without importing it.

Gymnasium has no entry points for other packages: a package registers its environments when it is
imported. `import packit_sim` must not import Gymnasium. If Gymnasium is not imported yet, a finder
on `sys.meta_path` waits for it, and registers the ids right after Gymnasium's registry.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `importlib.abc` alone would load 40 modules
    from collections.abc import Sequence
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec
    from types import ModuleType

ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "PackIt-v0": {},
    "PackItEasy-v0": {"easy": True},
    "PackItPhysics-v0": {"physics": True},
    "PackItRobot-v0": {"robot": True},
}
"""The default settings of each id, to which `gymnasium.make` adds its own."""

CONTINUOUS = "PackItContinuous-v0"
"""The id of the environment off the grid."""

_REGISTRY = "gymnasium.envs.registration"


def register_with_gymnasium() -> None:
    """Register the environments, now or as soon as Gymnasium is imported."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
    if _REGISTRY in sys.modules:
        _register()


def _register() -> None:
    from gymnasium.envs.registration import register, registry

    for name, settings in ENVIRONMENTS.items():
        if name not in registry:
            register(
                name,
                entry_point="packit_sim.game.envs.env:PackItEnv",
                vector_entry_point="packit_sim.game.envs.vector:PackItVectorEnv",
                kwargs=settings,
            )
    if CONTINUOUS not in registry:
        register(CONTINUOUS, "packit_sim.game.envs.continuous:PackItContinuousEnv")


class _Finder:
    """Lets the other finders find Gymnasium's registry, and wraps its loader."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _REGISTRY:
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        found = (finder.find_spec(fullname, path, target) for finder in others)
        spec = next((spec for spec in found if spec is not None), None)
        if spec is not None and spec.loader is not None:
            spec.loader = _Loader(spec.loader)  # type: ignore[assignment] # not a subclass
        return spec


class _Loader:
    """Executes a module with its own loader, then registers the environments."""

    def __init__(self, own: Loader) -> None:
        self._own = own

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._own.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__loader__ = self._own
        if module.__spec__ is not None:
            module.__spec__.loader = self._own
        self._own.exec_module(module)
        _register()
