"""The pretrained networks, as policies with names.

`assets/weights/README.md` describes their files and their results.
"""

from __future__ import annotations

from functools import partial

from packit_agents.learning.learned_policies import LearnedShape
from packit_sim.core.assets import assets_folder

_FOLDER = assets_folder() / "weights"

PACKNN = partial(LearnedShape, _FOLDER / "packnn.safetensors")
"""The paper's network with the paper's observation."""

PACKNN_PLACEMENT = partial(LearnedShape, _FOLDER / "packnn-placement.safetensors")
"""The paper's network, which also observes placement features."""

PACKNN_EASY = partial(LearnedShape, _FOLDER / "packnn-easy.safetensors")
"""The same network, trained with the rules of PackIt-Easy."""
