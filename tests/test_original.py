"""Pack files of the original PackIt, written by hand, with a small ShapeNet."""

import copy
import itertools
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.core.errors import PackFormatError
from packit_sim.game.datasets.original import Original, read_original
from packit_sim.game.datasets.provenance import FromOriginal
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import play
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import End

MUG, CHAIR = "03797390", "03001627"
HALF = 0.5**0.5
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DOCUMENT = Path(__file__).parents[1] / "docs" / "benchmarks" / "original.md"


def add(tree: Path, model: str, extents: tuple[float, float, float]) -> None:
    """A block of these extents in ShapeNet's y-up axes."""
    path = tree / model / "model.obj"
    path.parent.mkdir(parents=True, exist_ok=True)
    creation.box(extents).export(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tree = tmp_path_factory.mktemp("shapenet")
    for n in range(4):
        add(tree, f"{MUG}/mug{n}", (1, 1 + 0.2 * n, 0.5))
    add(tree, f"{CHAIR}/chair", (0.7, 1.1, 0.5))
    add(tree, f"{CHAIR}/twin_A", (1, 1, 1))
    add(tree, f"{CHAIR}/twin_a", (1, 1, 2))
    add(tree, f"{CHAIR}/plank", (1, 0.01, 0.01))
    (tree / CHAIR / "flat").mkdir()
    (tree / CHAIR / "flat" / "model.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tree / CHAIR / "hollow").mkdir()
    return tree


@pytest.fixture(scope="module")
def library(folder: Path) -> ShapeLibrary:
    return ShapeLibrary.open(f"shapenet:{folder}")


def pack(*sources: str, factor: float = 0.5, turn: tuple[float, ...] = UPRIGHT) -> dict[str, Any]:
    """A recorded pack of these models, all scaled and turned alike."""
    return {
        "efficiency": 0.4,
        "sources": [f"Shapes_te/{source}/model.obj" for source in sources],
        "positions": [{"x": 0.0, "y": -0.1, "z": 0.1} for _ in sources],
        "scales": [dict.fromkeys("xyz", factor) for _ in sources],
        "rotations": [dict(zip("xyzw", turn, strict=True)) for _ in sources],
        "shapeScale": 0.8,
    }


GOOD = pack(f"{MUG}/mug0", f"{CHAIR}/chair", f"{MUG}/mug2")


def write(path: Path, *packs: Any) -> Path:
    path.write_text(json.dumps({"data": packs}))
    return path


@pytest.fixture
def read(tmp_path: Path, library: ShapeLibrary) -> Callable[..., Original]:
    def read(*packs: Any, **options: bool) -> Original:
        return read_original(write(tmp_path / "0_te", *packs), library, **options)

    return read


def test_a_pack_becomes_a_task_that_says_where_it_is_from(read, library) -> None:
    original = read(GOOD, GOOD)
    assert original.packs == 2 and len(original.tasks) == 2 and original.unresolved == ()
    task = original.tasks[1]
    assert [item.shape.id for item in task.items] == ["chair/chair", "mug/mug0", "mug/mug2"]
    assert all(item.rotation == 0 for item in task.items)
    assert task.solution == () and task.pack.items == () and task.cells == (100, 100, 100)
    assert task.pack.library.digest == library.digest
    assert task.pack.provenance == FromOriginal(
        file="0_te", pack=1, efficiency=0.4, shape_scale=0.8, rotations=(0, 0, 0), left_out=0
    )
    assert original.report() == "2 packs: 2 whole; 0 items without a shape"


def test_the_scale_is_the_cube_of_the_recorded_factor(read) -> None:
    """The largest of the five levels is a volume of 4; a shapeScale of 0.8 makes it 4 * 0.512."""
    recorded = pack(f"{MUG}/mug0", factor=1.2699208)  # 4^(1/3) * 0.8 in single precision
    (item,) = read(recorded).tasks[0].items
    assert item.scale == pytest.approx(2.048, rel=1e-6)
    assert np.linalg.norm(item.extents) == pytest.approx(1.2699208)
    del recorded["shapeScale"]  # the factor is complete without it
    task = read(recorded).tasks[0]
    assert task.items == (item,) and task.pack.provenance.shape_scale is None


@pytest.mark.parametrize(
    ("quaternion", "rotation"),
    [
        (UPRIGHT, 0),
        ((0, HALF, 0, HALF), 3),  # about Unity's up axis, clockwise from above
        ((0, -HALF, 0, HALF), 1),
        ((HALF, 0, 0, HALF), 16),  # the top goes to Unity's +z, which is our -y
        ((0, 0, 1, 0), 6),  # upside down, our x reversed
    ],
)
def test_rotations_by_hand(read, quaternion, rotation) -> None:
    assert read(pack(f"{MUG}/mug0", turn=quaternion)).tasks[0].pack.provenance.rotations == (
        rotation,
    )


def test_the_24_rotations_of_their_table_are_ours(read) -> None:
    """Theirs: a tilt about x or z, then a turn about y; a block's extents must turn alike."""
    tilts = [(a, 0) for a in (0, 90, 180, 270)] + [(0, 90), (0, 270)]
    extents = np.array((1, 1.4, 0.5)) / np.linalg.norm((1, 1.4, 0.5)) * 0.5
    found = set()
    for (about_x, about_z), about_y in itertools.product(tilts, (0, 90, 180, 270)):
        turns = [about("z", about_z), about("x", about_x), about("y", about_y)]
        q, matrix = np.array(UPRIGHT), np.eye(3)
        for quaternion, turn in turns:
            q, matrix = product(quaternion, q), turn @ matrix
        task = read(pack(f"{MUG}/mug2", turn=tuple(np.round(q, 7).tolist()))).tasks[0]
        (rotation,) = task.pack.provenance.rotations
        x, y, z = np.abs(matrix) @ extents
        assert task.items[0].turned(rotation).extents == pytest.approx((x, z, y))
        found.add(rotation)
    assert found == set(range(24))


def about(axis: str, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """A rotation about an axis as quaternion x, y, z, w and as matrix."""
    angle, n = np.radians(degrees), "xyz".index(axis)
    quaternion = np.zeros(4)
    quaternion[n], quaternion[3] = np.sin(angle / 2), np.cos(angle / 2)
    matrix = np.eye(3)
    i, j = (n + 1) % 3, (n + 2) % 3
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return quaternion, matrix


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Quaternions x, y, z, w: first q, then p."""
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
    return np.append(vector, p[3] * q[3] - p[:3] @ q[:3])


def test_rotations_stand_in_the_order_of_the_tasks_items(read) -> None:
    recorded = copy.deepcopy(GOOD)
    recorded["rotations"][1] = {"x": 0, "y": HALF, "z": 0, "w": HALF}
    task = read(recorded).tasks[0]
    assert task.items[0].shape.id == "chair/chair"
    assert task.pack.provenance.rotations == (3, 0, 0)


def test_tasks_can_be_played(read) -> None:
    original = read(pack(*(f"{MUG}/mug{n}" for n in range(4)), f"{CHAIR}/chair", factor=0.4))
    agent = Agent.from_name("largest-first/aligned/blbf")
    episode = play(original.tasks[0], agent, np.random.default_rng(0))
    assert episode.end is End.COMPLETE and episode.total == pytest.approx(1)
    env = PackItEnv(original.tasks, observation="none")
    _, info = env.reset(seed=0)
    assert info is not None and env.action_space.n >= 5


@pytest.mark.parametrize("category", ["chair", "Chair", "03001627"])
def test_categories_go_by_number_or_name(read, category) -> None:
    assert read(pack(f"{category}/chair")).tasks[0].items[0].shape.id == "chair/chair"


def test_a_library_that_kept_the_numbers_will_do(folder, tmp_path) -> None:
    flat = tmp_path / "flat"
    (flat / CHAIR).mkdir(parents=True)
    (flat / CHAIR / "one.obj").write_bytes((folder / CHAIR / "chair" / "model.obj").read_bytes())
    library = ShapeLibrary.open(f"folder:{flat}")
    for category in ("chair", CHAIR):
        original = read_original(write(tmp_path / "0_te", pack(f"{category}/one")), library)
        assert original.tasks[0].items[0].shape.id == f"{CHAIR}/one"


def test_a_name_in_another_case_is_found_and_the_exact_one_comes_first(read) -> None:
    items = read(pack(f"{CHAIR}/CHAIR"), pack(f"{CHAIR}/twin_A"), pack(f"{CHAIR}/twin_a")).tasks
    assert [task.items[0].shape.id for task in items] == [
        "chair/chair",
        "chair/twin_A",
        "chair/twin_a",
    ]


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (f"{CHAIR}/throne", "no model 'throne' in 'chair' of library 'shapenet'"),
        ("02691156/jet", "no category '02691156' in library 'shapenet': it has chair, mug"),
        ("---/jet", "no category '---' in library"),
        (f"{CHAIR}/twin-a", "ambiguous: it may be chair/twin_A, chair/twin_a"),
        (f"{CHAIR}/hollow", "hollow: holds none of models/model_normalized.obj"),
        (f"{CHAIR}/flat", "flat/model.obj: shape 'chair/flat': the mesh has no extent along"),
        ("chair", "it is not of the form Shapes_SPLIT/CATEGORY/MODEL/model.obj"),
        ("a/b/../chair", "it is not of the form Shapes_SPLIT/CATEGORY/MODEL/model.obj"),
    ],
)
def test_a_source_without_a_shape_is_reported_and_its_pack_left_out(read, source, reason) -> None:
    bad = pack(f"{MUG}/mug1", source)
    original = read(GOOD, bad)
    assert [task.pack.provenance.pack for task in original.tasks] == [0]
    (unresolved,) = original.unresolved
    assert (unresolved.file, unresolved.pack, unresolved.item) == ("0_te", 1, 1)
    assert unresolved.source == bad["sources"][1] and reason in unresolved.reason
    assert original.rows() == [("0_te", "1", "1", unresolved.source, unresolved.reason)]
    summary, line = original.report().splitlines()
    assert summary == "2 packs: 1 whole, 1 left out; 1 item without a shape"
    assert line.startswith("0_te, pack 1, item 1: Shapes_te/")


def test_items_larger_than_the_box_are_reported(read) -> None:
    (unresolved,) = read(pack(f"{CHAIR}/plank", factor=1.5)).unresolved
    assert unresolved.reason == (
        "at its scale it needs (150, 2, 2) cells: the box has (100, 100, 100)"
    )


def test_a_pack_can_be_kept_without_them(read) -> None:
    original = read(pack(f"{CHAIR}/throne", f"{MUG}/mug1"), pack("1/2"), GOOD, partial=True)
    whole, part = original.tasks[1], original.tasks[0]
    assert [item.shape.id for item in part.items] == ["mug/mug1"]
    assert part.pack.provenance.left_out == 1 and whole.pack.provenance.left_out == 0
    assert original.report().startswith(
        "3 packs: 1 whole, 1 without some of their items, 1 left out; 2 items without a shape\n"
    )


def test_what_no_terminal_can_print_is_escaped(read) -> None:
    text = read(pack("\udc80/\x1b[31m\n")).report()
    assert len(text.splitlines()) == 2 and r"Shapes_te/\udc80/\x1b[31m\n/model.obj" in text
    text.encode()


def test_the_files_of_a_folder_are_read_by_their_numbers(library, tmp_path) -> None:
    for name in ("10_te", "2_te", "0_te"):
        write(tmp_path / name, GOOD)
    (tmp_path / "0_te_log").write_text("Generation: 1 Efficiency: 0.1")
    (tmp_path / ".hidden").write_text("nothing")
    original = read_original(tmp_path, library)
    assert [task.pack.provenance.file for task in original.tasks] == ["0_te", "2_te", "10_te"]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is empty"),
        (b" \n", "is empty"),
        (b"{", "is not JSON: "),
        (b"[" * 100_000, "is not JSON: "),
        (b"9" * 5000, "an integer of 5000 digits is not possible: at most 39"),
        (b"\xff\xfe", "can't decode byte 0xff"),
        (b"[1]", "the file must be a JSON object, not list"),
        (b"{}", "field 'data' is missing"),
        (b'{"data": {}}', r"field 'data' is \{\}: expected array"),
        (b'{"data": []}', r"field 'data' is \[\]: expected array of length >= 1"),
        (b'{"data": [7]}', "pack 0: a pack must be a JSON object, not int"),
    ],
)
def test_what_is_no_pack_file_is_refused(library, tmp_path, content, problem) -> None:
    file = tmp_path / "0_te"
    file.write_bytes(content)
    with pytest.raises(PackFormatError, match=problem) as error:
        read_original(file, library)
    assert str(file) in str(error.value)


def test_what_is_not_there_is_refused(library, tmp_path) -> None:
    with pytest.raises(PackFormatError, match=r"nothing: No such file"):
        read_original(tmp_path / "nothing", library)
    with pytest.raises(PackFormatError, match="holds no pack files"):
        read_original(tmp_path, library)
    with pytest.raises(PackFormatError, match="null byte"):
        read_original("\0", library)


def test_what_may_not_be_read_is_refused(library, tmp_path, monkeypatch) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(PackFormatError, match=r": Permission denied"):
        read_original(tmp_path, library)


MISSING = object()
SCALE = {"x": 0.5, "y": 0.5, "z": 0.5}


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        (("sources",), MISSING, "field 'sources' is missing"),
        (("sources",), "mug", "field 'sources' is 'mug': expected array"),
        (("sources",), [], r"field 'sources' is \[\]: expected array of length >= 1"),
        (("sources", 1), 7, r"field 'sources\[1\]' is 7: expected str"),
        (("efficiency",), MISSING, "field 'efficiency' is missing"),
        (("efficiency",), "0.4", "field 'efficiency' is '0.4': expected float"),
        (("efficiency",), -0.1, r"field 'efficiency' is -0\.1: expected float >= 0"),
        (("efficiency",), float("nan"), "field 'efficiency' is nan: expected float"),
        (("shapeScale",), None, "field 'shapeScale' is None: expected float"),
        (("shapeScale",), 0, r"field 'shapeScale' is 0: expected float >= 0\.01"),
        (("positions",), [], "field 'positions' has 0 entries, 'sources' has 3"),
        (("positions", 0), [0, 0, 0], r"field 'positions\[0\]' is \[0, 0, 0\]: expected object"),
        (("positions", 2, "z"), MISSING, r"field 'positions\[2\]\.z' is missing"),
        (("positions", 2, "z"), float("inf"), r"field 'positions\[2\]\.z' is inf"),
        (
            ("scales",),
            [SCALE],
            "field 'scales' has 1 entry, 'sources' has 3: both must have as many",
        ),
        (("scales", 1, "x"), -0.5, r"field 'scales\[1\]\.x' is -0\.5: expected float >= 0\.01"),
        (("scales", 1, "y"), float("nan"), r"field 'scales\[1\]\.y' is nan"),
        (("scales", 1, "z"), 2, r"field 'scales\[1\]\.z' is 2: expected float <= 1\.75"),
        (("scales", 1, "z"), True, r"field 'scales\[1\]\.z' is True: expected float"),
        (("scales", 1, "z"), 0.6, r"field 'scales\[1\]' is \(0.5, 0.5, 0.6\): the three must be"),
        (("rotations", 0), "up", r"field 'rotations\[0\]' is 'up': expected object"),
        (("rotations", 0, "w"), MISSING, r"field 'rotations\[0\]\.w' is missing"),
        (("rotations", 0, "w"), 0.9, r"field 'rotations\[0\]' is .* a unit quaternion"),
        (("rotations", 0, "x"), 0.3, r"field 'rotations\[0\]' is .* a unit quaternion"),
    ],
)
def test_a_field_that_is_wrong_is_named(read, path, value, problem) -> None:
    with pytest.raises(PackFormatError, match=f"0_te, pack 1: {problem}"):
        read(GOOD, changed(path, value))


def test_an_integer_without_end_is_refused(read) -> None:
    with pytest.raises(PackFormatError, match="0_te: an integer of 401 digits is not"):
        read(GOOD, changed(("scales", 1, "z"), 10**400))


def changed(path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """The good pack with one field changed, or missing."""
    recorded = copy.deepcopy(GOOD)
    at: Any = recorded
    for key in path[:-1]:
        at = at[key]
    if value is MISSING:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return recorded


def test_unknown_fields_are_let_be(read) -> None:
    assert len(read(GOOD | {"comment": float("nan")}).tasks) == 1


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from("xyzw") | st.text(), inner),
    max_leaves=8,
)
FIELDS = [(key,) for key in GOOD]
FIELDS += [(key, n) for key in GOOD if isinstance(GOOD[key], list) for n in range(3)]
FIELDS += [(key, 1, axis) for key in ("positions", "scales", "rotations") for axis in "xyz"]


@given(field=st.sampled_from(FIELDS), value=JSON)
def test_any_value_in_any_field_is_read_or_refused(library, tmp_path_factory, field, value) -> None:
    file = write(tmp_path_factory.getbasetemp() / "fuzz_te", changed(field, value))
    try:
        text = read_original(file, library, partial=True).report()
    except PackFormatError as error:
        text = str(error)
    assert text.startswith("1 pack: ") or re.match(r"\S*/fuzz_te, pack 0: field '.*\Z", text)
    text.encode()


@given(content=st.binary() | JSON.map(json.dumps).map(str.encode))
def test_any_file_is_refused_in_a_sentence(library, tmp_path_factory, content) -> None:
    file = tmp_path_factory.getbasetemp() / "noise_te"
    file.write_bytes(content)
    with pytest.raises(PackFormatError, match="noise_te"):
        read_original(file, library)


def test_the_documents_example_runs(folder, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "data" / "pack_te").mkdir(parents=True)
    write(tmp_path / "data" / "pack_te" / "0_te", GOOD, pack(f"{CHAIR}/throne"))
    (tmp_path / "ShapeNetCore.v1").symlink_to(folder)
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), flags=re.DOTALL)
    exec(compile(example, DOCUMENT.name, "exec"), {})
    assert "2 packs: 1 whole, 1 left out; 1 item without a shape" in capsys.readouterr().out
