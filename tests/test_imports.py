"""Importing the package and playing without pictures load no more than they need."""

import json
import subprocess
import sys

PLAY = """
import json, sys
import gymnasium
assert "packit_sim" not in sys.modules
env = gymnasium.make("packit_sim:PackIt-v0")
assert (type(env.unwrapped).__name__, env.spec.id) == ("PackItEnv", "PackIt-v0")
_, info = env.reset(seed=1)
for _ in range(3):
    _, _, _, _, info = env.step(int(info["action_mask"].argmax()))
env.close()
print(json.dumps(sorted(sys.modules)))
"""

ABSENT = {
    *("coacd", "jinja2", "joblib", "matplotlib", "minari", "pybullet", "ray", "scipy.stats"),
    *("torch", "typer", "viser"),
    *("packit_sim.cli", "packit_sim.game.explorer", "packit_sim.media", "packit_sim.game.paper"),
    "packit_sim.parts.workbench",
    *("packit_sim.render", "packit_sim.game.reports", "packit_sim.scene", "packit_sim.web"),
}

SETTINGS = {"packit_sim.physics", "packit_sim.physics.settings"}
"""The only modules of physics that rules refer to; they hold plain values."""


def modules_after(code: str) -> set[str]:
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, timeout=120)
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_playing_without_pictures_loads_neither_scene_nor_viewer_nor_physics() -> None:
    loaded = modules_after(PLAY)
    assert "packit_sim.game.envs.env" in loaded
    assert loaded & ABSENT == set()
    physics = {name for name in loaded if name.startswith("packit_sim.physics")}
    assert physics <= SETTINGS


def test_the_scene_loads_pybullet_when_it_first_needs_it() -> None:
    code = (
        "import json, sys, packit_sim.scene, packit_sim.physics.settling_box;"
        "print(json.dumps(sorted(sys.modules)))"
    )
    assert "pybullet" not in modules_after(code)
