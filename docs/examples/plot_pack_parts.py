"""
Pack parts from Python
======================

Pack meshes at their real sizes, with a distance between them, and film how they come in.
"""

# %%
# Three plates, two pins and a ring, in millimetres. ``Part`` also takes what a manifest says, such
# as a density; mesh files can be given by their paths.

from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.parts import check, export, film, table

parts = [
    Part("plate", creation.box((80, 50, 10)), count=3, density=7.8),
    Part("pin", creation.capsule(height=60, radius=12), count=2, rotations="upright", density=2.7),
    Part("ring", creation.annulus(r_min=12, r_max=22, height=8), density=7.8),
]

# %%
# Keep a millimetre between parts. With a number of iterations instead of a time, the packing is the
# same in each run. Every part must be removable by straight moves; gravity plays no role here.

settings = PackSettings(clearance=1, removable=True, workers=1, iterations=20)
packed = pack(parts, "100x60x90mm", settings=settings)
print(table(packed))

# %%
# The packing is checked by its meshes once more, and filmed: each part comes in by the moves that
# were checked.

assert not check(packed).problems
film(packed, "packing.gif")

# %%
# ``export`` writes the files of ``packit pack``. Its page shows the box in 3D: drag it to turn it,
# cut it open, or take parts out. It is one file that needs no network.

files = export(packed, "packed")
