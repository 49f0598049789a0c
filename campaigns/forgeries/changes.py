"""Kinds of forgeries: changes of a record and of the meshes in its folder."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from campaigns.forgeries.cases import EXPORTS
from campaigns.fuzzing.hostile_values import NUMBERS, TEXTS
from campaigns.fuzzing.json_changes import json_tree

Record = dict[str, Any]

Change = Callable[[Record, Path, Random], None]

PATHS = (
    *("../secret.obj", "/etc/passwd", "meshes/../../secret.obj", "meshes/a.obj/../../..", "meshes"),
    *("", ".", "~/a.obj", "file:///etc/passwd", "C:\\a.obj", "\\\\host\\a.obj", "/dev/zero"),
    *("meshes/none.obj", "a" * 5000 + ".obj"),
)


def _item(record: Record, rng: Random) -> Any:
    return rng.choice(record["items"])


def _part(record: Record, rng: Random) -> Any:
    return rng.choice([each for each in record["request"]["parts"] if each["mesh"]])


def _factor(rng: Random) -> float:
    return rng.choice((0.4, 0.5, 0.9, 0.999, 1.0001, 1.1, 2.0, 1e-9, 1e9, 1 + 1e-9, -1.0))


def _posed(item: Any, change: Callable[[Any], None]) -> None:
    pose = np.array(item["pose"], float)
    change(pose)
    item["pose"] = pose.tolist()


def moved(record: Record, folder: Path, rng: Random) -> None:
    size = 10.0 ** rng.uniform(-6, 3)

    def change(pose: Any) -> None:
        pose[rng.randrange(3), 3] += rng.choice((-1, 1)) * size

    _posed(_item(record, rng), change)


def scaled(record: Record, folder: Path, rng: Random) -> None:
    factor, about = _factor(rng), rng.random() < 0.5

    def change(pose: Any) -> None:
        pose[:3, : 4 if about else 3] *= factor

    for item in record["items"] if rng.random() < 0.5 else [_item(record, rng)]:
        _posed(item, change)


def turned(record: Record, folder: Path, rng: Random) -> None:
    axis = np.eye(3)[rng.randrange(3)]
    angle = rng.choice((1e-9, 1e-4, 0.02, 0.5, np.pi / 4, np.pi / 2, np.pi))

    def change(pose: Any) -> None:
        pose[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix() @ pose[:3, :3]

    _posed(_item(record, rng), change)


def sheared(record: Record, folder: Path, rng: Random) -> None:
    def change(pose: Any) -> None:
        if rng.random() < 0.5:
            pose[:3, rng.randrange(3)] *= -1
        else:
            pose[rng.randrange(3), rng.randrange(3)] += 10.0 ** rng.uniform(-5, 0)

    _posed(_item(record, rng), change)


def pose_swapped(record: Record, folder: Path, rng: Random) -> None:
    one, other = _item(record, rng), _item(record, rng)
    one["pose"], other["pose"] = other["pose"], one["pose"]


def box_number(record: Record, folder: Path, rng: Random) -> None:
    _item(record, rng)["box"] = rng.choice((0, 1, 2, -1, 10**9, 10**30))


def items_deleted(record: Record, folder: Path, rng: Random) -> None:
    for _ in range(rng.choice((1, 1, 2, len(record["items"])))):
        if record["items"]:
            record["items"].remove(_item(record, rng))


def items_repeated(record: Record, folder: Path, rng: Random) -> None:
    item = deepcopy(_item(record, rng))
    item["pose"][rng.randrange(3)][3] += rng.choice((0, 5, 1000))
    record["items"] += [item] * rng.choice((1, 1, 2, 30))


def item_and_count(record: Record, folder: Path, rng: Random) -> None:
    """Take a part out as if it had been left out: a right record but for its summary."""
    item = _item(record, rng)
    record["items"].remove(item)
    record["left out"].append({"name": item["name"], "count": 1, "reason": "no space was found"})


def renamed(record: Record, folder: Path, rng: Random) -> None:
    names = [each["name"] for each in record["parts"]]
    _item(record, rng)["name"] = rng.choice((*names, *TEXTS))


def mesh_path(record: Record, folder: Path, rng: Random) -> None:
    known = [each["mesh"] for each in record["items"]]
    path = rng.choice((*PATHS, *known, "./" + known[0], known[0].replace("/", "//")))
    _item(record, rng)["mesh"] = path
    if rng.random() < 0.3:
        _part(record, rng)["mesh"] = path


def mesh_edited(record: Record, folder: Path, rng: Random) -> None:
    """Make a mesh smaller or larger, or break its file; sometimes with its new digest."""
    part = _part(record, rng)
    file = folder / part["mesh"]
    text = file.read_text()
    if rng.random() < 0.8:
        factor = abs(_factor(rng))
        rows = [line.split() for line in text.splitlines()]
        rows = [
            [row[0], *(repr(factor * float(x)) for x in row[1:])] if row[0] == "v" else row
            for row in rows
        ]
        text = "\n".join(" ".join(row) for row in rows) + "\n"
        data = text.encode()
    else:
        data = rng.choice((b"", text.encode()[: len(text) // 2], b"\0" * 200))
    file.write_bytes(data)
    if rng.random() < 0.5:
        part["sha256"] = hashlib.sha256(data).hexdigest()
        if rng.random() < 0.8:
            record["files"][part["mesh"]] = part["sha256"]


def mesh_swapped(record: Record, folder: Path, rng: Random) -> None:
    """Exchange two mesh files, or remove one."""
    files = sorted((folder / "meshes").iterdir())
    one, other = rng.sample(files, 2)
    data = one.read_bytes()
    if rng.random() < 0.2:
        one.unlink()
        return
    one.write_bytes(other.read_bytes())
    other.write_bytes(data)


def mesh_linked(record: Record, folder: Path, rng: Random) -> None:
    """Replace a mesh, or the folder of all, by a link out of the folder or within it."""
    outside = folder.parent / "outside"
    shutil.copytree(folder / "meshes", outside)
    meshes = folder / "meshes"
    file = rng.choice(sorted(meshes.iterdir()))
    match rng.randrange(6):
        case 0:
            file.unlink()
            file.symlink_to(outside / file.name)
        case 1:
            shutil.rmtree(meshes)
            meshes.symlink_to(outside)
        case 2:
            (folder / "x").symlink_to("..")
            file.unlink()
            file.symlink_to(Path("../x/outside") / file.name)
        case 3:
            meshes.rename(folder / "inside")
            meshes.symlink_to("inside")
        case 4:
            file.unlink()
            file.symlink_to(rng.choice((file.name, "/dev/zero", "/etc/passwd", ".")))
        case _:
            file.unlink()
            os.mkfifo(file)


def export(record: Record, folder: Path, rng: Random) -> None:
    """Change an export, remove it, replace it by something else, or add one."""
    file = folder / rng.choice(EXPORTS)
    match rng.randrange(6):
        case 0:
            file.write_bytes(rng.randbytes(rng.choice((0, 1, 5000))))
        case 1:
            file.unlink()
        case 2:
            record["files"].pop(file.name)
        case 3:
            (folder / rng.choice(("packing-2.stl", "instructions.html"))).touch()
        case 4:
            other = folder / rng.choice(EXPORTS)
            content = other.read_bytes()
            other.write_bytes(file.read_bytes())
            file.write_bytes(content)
        case _:
            outside = folder.parent / "outside"
            file.rename(outside)
            (folder / "inside").write_text(file.name)
            target = rng.choice((outside, "inside", file.name, "none", "/dev/zero", "meshes"))
            file.symlink_to(target)


def file_listed(record: Record, folder: Path, rng: Random) -> None:
    """Change the list of the packing's files."""
    files = record["files"]
    name = rng.choice(list(files))
    match rng.randrange(4):
        case 0:
            del files[name]
        case 1:
            files[rng.choice((*PATHS, *TEXTS))] = files[name]
        case 2:
            files[name] = rng.choice((*_digests(files[name]), *files.values()))
        case _:
            files[rng.choice(("./", "meshes/../", "/")) + name] = files.pop(name)


def _digests(text: str) -> tuple[Any, ...]:
    flipped = text[:-1] + ("0" if text[-1] != "0" else "1")
    return flipped, text.upper(), "", None


def digest(record: Record, folder: Path, rng: Random) -> None:
    part = _part(record, rng)
    part["sha256"] = rng.choice((*_digests(part["sha256"]), _part(record, rng)["sha256"]))


def count(record: Record, folder: Path, rng: Random) -> None:
    number = rng.randrange(len(record["parts"]))
    new = rng.choice((0, -1, 1, 2, 3, 5, 10**4, 10**5, 10**30, 2.5))
    for group in rng.choice(((record["parts"],), (record["request"]["parts"],), ())) or (
        record["parts"],
        record["request"]["parts"],
    ):
        group[number]["count"] = new


def left_out(record: Record, folder: Path, rng: Random) -> None:
    if record["left out"] and rng.random() < 0.5:
        entry = rng.choice(record["left out"])
        entry["count"] += rng.choice((-1, 1, 10))
    elif record["left out"] and rng.random() < 0.5:
        record["left out"].pop()
    else:
        name = rng.choice((*(each["name"] for each in record["parts"]), "other"))
        record["left out"].append({"name": name, "count": 1, "reason": ""})


def box(record: Record, folder: Path, rng: Random) -> None:
    """Change the size of a box in some of the three places."""
    number = rng.randrange(len(record["boxes"]))
    size = [side * abs(_factor(rng)) for side in record["boxes"][number]]
    if rng.random() < 0.7:
        record["boxes"][number] = size
    if rng.random() < 0.7 and number == 0:
        record["box"] = size
    if rng.random() < 0.5:
        record["request"]["boxes"][min(number, len(record["request"]["boxes"]) - 1)]["size"] = size


def box_name(record: Record, folder: Path, rng: Random) -> None:
    names = record["box names"]
    names[rng.randrange(len(names))] = rng.choice((*names, *TEXTS))
    if rng.random() < 0.2:
        names.append(names[0])


def unit(record: Record, folder: Path, rng: Random) -> None:
    new = rng.choice(("micron", "mm", "cm", "in", "ft", "m", "yard", ""))
    record["unit"] = new
    if rng.random() < 0.5:
        record["request"]["unit"] = new


def clearance(record: Record, folder: Path, rng: Random) -> None:
    name = rng.choice(("clearance", "wall clearance"))
    new = rng.choice((0, 0, 0.01, 0.5, 1.5, 3.0, 1e9, -1.0))
    if rng.random() < 0.7:
        record[name] = new
    if rng.random() < 0.6:
        record["request"][name] = new


def summary_number(record: Record, folder: Path, rng: Random) -> None:
    name = rng.choice(sorted(set(record["summary"]) - {"check"}))
    text = record["summary"][name]
    digits = [n for n, each in enumerate(text) if each.isdigit()]
    if digits:
        at = rng.choice(digits)
        text = text[:at] + rng.choice("0123456789") + text[at + 1 :]
    record["summary"][name] = text


def summary_line(record: Record, folder: Path, rng: Random) -> None:
    name = rng.choice(sorted(set(record["summary"]) - {"check"}))
    text = record["summary"].pop(name)
    if rng.random() < 0.3:
        record["summary"][rng.choice(("grade", name + " "))] = text
    elif rng.random() < 0.3:
        record["summary"][name] = rng.choice((*TEXTS, "0.999", None, 3))


def volume(record: Record, folder: Path, rng: Random) -> None:
    part = rng.choice(record["parts"])
    name = rng.choice(("volume", "mass"))
    part[name] = rng.choice((None, 0, 1.0, (part[name] or 1.0) * _factor(rng)))


def rotations(record: Record, folder: Path, rng: Random) -> None:
    part = _part(record, rng)
    match rng.randrange(4):
        case 0:
            part["max tilt"] = rng.choice((0, 5, 20, 180, 200, -1, "15deg"))
        case 1:
            part["down"] = rng.choice((["z-"], ["x+", "z+"], ["y-"], [], ["bottom"]))
        case _:
            part["rotations"] = rng.choice(("fixed", "yaw-4", "cube", "free", "yaw-0", "all"))


def file_frame(record: Record, folder: Path, rng: Random) -> None:
    part = _part(record, rng)
    if rng.random() < 0.5:
        part["scale"] *= _factor(rng)
    else:
        part["up"] = rng.choice(("x", "y", "z", "w"))


def way_in(record: Record, folder: Path, rng: Random) -> None:
    """Change the door, the stops, or the order in which parts are put in."""
    request = record["request"]
    match rng.randrange(5):
        case 0:
            request["door"] = rng.choice(("x-", "x+", "y-", "y+", "z+", "z-", None))
            if rng.random() < 0.5:
                record["summary"]["door"] = request["door"]
        case 1:
            request["order"] = rng.choice((None, "delivery", "size"))
        case 2:
            request["insertable"] = rng.choice((True, False, 1, None))
        case 3:
            part = rng.choice(request["parts"])
            part["stop"] = rng.choice((None, 0, 1, 2, 3, 10_000, 10_001, 1.5, "2", True))
        case _:
            rng.shuffle(record["items"])


def group(record: Record, folder: Path, rng: Random) -> None:
    """Change the group of a part, or the rules of groups."""
    request = record["request"]
    if rng.random() < 0.5:
        rules = ("together", "apart", "kit", "alone", 3)
        request["groups"] = rng.sample(rules, rng.choice((0, 1, 1, 2)))
    else:
        part = rng.choice(request["parts"])
        part["group"] = rng.choice((None, "A", "B", "", 3, *TEXTS))


def limit(record: Record, folder: Path, rng: Random) -> None:
    """Change a limit of a box, sometimes also in the summary."""
    box = rng.choice(record["request"]["boxes"])
    values = {
        "max mass": (None, 18, 36, 35.9, 40.0, 54, 1e-10, 1e13, "40kg", True),
        "max parts": (None, 3, 5, 4, 8, 0, 10_001, 2.5, "5"),
        "balance": (None, 0.1, 0.001, 0.2, 0.5, 0.6, 0, -0.1, "10%", True),
    }
    name = rng.choice(list(values))
    before, box[name] = box[name], rng.choice(values[name])
    if isinstance(before, float | int) and isinstance(box[name], float | int):
        factor = 100 if name == "balance" else 1
        texts = record["summary"].get("limits", "")
        new = texts.replace(f"of {factor * before:.5g}", f"of {factor * box[name]:.5g}")
        if texts and rng.random() < 0.7:
            record["summary"]["limits"] = new


def powder(record: Record, folder: Path, rng: Random) -> None:
    """Change the powder, or what the summary says of it."""
    request = record["request"]
    match rng.randrange(3):
        case 0:
            density = rng.choice((0.45, 0.5, 0, -1, 1e9, 1e-9, "0.45", None))
            request["powder"] = {"density": density, "refresh": rng.choice((0.2, 1, 0, 1.1, "20%"))}
        case 1:
            request["powder"] = rng.choice((None, {}, [], "0.45:20%", 3))
        case _:
            text = record["summary"].get("powder", "125.2 g, 43% of it parts; 25 g fresh at 20%")
            new = text.replace(rng.choice("0123456789"), rng.choice("0123456789"), 1)
            record["summary"]["powder"] = new


def obstacles(record: Record, folder: Path, rng: Random) -> None:
    around = record["obstacles"]
    if not around:
        around.append({"name": "x", "is part": False, **deepcopy(_posed_mesh(record, rng))})
        return
    match rng.randrange(4):
        case 0:
            around.clear()
        case 1:
            around[0]["is part"] = not around[0]["is part"]
        case 2:
            around[0]["pose"][rng.randrange(3)][3] += rng.choice((1.0, 100.0))
        case _:
            around.append(deepcopy(around[0]))


def _posed_mesh(record: Record, rng: Random) -> Any:
    item = _item(record, rng)
    return {"mesh": item["mesh"], "pose": item["pose"]}


def request_field(record: Record, folder: Path, rng: Random) -> None:
    request = record["request"]
    groups = [request, *request["parts"], *request["boxes"]]
    group = rng.choice(groups)
    del group[rng.choice(sorted(group))]


def request_missing(record: Record, folder: Path, rng: Random) -> None:
    """Leave out the request, as an older version does, and change something else."""
    del record["request"]
    others = (moved, scaled, turned, sheared, pose_swapped, box_number, items_deleted, of_no_matter)
    rng.choice(others)(record, folder, rng)


def of_no_matter(record: Record, folder: Path, rng: Random) -> None:
    """Change fields that state nothing of the packing."""
    match rng.randrange(5):
        case 0:
            record["notes"] = ["a note"] * rng.randrange(5)
        case 1:
            record["created by"] = "another program"
        case 2:
            record["searches"] = rng.randrange(100)
        case 3:
            record["other"] = {"any": ["thing", 1.5, None]}
        case _:
            rng.shuffle(record["left out"])


CHANGES: dict[str, Change] = {
    "nothing that matters": of_no_matter,
    "a part moved": moved,
    "sizes": scaled,
    "a rotation": turned,
    "a mirrored or sheared part": sheared,
    "poses exchanged": pose_swapped,
    "number of a box": box_number,
    "items deleted": items_deleted,
    "items repeated": items_repeated,
    "an item left out": item_and_count,
    "name of an item": renamed,
    "path of a mesh": mesh_path,
    "a mesh edited": mesh_edited,
    "meshes exchanged or removed": mesh_swapped,
    "links": mesh_linked,
    "a digest": digest,
    "an export": export,
    "the list of files": file_listed,
    "counts": count,
    "left out": left_out,
    "size of a box": box,
    "name of a box": box_name,
    "unit": unit,
    "clearances": clearance,
    "a number of the summary": summary_number,
    "a line of the summary": summary_line,
    "volumes and masses": volume,
    "set of rotations": rotations,
    "scale or axis of a file": file_frame,
    "obstacles": obstacles,
    "door, stops and order": way_in,
    "groups": group,
    "limits of a box": limit,
    "powder": powder,
    "a field of the request missing": request_field,
    "the request missing": request_missing,
}

FILES = ("a mesh edited", "meshes exchanged or removed", "links", "an export")
"""Those that change the folder."""

TREE = "any value of the JSON"

BYTES = "any bytes"


def forged(kind: str, record: Record, folder: Path, rng: Random) -> bytes:
    """Forge a record in one way, sometimes in two, and return its text."""
    new = json.loads(json.dumps(record))  # a copy, faster than deepcopy
    if kind in CHANGES:
        CHANGES[kind](new, folder, rng)
        if rng.random() < 0.1 and kind != "nothing that matters":
            other = rng.choice([each for each in CHANGES if each not in FILES])
            with contextlib.suppress(KeyError, IndexError, TypeError, ValueError):
                CHANGES[other](new, folder, rng)
    data = json.dumps(new).encode()
    if kind == TREE:
        data = json_tree(data, rng, lambda data: data)
    elif kind == BYTES:
        at = rng.randrange(len(data))
        data = data[:at] + rng.choice(NUMBERS).encode() + data[at + rng.randrange(4) :]
    return data
