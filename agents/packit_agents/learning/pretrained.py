"""The networks that come with PackIt-Sim, as policies with names of their own.

Their files, and what they are worth, are told in `assets/weights/README.md`.
"""

from __future__ import annotations

from functools import partial

from packit_agents.learning.learned_policies import LearnedShape
from packit_sim.libraries.library import assets_folder

_FOLDER = assets_folder() / "weights"

PackNN = partial(LearnedShape, _FOLDER / "packnn.safetensors")
"""The paper's network, which saw what the paper's sees."""

PackNNProspects = partial(LearnedShape, _FOLDER / "packnn-prospects.safetensors")
"""The paper's network, which also sees how each shape would sit, were it the next."""

PackNNEasy = partial(LearnedShape, _FOLDER / "packnn-easy.safetensors")
"""As `PackNN`, trained by the rules of PackIt-Easy."""
