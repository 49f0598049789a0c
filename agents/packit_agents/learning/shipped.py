"""The networks that come with PackIt-Sim, as policies with names of their own.

Their files, and what they are worth, are told in `assets/weights/README.md`.
"""

from __future__ import annotations

from functools import partial

from packit_agents.learning.learned import LearnedLocation, LearnedRotation, LearnedShape
from packit_sim.libraries.library import assets_folder

_FOLDER = assets_folder() / "weights"

PackNN = partial(LearnedShape, _FOLDER / "packnn.safetensors")
"""The paper's network, which saw what the paper's sees."""

PackNNEasy = partial(LearnedShape, _FOLDER / "packnn-easy.safetensors")
"""The same, trained on PackIt-Easy."""

PackNNProspects = partial(LearnedShape, _FOLDER / "packnn-prospects.safetensors")
"""The paper's network, which also sees how each shape would sit, were it the next."""

_ALL = _FOLDER / "packnn-all.safetensors"

AllShapes = partial(LearnedShape, _ALL)
"""Of the agent all of whose policies were learned: packnn-all/packnn-all/packnn-all."""

AllRotations = partial(LearnedRotation, _ALL)
"""Of the same agent."""

AllLocations = partial(LearnedLocation, _ALL)
"""Of the same agent."""
