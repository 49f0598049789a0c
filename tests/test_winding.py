"""Winding numbers: 1 inside a closed surface, 0 outside, and a share of it for an open one."""

import numpy as np
import pytest
from trimesh import creation

from packit_sim.geometry.winding import winding_numbers

BALL = np.asarray(creation.icosphere(subdivisions=3, radius=1.0).triangles)


def test_a_closed_surface_winds_once_around_points_inside() -> None:
    points = np.random.default_rng(3).normal(size=(200, 3))
    radius = np.linalg.norm(points, axis=1)
    points = points[abs(radius - 1) > 0.02]
    inside = np.linalg.norm(points, axis=1) < 1
    assert winding_numbers(BALL, points) == pytest.approx(inside.astype(float), abs=1e-9)
    assert winding_numbers(BALL[:, ::-1], points) == pytest.approx(-inside.astype(float), abs=1e-9)


def test_an_open_surface_winds_by_the_share_of_directions_in_which_it_is_seen() -> None:
    upper = BALL[BALL[:, :, 2].mean(axis=1) > 0]
    middle, far = winding_numbers(upper, np.array([(0, 0, 0), (0, 0, 100.0)]))
    assert middle == pytest.approx(0.5, abs=0.02)
    assert abs(far) < 1e-3
    assert winding_numbers(np.concatenate([BALL, BALL]), np.zeros((1, 3))) == pytest.approx([2])
