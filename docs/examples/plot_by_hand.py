"""
Pack a box by hand
==================

Place items one after the other. Before each step, a mask says exactly where the next item fits.
"""

# %%
# Open the built-in library and place three shapes at their bottom-left-back-fill locations.
# ``Box.blbf`` returns ``None`` if an item fits nowhere.

from packit_sim import Box, Item, Scene, ShapeLibrary

library = ShapeLibrary.open("everyday")
box = Box()
for name in ("basketball", "teapot", "coffee-mug"):
    item = Item(library[name], scale=0.5)
    mask = box.feasible(item)  # bool (25, 25, 25): one entry for each grid node
    location = box.blbf(item)
    print(f"{name} fits at {mask.sum():,} of {mask.size:,} locations; placed at {location}")
    box.place(item, location)
print(f"density {box.density:.3f}")

# %%
# Ask why an item can't go somewhere: what is in the way, walls or items (by their number)?

print(box.why_not(Item(library["mug"], scale=0.5), (2, 2, 2)))

# %%
# Draw the box.

with Scene(box) as scene:
    scene.snapshot(640, 480).save("packed.png")
