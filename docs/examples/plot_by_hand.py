"""
Pack a box by hand
==================

Place items one after the other. Before each step, the mask says exactly where the next item fits.
"""

# %%
# Open the built-in library and place three shapes at their bottom-left-back locations.
# ``Box.blbf`` returns ``None`` if an item fits nowhere.

from packit_sim import Box, Item, Scene, ShapeLibrary

library = ShapeLibrary.open("everyday")
box = Box()
for name in ("basketball", "teapot", "coffee-mug"):
    item = Item(library[name], scale=0.5)
    location = box.blbf(item)
    print(name, "fits at", box.feasible(item).sum(), "of 15,625 locations; placed at", location)
    box.place(item, location)
print(f"density {box.density:.3f}")

# %%
# Draw it.

with Scene(box) as scene:
    scene.snapshot(640, 480).save("packed.png")
