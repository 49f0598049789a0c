"""
Let two agents play the same task
=================================

An agent is three policies: one chooses shapes, one rotations, one locations. Here a random agent
and the paper's heuristic pack the same items.
"""

# %%
# A task is a packed box without its locations, so a solution is known.

import numpy as np

from packit_sim import Agent, Scene, ShapeLibrary, dataset_file, play, read_packs

library = ShapeLibrary.open("everyday")
pack = read_packs(dataset_file("everyday-v1", "test"))[27]
task = pack.task(library)
print(f"{len(task.items)} items; evolution packed all of them, density {pack.density:.3f}")

# %%
# The return is the packed share of the items' volume. An episode ends when the chosen item does not
# fit anywhere.

for name in ("random/random/random", "largest-first/aligned/blbf"):
    episode = play(task, Agent.from_name(name), np.random.default_rng(0))
    packed = len(episode.box.placed)
    print(f"{name}: return {episode.total:.3f}, {packed} items, end: {episode.end}")
    with Scene(episode.box) as scene:
        scene.snapshot(480, 480).save(f"{name.split('/')[0]}.png")

# %%
# The same with a search that plans ahead: beam search with four beams.

agent = Agent.from_name("largest-first/aligned/blbf+beam=4")
print(f"with beams: return {play(task, agent, np.random.default_rng(0)).total:.3f}")
