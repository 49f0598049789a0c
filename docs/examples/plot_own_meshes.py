"""
From your own meshes to a picture
=================================

A folder of mesh files is a library: STL, OBJ, PLY, OFF, GLB, glTF, DAE, 3MF and STEP. Subfolders
are categories.
"""

# %%
# Three meshes, as another program could have written them.

import tempfile
from pathlib import Path

from trimesh import creation

from packit_sim import Box, Item, Scene, ShapeLibrary

meshes = {
    "ring": creation.annulus(r_min=20, r_max=40, height=30),
    "rod": creation.cylinder(radius=12, height=90),
    "capsule": creation.capsule(height=60, radius=25),
}
folder = Path(tempfile.mkdtemp())
for name, mesh in meshes.items():
    mesh.export(folder / f"{name}.stl")

library = ShapeLibrary.open(folder)
print(sorted(library))

# %%
# A shape is scaled to a bounding box of diagonal 1. To keep the sizes of the files, give each item
# a scale, which is a ratio of volumes: the cube of the ratio of lengths.

millimetres = 150  # edge of the box
scales = {name: (mesh.scale / millimetres) ** 3 for name, mesh in meshes.items()}

# %%
# Pack as many of each as fit, trying all 24 rotations of each.

box = Box()
for name in library:
    count = 0
    while count < 6:
        items = [Item(library[name], scales[name], rotation) for rotation in range(24)]
        found = [(box.blbf(item), item) for item in items]
        fits = [(location, item) for location, item in found if location is not None]
        if not fits:
            break
        location, item = min(fits, key=lambda fit: fit[0][2])  # the lowest
        box.place(item, location)
        count += 1
    print(f"{count} x {name}")
print(f"density {box.density:.3f}")
with Scene(box) as scene:
    scene.snapshot(640, 480).save("own.png")
