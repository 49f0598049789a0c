"""A user's error is one clear line on stderr and exit code 2, for every command."""

import sys
from pathlib import Path

import pytest
from typer.main import get_command

from packit_sim.cli.app import app, main

SMALL = "--pool 4 --generations 0"

WRONG = [
    # the command line itself
    ("bogus", "No such command 'bogus'"),
    ("--bogus", "No such option: --bogus"),
    ("verify", "Missing argument"),
    ("shapes bogus", "No such command 'bogus'"),
    ("datasets bogus", "No such command 'bogus'"),
    # demo
    ("demo --generations -1", "--generations"),
    ("demo --seed -1", "--seed"),
    ("demo --out file", "file is a file, not a folder"),
    # verify
    ("verify absent.jsonl", "absent.jsonl: No such file"),
    ("verify absent.json", "absent.json"),
    ("verify broken.json", "broken.json"),
    ("verify starter --split dev", "--split"),
    ("verify starter --split train", "train"),
    ("verify starter --library nowhere", "'nowhere'"),
    ("verify folder", "folder"),
    ("verify page.html", "page.html is not a dataset: choose a .jsonl file"),
    ("verify packing.json --split test", "--split has no effect on packing.json"),
    ("verify packing.json --library everyday", "--library has no effect on packing.json"),
    ("verify list.json", "list.json: a packing must be a JSON object, not list"),
    ("verify manifest.csv", "manifest.csv is not a dataset"),
    # pack, containers and workbench
    ("fit good.off", "one container is needed"),
    ("fit absent.stl --box 9x9x9", "absent.stl: there is no such file"),
    ("fit good.off --box 2x2x2 --wall-clearance 1mm", "leave no space in it"),
    ("containers all", "unexpected extra argument"),
    ("pack good.off --box 9x9x9 --out x --groups mixed", "'mixed'"),
    ("pack good.off --box 9x9x9 --out x --max-tilt steep", "'steep' is not an angle in degrees"),
    ("pack good.off --box 9x9x9 --out x --max-tilt 200deg", "max tilt 200.0 is not possible"),
    ("pack good.off --box 9x9x9 --out x --down bottom", "'bottom' is not a side"),
    ("pack good.off --box 9x9x9 --out x --rotations fixed --down x+", "the side x+ down"),
    ("pack good.off --box 9x9x9 --out x --groups kit", "rules of groups need parts with a group"),
    ("pack good.off --container prusa-mk44 --out x", "not known: is it 'prusa-mk4'?"),
    ("pack good.off --preset list.json --out x", "list.json: a preset must be a JSON object"),
    ("pack good.off --preset packing.json --out x", "packing.json: field 'options' is missing"),
    ("pack good.off --preset other.json --out x", "it is of another command, 'nest'"),
    ("pack good.off --preset truth.json --out x", "option 'boxes' is True: it is no yes or no"),
    ("pack good.off --preset /dev/zero --out x", "/dev/zero: not a regular file"),
    (
        "pack good.off --box 9x9x9 --out x --save-preset manifest.csv",
        "manifest.csv exists, and is not a file that this command writes",
    ),
    ("pack good.off --box 9x9x9 --out x --save-preset good.off", "good.off is an input"),
    ("pack good.off --box 9x9x9 --out x --keep-out=", "the name of a file is empty"),
    ("execute packing.json --replay replays", "box-0/replay.json exists, and is not a file that"),
    ("pack good.off --preset absent.json --out x", "absent.json: No such file"),
    (
        "pack good.off --box 9x9x9 --out x --balance 10",
        "'10' is not a share of a side, such as 10%",
    ),
    ("pack good.off --box 9x9x9 --out x --balance B:9%", "there is no box 'B' for limits"),
    ("pack good.off --box 9x9x9 --out x --powder 20%", "'20%' is not a powder's density"),
    ("pack good.off --box 9x9x9 --out x --even --removable", "even is not possible with"),
    ("pack good.off --box absent.csv --out x", "absent.csv: No such file"),
    ("pack good.off --box manifest.csv --out x", "manifest.csv: its first row is file"),
    ("pack", "Missing argument"),
    ("pack good.off --out x", "there is no box: choose --box 300x200x150mm, or --container"),
    ("pack good.off --box 9x9 --out x", "'9x9' is not 3 lengths"),
    ("pack good.off --box 9x9x9parsec --out x", "'parsec' is not known: choose from"),
    ("pack good.off --box 9x9x0 --out x", "9x9x0"),
    ("pack good.off --box 9x9x9 --unit mile --out x", "'mile'"),
    ("pack good.off --box 9x9x9 --objective best --out x", "'best'"),
    ("pack meshes absent.stl --box 9x9x9 --out x", "(and 1 other file)"),
    ("pack absent.stl --box 9x9x9 --out x", "absent.stl: there is no such file"),
    ("pack good.off=0 --box 9x9x9 --out x", "with counts of at least 1"),
    ("pack good.off=four --box 9x9x9 --out x", "'four' is not a count"),
    ("pack folder --box 9x9x9 --out x", "no mesh file in it"),
    ("pack meshes --box 9x9x9 --out x", "bad.stl"),
    ("pack broken.json --box 9x9x9 --out x", "broken.json: it is not JSON"),
    ("pack list.json --box 9x9x9 --out x", "list.json: it has no parts"),
    ("pack manifest.csv --box 9x9x9 --out x", "part 'good': rotations 'round' are not known"),
    ("pack good.off --box 9x9x9 --out file", "file is a file, not a folder"),
    ("pack good.off --box 9x9x9 --out file/x", "file/x is not possible"),
    ("pack good.off --box 9x9x9 --out x --time soon", "--time 'soon'"),
    ("pack good.off --box 9x9x9 --out x --time -3", "time -3.0"),
    ("pack good.off --box 9x9x9 --out x --clearance wide", "'wide' is not a length"),
    ("pack good.off --box 9x9x9 --out x --wall-clearance 5mm", "no space in it"),
    ("pack good.off --box 9x9x9 --out x --wall-clearance left=5mm", "each of sides, floor, top"),
    ("pack good.off --box 9x9x9 --out x --clearance-z 1mm", "both above 0, and their ratio"),
    ("pack good.off --box 9x9x9 --out x --rotations some", "'some'"),
    ("pack good.off --box 9x9x9 --out x --door z-", "'z-' is not one of"),
    ("pack good.off --box 9x9x9 --out x --order random", "'random' is not one of 'delivery'"),
    ("pack good.off --box 9x9x9 --out x --order delivery", "'good' has none; a manifest has"),
    ("pack good.off --container cylinder:9x9 --out x --door y-", "door y- is not possible in"),
    ("pack good.off --box 9x9x9 --out x --keep-out absent.stl", "keep-out"),
    ("pack good.off --box 9x9x9 --out x --fixed good.off --boxes 2", "need one box"),
    ("pack good.off --box 9x9x9 --out x --address here:1", "backend ray"),
    ("pack good.off --box 1x1x1 --out x", "no part fits: good"),
    ("workbench --port 0", "--port"),
    ("workbench --host 999.0.0.1 --no-browser", "'999.0.0.1', port any: Name or service"),
    # doctor, selftest
    ("doctor extra", "unexpected extra argument"),
    ("doctor --jsn", "No such option: --jsn"),
    ("selftest --minutes 0", "--minutes"),
    ("selftest --minutes inf", "--minutes"),
    ("selftest --out folder", "folder"),
    ("selftest --out list.json", "list.json: the totals must be a JSON object"),
    ("selftest --replay absent.json", "absent.json"),
    ("selftest --replay broken.json", "broken.json: not JSON"),
    # nest
    ("nest", "Missing argument"),
    ("nest absent", "no instance 'absent': choose"),
    ("nest absent.json", "absent.json"),
    ("nest broken.json", "broken.json"),
    ("nest folder", "folder is a folder without a strip-packing instance"),
    ("nest x.json --rotations some", "'some'"),
    ("nest x.json --iterations 0", "--iterations"),
    ("nest x.json --seed -1", "--seed"),
    ("nest x.json --time soon", "--time 'soon'"),
    ("nest x.json --workers -1", "--workers"),
    ("nest x.json --out folder", "folder is a folder"),
    ("nest x.json --out file/x.json", "file"),
    ("nest x.json --packing x.stl", "x.stl"),
    ("nest instance.json --clearance 99", "clearance 99.0 is not possible: at most"),
    # generate
    ("generate", "Missing option '--out'"),
    ("generate --out x --packs 0", "--packs"),
    ("generate --out x --packs many", "--packs"),
    ("generate --out x --population 9", "population = 9"),
    ("generate --out x --size-range 1 0.5", "size_range = (1.0, 0.5)"),
    ("generate --out x --size-range nan 1", "size_range"),
    ("generate --out x --search best", "--search"),
    ("generate --out x --split dev", "--split"),
    ("generate --out x --splits 0 0 0", "--splits 0 0 0 is not possible"),
    ("generate --out x --splits 1 1 1 --packs 3", "--packs has no effect with --splits"),
    ("generate --out x --library nowhere", "'nowhere'"),
    ("generate --out x --library meshes", "bad.stl"),
    ("generate --out x --library folder:absent", "absent"),
    ("generate --out x --backend ssh", "--backend"),
    ("generate --out x --address here:1", "backend ray"),
    (f"generate --out file {SMALL}", "file"),
    (f"generate --out file/x {SMALL}", "file"),
    ("generate --out p --puzzle jigsaw", "no puzzle 'jigsaw': choose from"),
    ("generate --out p --puzzle pinwheel --pieces 3", "5 to 48 for a pinwheel"),
    ("generate --out p --pieces 8", "--pieces has no effect without --puzzle"),
    ("generate --out p --puzzle curved --split train", "--split has no effect with --puzzle"),
    ("generate --out file --puzzle curved", "--out file is a file"),
    ("generate --out d --dense --history", "--history has no effect with --dense"),
    ("generate --out d --floor 0.1", "--floor has no effect without --dense"),
    ("generate --out d --dense --floor 2", "floor = 2.0 is not possible"),
    ("generate --out d --dense --items 5 2", "items = (5, 2)"),
    ("generate --out d --dense --pool 3", "pool = 3"),
    # record
    ("record starter", "Missing option '--out'"),
    ("record starter --out x --shards 0 --transitions", "--shards"),
    ("record starter --out x --agent random --agent random", "one agent is recorded at a time"),
    ("record starter --out folder --agent random/random/random", "folder exists"),
    ("record starter --out x --transitions --agent largest-first/aligned/blbf+beam=2", "search"),
    # evaluate and compare
    ("evaluate absent.jsonl", "absent.jsonl: No such file"),
    ("evaluate broken.jsonl", "broken.jsonl, line 1: not JSON"),
    ("evaluate binary.jsonl", "binary.jsonl"),
    ("evaluate packing.json", "`packit verify` checks the packing"),
    ("evaluate starter --tasks 0", "--tasks"),
    ("execute starter --arm ur5", "choose gantry, panda, or the path of a .urdf file"),
    ("execute starter --arm absent.urdf", "absent.urdf"),
    ("execute starter --level 3", "level 3 is not possible: 1 or 2"),
    ("execute starter --level 2 --arm own.urdf", "only gantry and panda turn items in the air"),
    ("execute starter --moves 5 --all-masks", "moves 5 is not possible"),
    ("execute starter --moves 2", "--moves 2 has no effect on masks"),
    ("execute starter --arm panda --edge 0.5", "arm 'panda' can't reach the box"),
    ("execute starter --edge 0.6", "weighs 2.51 kg: the largest cup lifts at most 2.46 kg"),
    ("execute starter --film x.avi", "choose a name that ends in .mp4 or .gif"),
    ("execute starter --film x.gif", "--film x.gif needs --out"),
    ("execute starter --agent random/random/random+beam=2", "leave out the search"),
    ("execute packing.json --edge 0.2", "--edge has no effect on packing.json"),
    ("execute packing.json --agent champion", "--agent has no effect on packing.json"),
    ("execute absent.json", "absent.json: No such file"),
    ("execute starter --replay x", "--replay has no effect on starter: it is for packings"),
    ("execute starter --stored --agent champion", "starter, which is not planned again"),
    ("execute starter --edge 9", "a box 9 m high is higher than the reach of arm 'gantry'"),
    ("evaluate starter --agent best/aligned/blbf", "no shape policy 'best'"),
    ("evaluate starter --agent random/random", "random/random"),
    ("evaluate starter --agent random/random/random+beam=0", "beam"),
    ("evaluate starter --agent random/random/random+beam=x", "beam=4"),
    ("evaluate starter --agent random/random/random+backtrack=-1", "backtrack"),
    ("evaluate starter --agent random/random/random+mcts=0s", "budget"),
    ("evaluate starter --agent random/random/random+lns=nan", "budget"),
    ("evaluate starter --agent learned@absent.safetensors/aligned/blbf", "absent.safetensors"),
    ("evaluate starter --agent learned@binary.jsonl/aligned/blbf", "binary.jsonl"),
    ("evaluate starter --decomposition gold", "--decomposition"),
    ("evaluate starter --buffer 0", "--buffer"),
    ("evaluate starter --rotations some", "'some'"),
    ("evaluate starter --kinematic --physics", "not both"),
    ("evaluate starter --support 1.2", "--support"),
    ("evaluate starter --boxes 0", "--boxes"),
    ("evaluate starter --boxes 6", "6 boxes of 100 cells along x are not possible"),
    ("evaluate starter --values", "have no values"),
    ("evaluate starter --workers -1", "--workers"),
    ("evaluate starter --tasks 1 --out file/x.jsonl", "file"),
    ("evaluate starter --tasks 1 --out folder", "folder"),
    ("compare absent.jsonl", "absent.jsonl"),
    ("compare broken.jsonl", "broken.jsonl"),
    ("compare folder", "folder"),
    ("compare a b c", "one or two"),
    ("compare absent.jsonl --runs x", "absent.jsonl"),
    ("compare a --runs x --seconds 1", "--seconds has no effect with --runs"),
    # reproduce, report, figures
    ("reproduce table9", "'table9'"),
    ("reproduce table1 --dataset nowhere", "nowhere"),
    ("reproduce table1 --out file", "file"),
    ("reproduce evolution --history-dataset nowhere", "nowhere"),
    ("report absent.jsonl --out page.html", "absent.jsonl"),
    ("report folder --out page.html", "folder"),
    ("report broken.jsonl --out page.html", "broken.jsonl"),
    ("report broken.jsonl --out page.pdf", "page.pdf"),
    ("figures starter --out file --only task", "file"),
    ("figures starter --out x --only tasks", "--only"),
    ("figures starter --out x --pack 99", "choose 0 to"),
    ("figures starter --out x --agent best", "'best'"),
    ("figures starter --out x --only evolution --history-dataset nowhere", "nowhere"),
    # view
    ("view absent.jsonl", "absent.jsonl"),
    ("view starter --pack 99 --no-browser", "99"),
    ("view starter --second 99 --no-browser", "99"),
    ("view starter --port 0", "--port"),
    ("view starter --dataset nowhere", "nowhere"),
    ("view starter --host 999.0.0.1 --no-browser", "999.0.0.1"),
    # render, film, export
    ("render starter --out x.jpg", ".png or .npz"),
    ("render --out x.png", "nothing to draw"),
    ("render starter --out x.png --pack 99", "choose 0 to"),
    ("render starter --out x.png --size 9999", "2048"),
    ("render starter --out x.png --size big", "'big'"),
    ("render starter --out x.png --camera 0,91", "camera"),
    ("render starter --out x.png --camera side", "'side'"),
    ("render starter --out x.png --background reddish", "'reddish'"),
    ("render starter --out x.png --cut y=-1", "y=-1"),
    ("render starter --out x.png --cut w=1", "w=1"),
    ("render starter --out x.png --explode -1", "--explode"),
    ("render starter --out x.png --explode nan", "--explode"),
    ("render starter --out x.png --as-task --color stability", "stability"),
    ("render starter --out x.png --id apple", "--id"),
    ("render --id nothing --out x.png", "nothing"),
    ("render --category dragon --out x.png", "'dragon'"),
    ("render starter --out file/x.png", "file"),
    ("render turn --camera turntable --out x.npz", "x.npz"),
    ("film starter --out x.avi", "x.avi"),
    ("film starter --out x.gif --fps 0", "--fps"),
    ("film starter --out x.gif --seconds 0", "--seconds"),
    ("film starter --out x.gif --seconds nan", "--seconds"),
    ("film starter --out x.gif --cut y=0.5", "--cut"),
    ("film starter --out x.gif --size 8x8", "8x8"),
    ("film absent.jsonl --out x.gif", "absent.jsonl"),
    ("export starter --out x.obj", "x.obj"),
    ("export starter --out x.stl --unit-mm 0", "0.0 mm"),
    ("export starter --out x.stl --unit-mm nan", "nan mm"),
    ("export starter --out x.stl --pack 99", "choose 0 to"),
    ("export starter --out file/x.stl", "file"),
    # compact, score
    ("prepare starter", "nothing to prepare: give --physics"),
    ("prepare nowhere --physics --decomposition bisection", "nowhere"),
    ("prepare starter --physics --decomposition voxels", "voxels"),
    ("compact nowhere", "nowhere"),
    ("compact starter --limit 0", "--limit"),
    ("compact starter --limit 1 --out file/x.json", "file"),
    ("score starter --limit 1 --distance -1", "distance -1.0"),
    ("score starter --limit 1 --distance nan", "distance nan"),
    ("score starter --moves 0", "--moves"),
    ("score starter --library meshes", "meshes"),
    ("score starter --split train", "train"),
    # shapes
    ("shapes list --library nowhere", "'nowhere'"),
    ("shapes list --category dragon", "'dragon': choose from"),
    ("shapes list --library meshes --split train", "split"),
    ("shapes show nothing", "nothing"),
    ("shapes show nothing --library meshes", "nothing"),
    ("shapes stats --library file", "file"),
    ("shapes contact-sheet --out x.png --size 1", "--size"),
    ("shapes contact-sheet --out x.png --columns 0", "--columns"),
    ("shapes contact-sheet --out x.jpg --id nothing", "nothing"),
    ("shapes contact-sheet --out file/x.png", "file"),
    ("shapes import nowhere --out x", "nowhere"),
    ("shapes import folder:absent --out x", "absent"),
    ("shapes import folder:meshes --out folder", "exists already"),
    ("shapes import folder:meshes --out x --up w", "--up"),
    ("shapes import folder:meshes --out x --unit mile", "--unit"),
    ("shapes import folder:meshes --out x --max-triangles 3", "max_triangles 3"),
    ("shapes import folder:meshes --out x --max-error 2", "max_error 2.0"),
    ("shapes import folder:meshes --out x --max-error nan", "max_error nan"),
    ("shapes import folder:meshes --out x --min-thickness 1", "min_thickness 1.0"),
    ("shapes import folder:meshes --out x --memory 0", "--memory"),
    ("shapes import folder:meshes --out x --memory nan", "--memory"),
    ("shapes import folder:meshes --out x --memory inf", "--memory"),
    ("shapes import folder:meshes --out x --timeout -1", "timeout -1.0"),
    ("shapes import folder:meshes --out x --workers -1", "--workers"),
    ("shapes import shapenet:folder --out x", "folder"),
    # datasets
    ("datasets stats nowhere", "nowhere"),
    ("datasets list extra", "extra"),
    ("datasets sequences --out file/x.jsonl", "file"),
    ("datasets sequences --out x --seed -1", "--seed"),
    ("datasets stats broken.jsonl", "broken.jsonl"),
    ("datasets stats starter --split train", "train"),
    ("datasets stats starter --json file/x.json", "file"),
    ("datasets datasheet starter --out x.png", "x.png"),
    ("datasets datasheet nowhere --out x.md", "nowhere"),
    ("datasets sequences --out file", "--out file is a file"),
    ("datasets sequences --out s --sequences 0", "--sequences"),
    ("datasets sequences --out s --cells 21 20 20", "21 x 20 x 20 cells"),
    ("datasets sequences --out s --step-cm nan", "step_cm nan"),
    ("datasets sequences --out s --step-cm 1", "all shapes are larger than the box of 5 x 5 x 5"),
    ("datasets sequences --out s --cells 20 20 512 --step-cm 0.1", "shape 'i' is larger"),
    ("datasets sequences --out s --library nowhere", "'nowhere'"),
    ("datasets sequences --out s --items-of nowhere", "nowhere"),
    ("datasets sequences --out s --split test", "--split has no effect without --items-of"),
    (
        "datasets sequences --out s --items-of starter --step-cm 2",
        "--step-cm has no effect with --items-of",
    ),
    ("datasets archive nothing --out x", "nothing"),
    ("datasets archive nothing --shape-library --out x", "'nothing'"),
    ("datasets archive meshes --shape-library --out x", "is no stored library"),
    ("datasets archive everyday --shape-library --licence MIT --out x", "--licence has no effect"),
    ("datasets archive blockout --shape-library --out folder/..", "is not an empty folder"),
    ("datasets archive starter --out x --date soon", "'soon'"),
    ("datasets original absent --library everyday --out x.jsonl", "absent"),
    ("datasets original broken.json --library everyday --out x.jsonl", "broken.json"),
    # train
    ("train --out x --set speed=1", "'speed'"),
    ("train --out x --set steps", "'steps'"),
    ("train --out x --set steps=0", "steps = 0"),
    ("train --out x --set steps=many", "field 'steps' is 'many'"),
    ("train --out x --set network.width=0", "width"),
    ("train --out x --config absent.toml", "absent.toml"),
    ("train --out x --config broken.jsonl", "broken.jsonl"),
    ("train --out x --set packs=nowhere", "nowhere"),
    ("train --out x --device abacus", "abacus"),
    ("train --out x --ray-workers -1", "--ray-workers"),
    ("train --out x --logger nobody", "there is no logger 'nobody'"),
    ("train --out file", "file is a file, not a folder"),
    # train-champion
    ("train-champion", "Missing option '--out'"),
    ("train-champion --out file", "file is a file, not a folder"),
    ("train-champion --out x --train-on nowhere", "nowhere"),
    ("train-champion --out x --train-on broken.jsonl", "has no splits"),
    ("train-champion --out x --tasks 1", "--tasks"),
    ("train-champion --out x --rounds 0", "--rounds"),
    # train-columns
    ("train-columns", "Missing option '--out'"),
    ("train-columns --out file", "file is a file, not a folder"),
    ("train-columns --out x --buffer 0", "--buffer"),
    ("train-columns --out x --buffer 2 --buffer 2", "buffers = (2, 2) is not possible"),
    ("train-columns --out x --games 0", "--games"),
    # agents
    ("agents bogus", "No such command 'bogus'"),
    ("agents list extra", "extra"),
]

TETRAHEDRON = """OFF
4 4 0
0 0 0
4 0 0
0 4 0
0 0 4
3 0 2 1
3 0 1 3
3 1 2 3
3 2 0 3
"""

INSTANCE = """{"container": {"size-x": 9, "size-y": 9},
 "item-types": [{"path": "good.off", "demand": 1}]}
"""


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "broken.jsonl").write_text('{"format":1,\n')
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "list.json").write_text("[]")
    (tmp_path / "packing.json").write_text('{\n "box": [9, 9, 9], "items": []\n}')
    (tmp_path / "page.html").write_text("<html></html>")
    (tmp_path / "manifest.csv").write_text("file,rotations\ngood.off,round\n")
    (tmp_path / "good.off").write_text(TETRAHEDRON)
    (tmp_path / "instance.json").write_text(INSTANCE)
    (tmp_path / "binary.jsonl").write_bytes(b"\xff\xfe\x00\x80" * 20)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "bad.stl").write_bytes(b"no mesh")
    (tmp_path / "other.json").write_text('{"command": "nest", "options": {}}')
    (tmp_path / "truth.json").write_text('{"options": {"boxes": true}}')
    (tmp_path / "replays" / "box-0").mkdir(parents=True)
    (tmp_path / "replays" / "box-0" / "replay.json").write_text('{"my": "own"}')
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["packit", *command.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert isinstance(ended.value.code, int | None)
    return ended.value.code or 0


def test_every_command_has_a_wrong_command_line() -> None:
    named = {" ".join(command.split()[:2]) for command, _ in WRONG}
    leaves = []
    for command in get_command(app).commands.values():
        own = getattr(command, "commands", None)
        leaves += [f"{command.name} {name}" for name in own] if own else [str(command.name)]
    assert len(leaves) > 20
    assert [
        leaf for leaf in leaves if not any(f"{one} ".startswith(f"{leaf} ") for one in named)
    ] == []


@pytest.mark.parametrize(("command", "message"), WRONG, ids=[command for command, _ in WRONG])
def test_a_wrong_command_line_is_one_line_on_stderr(
    command: str,
    message: str,
    workplace: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    code = run(command, monkeypatch)
    errors = capfd.readouterr().err
    assert code == 2, errors
    assert errors.startswith("error: ") and errors.count("\n") == 1, errors
    assert message in errors


def test_a_long_value_is_not_printed_whole(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(f"pack good.off --box 9x9x9 --out x --door {'x' * 9999}", monkeypatch) == 2
    errors = capfd.readouterr().err
    assert "more] " in errors and len(errors) < 2100


def test_an_operating_system_error_names_the_file(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device", "packs.jsonl")

    monkeypatch.setattr("packit_sim.game.generation.jobs.generate", full)
    assert run("generate --out x", monkeypatch) == 2
    assert capfd.readouterr().err == "error: packs.jsonl: No space left on device\n"


def test_ctrl_c_ends_with_one_line(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    for name in ("game.generation.jobs.generate", "cli.generation_progress.shown"):
        monkeypatch.setattr(f"packit_sim.{name}", stopped)
        assert run("generate --out x", monkeypatch) == 130
        assert capfd.readouterr().out.endswith("stopped: repeat the command to resume\n")
    monkeypatch.setattr("packit_sim.game.datasets.statistics.take", stopped)
    assert run("datasets stats starter", monkeypatch) == 130
    assert capfd.readouterr().out == "stopped: the command is not finished\n"


def test_a_bug_still_gives_a_traceback(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object) -> None:
        raise ValueError("a bug")

    monkeypatch.setattr("packit_sim.game.datasets.statistics.take", broken)
    monkeypatch.setattr(sys, "argv", ["packit", "datasets", "stats", "starter"])
    with pytest.raises(ValueError, match="a bug"):
        main()


def test_the_help_of_all_commands_is_printed(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for command in {line.partition(" ")[0] for line, _ in WRONG if not line.startswith(("-", "b"))}:
        assert run(f"{command} --help", monkeypatch) == 0
        assert "Usage: " in capfd.readouterr().out
    assert run("", monkeypatch) == 2
    assert "Usage: " in capfd.readouterr().out
