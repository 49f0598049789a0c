"""PackIt-Sim: geometric planning by packing real 3D shapes into a box.

`__all__` is the public API, together with the public submodules that `docs/reference/api.md`
lists. The names and their modules stand in `__init__.pyi`. They are imported when they are first
used, so that `import packit_sim` stays light.

Examples
--------
>>> import packit_sim
>>> packit_sim.__version__
'0.1.0'
>>> "Box" in dir(packit_sim)
True
"""

import lazy_loader

from packit_sim.game.envs.registration import register_with_gymnasium

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

register_with_gymnasium()
