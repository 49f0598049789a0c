"""
Look into a box
===============

A packed box hides most of its items. Cut it open, pull it apart, or colour the items by what you
want to know.
"""

# %%
# Read a pack of a dataset and put its items into a box.

from packit_sim import Cut, Look, Scene, ShapeLibrary, by_order, dataset_file, read_packs

library = ShapeLibrary.open("everyday")
pack = read_packs(dataset_file("everyday-v1", "test"))[2]
box = pack.replay(library)

# %%
# Each item has its own colour, the same in every picture.

scene = Scene(box)
scene.snapshot(480, 480).save("whole.png")

# %%
# Cut away the front half. The section shows solid cells, also of meshes that are not closed.

scene.snapshot(480, 480, Look(cut=Cut("y", 0.5))).save("cut.png")

# %%
# Move the items apart, in a box of glass.

scene.snapshot(480, 480, Look(box="ghost", explode=0.6)).save("apart.png")

# %%
# Colour by the order of placing, from dark to light.

scene.snapshot(480, 480, Look(coloring=by_order)).save("order.png")
scene.close()
