"""The kernel that converts a renderer's pixels to those of a picture.

Colours are means over squares of samples (supersampling); depth and segmentation are those of one
sample, since a mean of two bodies' numbers or depths would be of neither. Outlines are drawn from
the bodies' numbers, not from colours, so that equal colours side by side stay apart. One pass over
the samples, in float32, without intermediate pictures.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def resolve(rgba, buffer, bodies, items, back, samples, outline, planes):
    """Return the colours, the depth and the segmentation of a picture.

    Parameters
    ----------
    rgba : ndarray
        (H * samples, W * samples, 4) uint8, the renderer's colours.
    buffer : ndarray
        (H * samples, W * samples) float32, the renderer's depth buffer.
    bodies : ndarray
        (H * samples, W * samples) int32, the body in each pixel, -1 for none.
    items : ndarray
        int32, the number of each body's item.
    back : ndarray
        (H, W, 3) float32, the colours where there is no body.
    samples : int
        A pixel of the picture is the mean of `samples` by `samples` pixels.
    outline : float
        Share of the brightness that a pixel keeps if its right or lower neighbour shows another
        body.
    planes : tuple of float
        Near and far: the depths at which the buffer is 0 and 1.

    Returns
    -------
    image : ndarray
        (H, W, 3) float32, colours.
    depth : ndarray
        (H, W) float32, inf where there is no body.
    segmentation : ndarray
        (H, W) int32, numbers of items, -1 for none.
    """
    near, far = planes
    height, width = bodies.shape[0] // samples, bodies.shape[1] // samples
    image = np.zeros((height, width, 3), np.float32)
    depth = np.empty((height, width), np.float32)
    segmentation = np.empty((height, width), np.int32)
    weight = np.float32(1 / samples**2)
    for row in range(height):
        for column in range(width):
            for y in range(row * samples, (row + 1) * samples):
                for x in range(column * samples, (column + 1) * samples):
                    body = bodies[y, x]
                    edge = x + 1 < bodies.shape[1] and bodies[y, x + 1] != body
                    edge |= y + 1 < bodies.shape[0] and bodies[y + 1, x] != body
                    share = weight * np.float32(outline) if edge else weight
                    for channel in range(3):
                        if body < 0:
                            image[row, column, channel] += share * back[row, column, channel]
                        else:
                            image[row, column, channel] += share * rgba[y, x, channel]
            body = bodies[row * samples, column * samples]
            if body < 0:
                depth[row, column] = np.inf
                segmentation[row, column] = -1
            else:
                # The inverse of the perspective depth of OpenGL's buffer, in float64: near the far
                # plane the difference below loses most of its digits.
                part = np.float64(buffer[row * samples, column * samples])
                depth[row, column] = far * near / (far - (far - near) * part)
                segmentation[row, column] = items[body] if body < len(items) else -1
    return image, depth, segmentation
