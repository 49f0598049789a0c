"""Choices by name: plain types, so that the command line lists them without what they choose."""

from typing import Literal, get_args

Axis = Literal["x", "y", "z"]
"""Axes that may point up in a mesh file."""

BackendName = Literal["loky", "ray"]
"""Processes of this machine (loky), or of a Ray cluster (the extra `cluster`)."""

BoxStyle = Literal["edges", "ghost", "none"]
"""How the box is drawn."""

ColoringName = Literal["item", "category", "order", "share", "stability"]
"""What the colours of items mean."""

Door = Literal["x-", "x+", "y-", "y+", "z+"]
"""Sides of a box through which parts come in: an axis, and its lower or upper end."""

Goal = Literal["volume", "count", "value", "height", "boxes"]
GroupRule = Literal["together", "apart", "kit"]
"""Objectives: most volume, parts or value; or all parts, lowest or in the fewest boxes."""

LoadingOrder = Literal["delivery"]
"""Orders of loading: the reverse of the stops at which parts are delivered."""

RotationSet = Literal["all", "yaw"]
"""Sets of rotations: all 24, or the four about the vertical axis."""

SearchBackend = Literal["threads", "ray"]
"""Threads of this process, or processes of a Ray cluster."""

Split = Literal["train", "test", "validation"]

SPLITS: tuple[str, ...] = get_args(Split)
"""The three splits of a library (paper, section 3)."""
