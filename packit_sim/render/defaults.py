"""Limits and defaults of pictures and exports, as plain values."""

RGB = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

BACKGROUND: RGB = (246, 247, 249)
"""The colour of the background."""

MAX_SIDE = 2048
"""The largest width and height of an image, in pixels."""

UNIT_MM = 100.0
"""Default millimetres per box unit, in formats for 3D printing."""
