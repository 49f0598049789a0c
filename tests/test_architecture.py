"""The rooms of ARCHITECTURE.md: who may import whom."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SIMULATOR = ROOT / "packit_sim"
AGENTS = ROOT / "agents" / "packit_agents"

ORDER = (
    "_version",
    "errors",
    "files",
    "caches",
    "compiled",
    "statistics",
    "estimates",
    "parallel",
    "geometry.lattice",
    "geometry.rotations",
    "geometry.bits",
    "geometry.voxelization",
    "geometry.voxels",
    "geometry.repair",
    "geometry.shapes",
    "geometry.quantized",
    "geometry.deviation",
    "geometry.simplification",
    "geometry.similarity",
    "libraries.splits",
    "libraries.mesh_files",
    "libraries.sources",
    "libraries.stored",
    "libraries.folder",
    "libraries.shapenet",
    "libraries.library",
    "libraries.importer",
    "occupancy",
    "collision",
    "screening",
    "nofit",
    "placement",
    "bodies",
    "sweeping",
    "lifting",
    "extraction",
    "compaction",
    "room",
    "box",
    "pictures.cameras",
    "pictures.coloring",
    "pictures.looks",
    "pictures.layouts",
    "pictures.sections",
    "pictures.ghosts",
    "pictures.lettering",
    "pictures.legends",
    "pictures.pixels",
    "pictures.rendering",
    "pictures.plots",
    "pictures.obj_text",
    "pictures.staging",
    "physics.pieces",
    "physics.solids",
    "physics.bisection",
    "physics.store",
    "physics.decomposition",
    "physics.fitting",
    "physics.world",
    "physics.settling",
    "physics.penetration",
    "physics.stability",
    "physics.box",
    "physics.scores",
    "scene",
    "viewing.pages",
    "viewing.surfaces",
    "viewing.boxes",
    "viewing.viewer",
    "pictures.gallery",
    "pictures.video",
    "pictures.films",
    "pictures.export",
    "datasets.packs",
    "datasets.original",
    "datasets.verification",
    "datasets.packings",
    "creation.chromosomes",
    "creation.searches",
    "creation.pack_creator",
    "creation.sampler",
    "creation.evolution",
    "creation.generation",
    "creation.forecast",
    "creation.census",
    "creation.census_plot",
    "creation.datasheet",
    "envs.episode",
    "envs.features",
    "envs.observations",
    "envs.policies",
    "envs.env",
    "envs.vector",
    "envs.recording",
    "envs.wrappers",
    "experiments.results",
    "viewing.exhibits",
    "viewing.questions",
    "viewing.tables",
    "viewing.answers",
    "viewing.workers",
    "viewing.controls",
    "viewing.explorer",
    "experiments.evaluation",
    "experiments.judging",
    "experiments.hardness",
    "experiments.curves",
    "experiments.reproduction",
    "pictures.figures",
    "reports.runs",
    "reports.tables",
    "reports.charts",
    "reports.models",
    "reports.gallery",
    "reports.page",
    "__init__",
    "cli.console",
    "cli.shapes",
    "cli.packs",
    "cli.generate",
    "cli.evaluate",
    "cli.pictures",
    "cli.physics",
    "cli.figures",
    "cli.report",
    "cli.reproduce",
    "cli.view",
    "cli.app",
    "__main__",
)
"""The modules of packit_sim from the bottom up: each may import those before it."""

ROOMS = {name.partition(".")[0] for name in ORDER if "." in name}
"""The folders of packit_sim; their `__init__` only says what is in them."""

QUARANTINE = {
    "fcl": {"packit_sim.collision"},
    "imageio_ffmpeg": {"packit_sim.pictures.video"},
    "h5py": {"packit_sim.envs.recording"},
    "minari": {"packit_sim.envs.recording"},
    "jinja2": {"packit_sim.reports.page"},
    "joblib": {"packit_sim.parallel"},
    "matplotlib": {"packit_sim.pictures.plots"},
    "ray": {"packit_sim.parallel"},
    "viser": {
        "packit_sim.viewing.answers",
        "packit_sim.viewing.boxes",
        "packit_sim.viewing.controls",
        "packit_sim.viewing.pages",
        "packit_sim.viewing.viewer",
    },
    "pybullet": {
        "packit_sim.physics.world",
        "packit_sim.pictures.rendering",
        "packit_sim.pictures.staging",
        "packit_sim.scene",
    },
}
"""Which modules may import a third party."""


def module_name(file: Path, source_root: Path) -> str:
    return ".".join(file.relative_to(source_root).with_suffix("").parts)


MODULES = {
    module_name(file, source_root): file
    for source_root, package in ((ROOT, SIMULATOR), (ROOT / "agents", AGENTS))
    for file in sorted(package.rglob("*.py"))
}


def imports(file: Path) -> Iterator[str]:
    """The modules that a file imports, in functions too; packages stand for their `__init__`."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{file}:{node.lineno}: relative import"
            for alias in node.names:
                inside = f"{node.module}.{alias.name}"
                if inside in MODULES:
                    yield inside
                elif f"{node.module}.__init__" in MODULES:
                    yield f"{node.module}.__init__"
                else:
                    yield node.module


def packages(file: Path) -> set[str]:
    return {name.partition(".")[0] for name in imports(file)}


def test_every_module_of_the_simulator_has_a_place() -> None:
    found = {name.removeprefix("packit_sim.") for name in MODULES if name.startswith("packit_sim.")}
    found -= {f"{room}.__init__" for room in ROOMS}
    assert found <= set(ORDER), "give the new module a place in ORDER"
    assert len(ORDER) == len(set(ORDER))


@pytest.mark.parametrize("name", [f"packit_sim.{module}" for module in ORDER])
def test_imports_run_downwards_only(name) -> None:
    own = ORDER.index(name.removeprefix("packit_sim."))
    below = {f"packit_sim.{module}" for module in ORDER[:own]}
    imported = {m for m in imports(MODULES[name]) if m.partition(".")[0] == "packit_sim"}
    assert imported <= below


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_a_room_says_what_is_in_it_and_imports_nothing(room) -> None:
    init = SIMULATOR / room / "__init__.py"
    assert ast.get_docstring(ast.parse(init.read_text(encoding="utf-8")))
    assert not set(imports(init))


@pytest.mark.parametrize("third_party", QUARANTINE)
def test_third_parties_stay_in_their_room(third_party) -> None:
    importers = {name for name, file in MODULES.items() if third_party in packages(file)}
    assert importers <= QUARANTINE[third_party]


def test_the_simulator_knows_neither_torch_nor_agents() -> None:
    unwanted = {"packit_agents", "stable_baselines3", "sb3_contrib", "torch"}
    for name, file in MODULES.items():
        if name.startswith("packit_sim."):
            assert not unwanted & packages(file), name


def test_nothing_imports_the_source_root_agents() -> None:
    folders = (ROOT / part for part in ("packit_sim", "agents", "benchmarks", "scripts", "tests"))
    for file in (file for folder in folders for file in folder.rglob("*.py")):
        assert "agents" not in packages(file), file
