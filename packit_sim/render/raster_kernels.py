"""The kernel of the software renderer: triangles into a depth buffer.

A pixel is covered if its centre has no negative barycentric coordinate (edge functions, Pineda,
1988). The inverse depth is linear on the screen, so it is interpolated and compared instead of the
depth, and brightness divided by depth is interpolated with it (perspective-correct, Blinn, 1992).
Triangles are not cut at the near plane: those that pass the camera are left out.

Only the target is written. Of equal depths the first triangle stays, so that a picture depends on
the order of bodies alone.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def draw_triangles(target, points, lights, faces, sides, body, color):
    """Draw triangles over what is behind them.

    Parameters
    ----------
    target : tuple of ndarray
        The pixels: inverse depths (H, W) float64, 0 where there is nothing; colours (H, W, 4)
        uint8; bodies (H, W) int32.
    points : ndarray
        (n, 3) float64: column, row and inverse depth of each vertex; a triangle with a vertex whose
        inverse depth is not positive is not drawn.
    lights : ndarray
        (n, 2) float64: brightness of each vertex from the front and from the back.
    faces : ndarray
        (m, 3) int64, vertices of each triangle.
    sides : ndarray
        (m, 2) bool: whether the front, and the back, of each triangle may be visible.
    body : int
        The number to write.
    color : tuple of float
        Red, green and blue at brightness 1, from 0 to 255.
    """
    inverse, rgba, bodies = target
    height, width = bodies.shape
    for n in range(len(faces)):
        a, b, c = faces[n]
        xa, ya, wa = points[a]
        xb, yb, wb = points[b]
        xc, yc, wc = points[c]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        side = 0 if area < 0 else 1  # rows count downwards
        if area == 0 or min(wa, wb, wc) <= 0 or not sides[n, side]:
            continue
        # Rows and columns whose centres are within the bounds of the triangle and of the picture.
        low = max(0, int(np.ceil(min(ya, yb, yc) - 0.5)))
        high = min(height - 1, int(np.floor(max(ya, yb, yc) - 0.5)))
        left = max(0, int(np.ceil(min(xa, xb, xc) - 0.5)))
        right = min(width - 1, int(np.floor(max(xa, xb, xc) - 0.5)))
        la, lb, lc = lights[a, side], lights[b, side], lights[c, side]
        for row in range(low, high + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                u = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) / area
                v = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) / area
                t = 1 - u - v
                if u < 0 or v < 0 or t < 0:
                    continue
                depth = u * wa + v * wb + t * wc
                if depth <= inverse[row, column]:
                    continue
                inverse[row, column] = depth
                bodies[row, column] = body
                light = (u * wa * la + v * wb * lb + t * wc * lc) / depth
                for channel in range(3):
                    rgba[row, column, channel] = min(255, int(light * color[channel] + 0.5))
