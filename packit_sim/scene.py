"""The public face of rendering: a box and its items in a headless world, and pictures of it."""

from packit_sim.render.cameras import Camera
from packit_sim.render.looks import Look
from packit_sim.render.rendering import Snapshot
from packit_sim.render.scene import Scene

__all__ = ["Camera", "Look", "Scene", "Snapshot"]
