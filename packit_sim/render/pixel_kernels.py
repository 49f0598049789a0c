"""The kernel that turns a renderer's pixels into those of a picture."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def resolve(rgba, buffer, bodies, items, back, samples, outline, planes):
    """Return colours (H, W, 3) float32, depth (H, W), segmentation (H, W), -1 for no item.

    rgba: (H * samples, W * samples, 4), and buffer and bodies of that height and width: the
    renderer's pixels; one pixel of the picture is the mean of `samples` by `samples`. items: the
    number of each body's item. back: (H, W, 3), the colours where there is no body. Pixels whose
    right or lower neighbour shows another body keep the share `outline` of their brightness.
    planes: near and far, depths at which the buffer is 0 and 1; without a body depth is inf.
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
                part = np.float64(buffer[row * samples, column * samples])
                depth[row, column] = far * near / (far - (far - near) * part)
                segmentation[row, column] = items[body] if body < len(items) else -1
    return image, depth, segmentation
