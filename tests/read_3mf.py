"""3MF files as slicers read them: by the library of the 3MF Consortium, who wrote the standard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from packit_sim.geometry.arrays import Floats


def bodies(path: Path) -> dict[str, Floats]:
    """Return the triangles (n, 3, 3) of each item to print, in millimetres, by its part number."""
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf is not installed")
    model = lib3mf.get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(path))
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    items, found = model.GetBuildItems(), {}
    while items.MoveNext():
        item = items.GetCurrent()
        mesh = model.GetMeshObjectByID(item.GetObjectResource().GetResourceID())
        rows = np.array([list(row) for row in item.GetObjectTransform().Fields])
        points = np.array([list(each.Coordinates) for each in mesh.GetVertices()])
        faces = np.array([list(each.Indices) for each in mesh.GetTriangleIndices()])
        found[item.GetPartNumber()] = (points @ rows[:3] + rows[3])[faces]
    return found
