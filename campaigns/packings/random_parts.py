"""Random shapes of a few centimetres, and random motions."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from campaigns.packings import shapes
from campaigns.packings.shapes import Floats, Shape

Random = np.random.Generator

QUARTERS: Floats = Rotation.create_group("O").as_matrix().round(12)
"""The 24 rotations of the cube."""


def random_shape(rng: Random, planar: bool = False, flawed: bool = False) -> Shape:
    """Draw a shape.

    Parameters
    ----------
    planar : bool
        Whether it is a prism, with few planar faces.
    flawed : bool
        Whether it may have two bodies, lack a small triangle, or be inverted.

    Returns
    -------
    Shape
        The shape.
    """
    x, y, z = (float(each) for each in rng.uniform(8, 35, 3))
    wall, steps = float(rng.uniform(2, 4)), int(rng.integers(5, 11))
    prisms = (
        lambda: shapes.box((x, y, z)),
        lambda: shapes.extruded(shapes.polygon(steps, x / 2, y / 2, 0.3), z),
        lambda: shapes.bracket(x, y, z, wall),
        lambda: shapes.channel(x, y, z, min(wall, 0.4 * x)),
    )
    others = (
        lambda: shapes.tube(x / 2, 0.3 * x, z, steps),
        lambda: shapes.cup(x / 2, 0.4 * x, z, wall, steps),
        lambda: shapes.ball(x / 2, steps),
    )
    makers = prisms if planar else (*prisms, *others)
    found = makers[int(rng.integers(len(makers)))]()
    flaw = rng.random() if flawed else 1.0
    if flaw < 0.15:
        other = prisms[0]()
        shift = np.eye(4)
        shift[:3, 3] = 0, 0, found.vertices[:, 2].max() + float(rng.uniform(0.5, 4))
        return shapes.united([found, other.moved(shift)])
    if flaw < 0.3:
        diagonal = float(np.linalg.norm(np.ptp(found.vertices, axis=0)))
        return shapes.pierced(found, int(rng.integers(len(found.triangles))), 0.006 * diagonal)
    if flaw < 0.4:
        return shapes.Shape(found.vertices, found.polygons, found.triangles, inverted=True)
    return found


def motion(rng: Random, far: bool) -> Floats:
    """Draw a motion (4, 4): no rotation, a quarter turn or any, and a translation.

    Parameters
    ----------
    far : bool
        Whether it may be metres long.

    Returns
    -------
    ndarray of float64, shape (4, 4)
        The motion.
    """
    found, choice = np.eye(4), rng.random()
    if choice > 0.5:
        found[:3, :3] = QUARTERS[int(rng.integers(24))]
    if choice > 0.9:
        found[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    reach = float(rng.choice([0.0, 100.0, 3000.0 if far else 100.0]))
    found[:3, 3] = rng.uniform(-reach, reach, 3)
    return found
