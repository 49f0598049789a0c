"""
Step through the Gymnasium environment
======================================

``PackIt-v0`` asks for a shape, a rotation and a location in turn. Here the agent chooses at random
among the valid actions; policies can play some of the sub-tasks instead.
"""

# %%
# Importing ``packit_sim`` registers the environments.

import gymnasium
from PIL import Image

import packit_sim  # noqa: F401

env = gymnasium.make("PackIt-v0", observation="none", render_mode="rgb_array")
observation, info = env.reset(seed=1, options={"task": 0})
env.action_space.seed(1)

terminated = False
while not terminated:
    stage = ("shape", "rotation", "location")[observation["stage"]]
    action = env.action_space.sample(mask=observation["action_mask"])
    observation, reward, terminated, truncated, info = env.step(action)
    if reward:
        print(f"{stage} {action}: reward {reward:.3f}, density {info['density']:.3f}")
print("end:", info["end"])
Image.fromarray(env.render()).save("random.png")

# %%
# With ``rotation="aligned", location="blbf"`` only shapes are left to choose, as in the paper's
# learning set-up. This agent takes the largest shape that is outside.

env = gymnasium.make(
    "PackIt-v0",
    rotation="aligned",
    location="blbf",
    observation="none",
    render_mode="rgb_array",
)
observation, info = env.reset(options={"task": 0})
terminated, total = False, 0.0
while not terminated:
    action = (observation["volumes"] * observation["outside"]).argmax()
    observation, reward, terminated, truncated, info = env.step(action)
    total += reward
print(f"return {total:.3f}, end: {info['end']}")
Image.fromarray(env.render()).save("largest.png")
