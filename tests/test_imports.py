"""Importing the package and playing without pictures load no more than they need."""

import json
import subprocess
import sys

import pytest

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

SETTINGS = {
    *("packit_sim.physics", "packit_sim.physics.settings"),
    *("packit_sim.physics.convex", "packit_sim.physics.convex.settings"),
}
"""The only modules of physics that rules refer to; they hold plain values."""


def modules_after(code: str) -> set[str]:
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, timeout=120)
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_importing_the_package_loads_nothing_of_it_and_no_heavy_library() -> None:
    loaded = modules_after("import json, sys, packit_sim; print(json.dumps(sorted(sys.modules)))")
    assert {name for name in loaded if name.startswith("packit_sim")} == {
        "packit_sim",
        "packit_sim.game",
        "packit_sim.game.envs",
        "packit_sim.game.envs.registration",
    }
    heavy = {"fcl", "gymnasium", "joblib", "numba", "numpy", "pybullet", "scipy", "trimesh"}
    assert not loaded & {*heavy, "typer"}
    assert len(loaded) < 120  # 69 with Python 3.11, of which 33 are loaded without any import


def test_a_module_of_parts_does_not_load_the_others() -> None:
    own = "packit_sim.parts.reading.units"
    loaded = modules_after(f"import json, sys, {own}; print(json.dumps(sorted(sys.modules)))")
    parts = {name for name in loaded if name.startswith("packit_sim.parts")}
    bounds = {"packit_sim.parts.packings", "packit_sim.parts.packings.bounds"}
    assert parts == {"packit_sim.parts", "packit_sim.parts.reading", own} | bounds


ORDERS = {
    "package first": "import packit_sim, gymnasium",
    "gymnasium first": "import gymnasium, packit_sim",
    "an environment first": (
        "import packit_sim.game.envs.recording, gymnasium, sys\n"
        "assert not {'minari', 'h5py'} & sys.modules.keys()"
    ),
    "a name of Gymnasium's registry": (
        "import packit_sim\nfrom gymnasium.envs.registration import make"
    ),
    "a reload": "import packit_sim, gymnasium, importlib\nimportlib.reload(packit_sim)",
    "in a thread": (
        "import importlib, threading\n"
        "names = ('gymnasium', 'packit_sim') * 4\n"
        "threads = [threading.Thread(target=importlib.import_module, args=(n,)) for n in names]\n"
        "[thread.start() for thread in threads]\n"
        "[thread.join() for thread in threads]\n"
    ),
}

SPECS = """
import gymnasium, json
names = ("PackIt-v0", "PackItEasy-v0", "PackItPhysics-v0", "PackItRobot-v0")
print(json.dumps([gymnasium.spec(name).kwargs for name in names]))
"""


@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
def test_gymnasium_knows_the_environments_whatever_is_imported_first(order) -> None:
    code = f"import warnings\nwarnings.simplefilter('error')\n{order}\n{SPECS}"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, timeout=120)
    assert json.loads(run.stdout) == [{}, {"easy": True}, {"physics": True}, {"robot": True}]
    assert not run.stderr


def test_gymnasium_alone_stays_as_it_is() -> None:
    code = """
import sys
before = list(sys.meta_path)
import packit_sim, gymnasium.envs.registration
registry = gymnasium.envs.registration
assert sys.meta_path[1:] == before
assert type(registry.__loader__) is type(gymnasium.__loader__)
assert registry.__spec__.loader is registry.__loader__
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


WORKERS = """
import sys
import packit_sim
import gymnasium

if __name__ == "__main__":
    settings = dict(observation="none", max_shapes=40)
    envs = gymnasium.make_vec(
        "PackIt-v0", 1, "async", vector_kwargs=dict(context=sys.argv[1]), **settings
    )
    _, info = envs.reset(seed=1)
    assert info["action_mask"].any()
    envs.close()
"""


SB3_WORKERS = """
import sys
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv
import packit_sim

if __name__ == "__main__":
    settings = dict(observation="features", max_shapes=40)
    start = dict(start_method=sys.argv[1])
    envs = make_vec_env(
        "PackIt-v0", 1, env_kwargs=settings, vec_env_cls=SubprocVecEnv, vec_env_kwargs=start
    )
    envs.reset()
    envs.close()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "method"),
    [
        (WORKERS, "spawn"),
        pytest.param(WORKERS, "fork", marks=pytest.mark.slow),
        pytest.param(WORKERS, "forkserver", marks=pytest.mark.slow),
        pytest.param(SB3_WORKERS, "spawn", marks=pytest.mark.slow),
        pytest.param(SB3_WORKERS, "forkserver", marks=pytest.mark.slow),
    ],
)
def test_workers_of_a_vector_environment_make_it_however_they_start(
    script, method, tmp_path
) -> None:
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    subprocess.run([sys.executable, str(tmp_path / "script.py"), method], check=True, timeout=240)


@pytest.mark.slow
def test_playing_without_pictures_loads_neither_scene_nor_viewer_nor_physics() -> None:
    loaded = modules_after(PLAY)
    assert "packit_sim.game.envs.env" in loaded
    assert loaded & ABSENT == set()
    physics = {name for name in loaded if name.startswith("packit_sim.physics")}
    assert physics <= SETTINGS


@pytest.mark.slow
def test_the_scene_loads_pybullet_when_it_first_needs_it() -> None:
    code = (
        "import json, sys, packit_sim.scene, packit_sim.physics.settling_box;"
        "print(json.dumps(sorted(sys.modules)))"
    )
    assert "pybullet" not in modules_after(code)
