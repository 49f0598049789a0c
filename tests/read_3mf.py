"""3MF files as strict readers read them: by the library of the 3MF Consortium."""

from __future__ import annotations

from pathlib import Path

import lib3mf
import numpy as np

from packit_sim.geometry.arrays import Floats


def bodies(path: Path) -> dict[str, Floats]:
    """Return the triangles (n, 3, 3) of each item to print, in millimetres, by its name.

    The file must be of the standard without a single warning; each item must have its own name,
    which is also its part number, and one mesh.
    """
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    items, found = model.GetBuildItems(), {}
    while items.MoveNext():
        item = items.GetCurrent()
        own = item.GetObjectResource()
        assert own.GetName() == item.GetPartNumber() and own.GetName() not in found
        assert own.GetComponentCount() == 1 and not own.GetComponent(0).HasTransform()
        mesh = own.GetComponent(0).GetObjectResource()
        rows = np.array([list(row) for row in item.GetObjectTransform().Fields])
        points = np.array([list(each.Coordinates) for each in mesh.GetVertices()])
        faces = np.array([list(each.Indices) for each in mesh.GetTriangleIndices()])
        found[own.GetName()] = (points @ rows[:3] + rows[3])[faces]
    return found
