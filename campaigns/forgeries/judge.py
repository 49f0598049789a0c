"""Decides whether a record is right, by what it says was asked for and the meshes in its folder.

It imports numpy and scipy, and nothing of PackIt-Sim or trimesh.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, NamedTuple

import numpy as np

from campaigns.forgeries.bodies import Body, read_obj
from campaigns.forgeries.values import (
    ABSENT,
    SIDES,
    UPS,
    Wrong,
    as_integer,
    as_matrix,
    as_number,
    as_text,
    as_walls,
    check_types,
    is_same,
    out_of_range,
    require,
)
from campaigns.packings.random_parts import QUARTERS
from campaigns.packings.shapes import Floats

CENTIMETRES = {"micron": 1e-4, "mm": 0.1, "cm": 1, "in": 2.54, "ft": 30.48, "m": 100}
"""The units of length."""

SETS: Mapping[str, Floats] = {
    "fixed": np.eye(3)[None],
    "yaw-4": QUARTERS[np.abs(QUARTERS[:, 2, 2] - 1) < 1e-9],
    "cube": QUARTERS,
}
"""The sets of rotations of the cases; the only other one is `free`."""

UNDECIDED = ("value", "priority", "no stack", "max load", "deviation")
"""Fields of a requested part that the judge does not understand."""

SETTINGS = ("accuracy", "removable", "stable", "constraints", "separable", "even")
"""The same of the request."""

DOORS: Mapping[str, tuple[float, float, float]] = {
    "x-": (-1, 0, 0),
    "x+": (1, 0, 0),
    "y-": (0, -1, 0),
    "y+": (0, 1, 0),
    "z+": (0, 0, 1),
}
"""The sides of a box through which parts come in, with the ways out."""

DIGEST = re.compile(r'"[0-9a-fA-F]{64}"')

UNUSUAL = re.compile(r"\d{40}|\\u[dD][89a-fA-F]|[\d.][eE][+-]?\d{3}|[\x00-\x08]")
"""Numbers and characters of which readers may differ."""

EXPORT = re.compile(r"instructions\.html|packing(-\d+)?\.(3mf|glb|stl|png|html|gif)", re.ASCII)

NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"

DIGITS = {"volume": 6, "height": 5, "mass": 5, "limits": 5}


class Verdict(NamedTuple):
    """Judge a record: "right", "wrong", "open", or right but for what can't be compared.

    That is "unstated" without a request, and "absent" if exports are missing or not recorded.
    """

    state: str
    reason: str = ""


class Judge:
    """A judge of one record.

    Attributes
    ----------
    doubts : list of str
        What is within the tolerances of the product, or what the judge does not understand.
    absent : list of str
        The exports that are missing or not recorded.
    """

    def __init__(self, folder: Path, honest: Mapping[str, Any]) -> None:
        self.folder = folder
        self._root = os.path.realpath(folder) + os.sep
        self.honest = honest
        self.has_request = True
        self.doubts: list[str] = []
        self.absent: list[str] = []

    def verdict(self, data: bytes) -> Verdict:
        """Judge the text of a record."""
        try:
            record = self._parsed(data)
            self.has_request = record.get("request") is not None
            self._record(record) if self.has_request else self._geometry(record)
        except Wrong as wrong:
            return Verdict("wrong", str(wrong))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as e:
            return Verdict("wrong", f"not of the form: {type(e).__name__} {e}"[:200])
        if self.doubts:
            return Verdict("open", self.doubts[0])
        if self.absent:
            return Verdict("absent", self.absent[0])
        return Verdict("right" if self.has_request else "unstated")

    def _parsed(self, data: bytes) -> dict[str, Any]:
        def refuse(text: str) -> None:
            raise Wrong(f"{text} is not JSON")

        text = data.decode()
        if UNUSUAL.search(DIGEST.sub("", text)):
            self.doubts.append("unusual numbers or characters")
        record = json.loads(text, parse_constant=refuse)
        if not isinstance(record, dict):
            raise Wrong("no object")
        return record

    def _record(self, record: Mapping[str, Any]) -> None:
        once = {"separable": False, "groups": [], "even": False, "door": "z+", "order": None}
        request = once | record["request"]
        require(request["door"] in DOORS and request["order"] in (None, "delivery"), "the door")
        require(as_number(request["clearance"]) >= 0, "clearance")
        as_walls(request["wall clearance"])
        for name in ("unit", "objective", "clearance", "wall clearance"):
            require(is_same(record[name], request[name]), name)
        stated, along_z = record.get("clearance z"), request.get("clearance z")
        require(is_same(stated, along_z), "the clearance along z")
        if along_z is not None and as_number(along_z) != request["clearance"]:
            across = as_number(request["clearance"])
            possible = along_z > 0 and 0.05 <= across / along_z <= 20
            require(possible, "the clearance along z")
            self.doubts.append("a clearance along z")
        require(request["unit"] in CENTIMETRES, "unit")
        asked = self.honest["request"]
        for name in ("objective", *SETTINGS):
            if not is_same(request[name], (once | asked)[name]):
                self.doubts.append(f"another {name}")
        if [box["name"] for box in request["boxes"]] != [box["name"] for box in asked["boxes"]]:
            self.doubts.append("other boxes")
        groups = ("parts", "keep out", "fixed")
        known = {each["name"]: each for group in groups for each in asked[group]}
        for part in (each for group in groups for each in request[group]):
            self._part(part, known)
        parts = {each["name"]: each for each in request["parts"]}
        require(len(parts) == len(request["parts"]), "parts of one name")
        stated = [(each["name"], as_integer(each["count"])) for each in record["parts"]]
        require(stated == [(n, as_integer(p["count"])) for n, p in parts.items()], "the parts")
        self._files(record["files"])
        self._boxes(record, request)
        self._numbers(parts, record)
        meshes = {n: self.mesh(p) for n, p in parts.items() if p["mesh"] is not None}
        self._around(record, request)
        items = []
        for item in record["items"]:
            require(item["name"] in parts, f"nobody asked for {item['name']!r}")
            require(as_text(item["mesh"]) == parts[item["name"]]["mesh"], "another mesh")
            self._own(item, parts[item["name"]])
            items.append((item["name"], as_integer(item["box"]), as_matrix(item["pose"])))
        self.places(request, items, record["box names"], meshes)
        placed = [(name, box, meshes[name].moved(pose)) for name, box, pose in items]
        self.groups(request, placed)
        self._order(request, placed)
        self._told(record, request, items, meshes)

    def _part(self, part: Mapping[str, Any], known: Mapping[str, Any]) -> None:
        """Judge the values of a requested part; those of a part without a mesh are not used."""
        check_types({**ABSENT, **part})
        for key in out_of_range(part):
            require(part["mesh"] is None, f"the {key} of {part['name']!r:.40}")
            self.doubts.append(f"an unused {key}")
        for key in UNDECIDED:
            if not is_same(part.get(key), known.get(part["name"], {}).get(key)):
                self.doubts.append(f"another {key}")

    def _own(self, item: Mapping[str, Any], part: Mapping[str, Any]) -> None:
        """Compare the clearance of its own of an item with that of its part."""
        stated, asked = item.get("clearance"), _own_clearance(part)
        require((stated is None) == (part.get("clearance") is None), "a clearance of its own")
        wrong = abs(as_number(stated or 0.0) - asked)
        self._at_most(wrong, 1e-12 * asked, 1e-8 * asked, "a clearance of its own")

    def _boxes(self, record: Mapping[str, Any], request: Mapping[str, Any]) -> None:
        sizes = {box["name"]: box for box in request["boxes"]}
        used = Counter(record["box names"])
        for name, count in used.items():
            require(name in sizes, f"no box {name!r} was asked for")
            most = sizes[name]["count"]
            require(most is None or count <= as_integer(most), f"too many boxes {name!r}")
        for box in request["boxes"]:
            require(all(as_number(side) > 0 for side in box["size"]), "a side")
            require(box["count"] is None or 1 <= as_integer(box["count"]) <= 10_000, "a count")
            most = box.get("max parts")
            require(most is None or 1 <= as_integer(most) <= 10_000, "a limit on parts")
            most = box.get("max mass")
            require(most is None or 1e-9 <= as_number(most) <= 1e12, "a limit on the mass")
            most = box.get("balance")
            require(most is None or 1e-3 <= as_number(most) <= 0.5, "a balance")
            if box.get("outline") is not None:
                self._part(box["outline"], {})
        own = [sizes[name]["size"] for name in record["box names"]]
        require(record["boxes"] == own and record["box"] == own[0], "the sizes of the boxes")
        asked = {
            name: (box.get("form", "box"), (box.get("outline") or {}).get("mesh"))
            for name, box in sizes.items()
        }
        stated = self._forms(record)
        require(stated == [asked[name] for name in record["box names"]], "the containers")

    def _forms(self, record: Mapping[str, Any]) -> list[tuple[str, str | None]]:
        """Return what each container is, and its mesh; earlier versions had only boxes."""
        stated = record.get("containers", [])
        require(isinstance(stated, list), "the containers")
        found: list[tuple[str, str | None]] = []
        for each in stated or [None] * len(record["boxes"]):
            if each is not None:
                require(each["form"] in ("cylinder", "mesh"), "a container")
                self.doubts.append("a container that is no box")
            found.append(("box", None) if each is None else (each["form"], each.get("mesh")))
        return found

    def _numbers(self, parts: Mapping[str, Any], record: Mapping[str, Any]) -> None:
        packed, left = Counter(item["name"] for item in record["items"]), Counter[str]()
        for each in record["left out"]:
            left[as_text(each["name"])] += as_integer(each["count"])
        for name, part in parts.items():
            require(packed[name] + left[name] == part["count"], f"the number of {name!r}")
            require(left[name] >= 0, f"the number of {name!r}")
        require(set(left) <= set(parts), "others are left out")

    def mesh(self, part: Mapping[str, Any]) -> Body:
        """Read the mesh of a part."""
        path = self.folder / as_text(part["mesh"])
        self._in_folder(path)
        data = path.read_bytes()
        require(hashlib.sha256(data).hexdigest() == part["sha256"], "another digest")
        return read_obj(data.decode())

    def _files(self, files: Mapping[str, Any]) -> None:
        """Judge the digests of all files of the packing."""
        for name, digest in files.items():
            as_text(digest)
            path = PurePosixPath(name)
            require(bool(path.parts) and not path.is_absolute(), f"the path {name!r:.40}")
            require(".." not in path.parts and "\0" not in name, f"the path {name!r:.40}")
            if PureWindowsPath(name).anchor:
                self.doubts.append("a path of Windows")
                continue
            file = self.folder / path
            self._leads_inside(file)
            if not os.path.lexists(file):
                self.absent.append(name)
                continue
            require(file.is_file(), f"no file {name!r}")
            own = hashlib.sha256(file.read_bytes()).hexdigest()
            require(own == digest, f"the digest of {name!r}")
        exports = [each for each in os.listdir(self.folder) if EXPORT.fullmatch(each)]
        self.absent += [each for each in exports if each not in files]

    def _around(self, record: Mapping[str, Any], request: Mapping[str, Any]) -> None:
        asked = [(part, False) for part in request["keep out"]]
        asked += [(part, True) for part in request["fixed"]]
        require(len(asked) == len(record["obstacles"]), "the obstacles")
        for (part, is_part), stated in zip(asked, record["obstacles"], strict=True):
            same = (stated["name"], stated["mesh"], stated["is part"]) == (
                *(part["name"], part["mesh"], is_part),
            )
            require(same and isinstance(stated["is part"], bool), "an obstacle")
            self._own(stated, part)
            place = np.zeros((4, 4))
            place[:3, :3] = part["scale"] * UPS[part["up"]]
            place[3, 3] = 1
            require(
                np.allclose(as_matrix(stated["pose"]), place, 1e-6, 0), "the place of an obstacle"
            )
            if not is_same(part["rotations"], "fixed") or not is_same(part["count"], 1):
                self.doubts.append("an obstacle that turns")

    def places(
        self,
        request: Mapping[str, Any],
        items: Sequence[tuple[str, int, Floats]],
        box_names: Sequence[str],
        meshes: Mapping[str, Body],
    ) -> None:
        """Judge items, each a name, the number of a box and a pose, by the meshes of their files.

        Raises
        ------
        Wrong
            If an item is not as it was asked for, or where nothing may be.
        """
        parts = {each["name"]: each for each in request["parts"]}
        sizes = {box["name"]: np.array(box["size"], float) for box in request["boxes"]}
        walls = as_walls(request["wall clearance"])
        placed: list[tuple[int, Body]] = []
        own: dict[Body, float] = {}
        for name, box, pose in items:
            require(0 <= box < len(box_names) and name in meshes, f"the box of {name!r}")
            self._turn(parts[name], pose)
            body, size = meshes[name].moved(pose), sizes[box_names[box]]
            self._inside(body, size, walls)
            placed.append((box, body))
            own[body] = _own_clearance(parts[name])
        around = []
        for part in (*request["keep out"], *request["fixed"]):
            around.append(self.mesh(part).moved(_upright(part)))
            own[around[-1]] = _own_clearance(part)
        boxes = [sizes[name] for name in box_names]
        self._apart(placed, boxes, request["clearance"], around, own)

    def _inside(self, body: Body, size: Floats, walls: tuple[Floats, Floats]) -> None:
        longest = float(size.max())
        for wall, depths in ((walls[0], -body.low), (walls[1], body.high - size)):
            for asked, depth in zip(wall.tolist(), depths.tolist(), strict=True):
                slack = _tolerance(longest, body) if asked == 0 else 1e-7 * longest
                most = 3 * slack + 2e-6 * longest
                self._at_most(depth + asked, slack, most, "in the walls")

    def _apart(
        self,
        placed: Sequence[tuple[int, Body]],
        sizes: Sequence[Floats],
        clearance: float,
        around: Sequence[Body],
        own: Mapping[Body, float],
    ) -> None:
        """Judge bodies, each in a box, and obstacles in all boxes.

        Some have clearances of their own.
        """
        for n, (box, body) in enumerate(placed):
            longest = float(sizes[box].max())
            for other in (*(one for own, one in placed[:n] if own == box), *around):
                largest = max(clearance, own[body], own[other])
                self._between(body, other, largest, longest)

    def counts(
        self, request: Mapping[str, Any], names: Sequence[str], box_names: Sequence[str]
    ) -> None:
        """Judge how many of each part and of each box there are.

        Raises
        ------
        Wrong
            If there are more than were asked for.
        """
        for group, own in ((request["parts"], names), (request["boxes"], box_names)):
            most = {each["name"]: each["count"] for each in group}
            for name, number in Counter(own).items():
                limit = most.get(name, 0)
                require(limit is None or number <= limit, f"{number} of {name!r}")

    def groups(self, request: Mapping[str, Any], placed: Sequence[tuple[str, int, Body]]) -> None:
        """Judge how groups of parts are in boxes.

        Raises
        ------
        Wrong
            If a rule of groups is broken.
        """
        rules = request.get("groups", [])
        require(isinstance(rules, list | tuple), "the rules of groups")
        require(all(rule in ("together", "apart", "kit") for rule in rules), "a rule of groups")
        groups = {each["name"]: each.get("group") for each in request["parts"]}
        known = {group for group in groups.values() if group is not None}
        boxes = {
            group: {box for name, box, _ in placed if groups[name] == group} for group in known
        }
        if "together" in rules or "kit" in rules:
            require(all(len(own) < 2 for own in boxes.values()), "a group in two boxes")
        if "apart" in rules:
            for one, other in combinations(sorted(known), 2):
                require(not boxes[one] & boxes[other], "two groups in a box")
        if "kit" in rules:
            for group in known:
                asked = sum(p["count"] for p in request["parts"] if p.get("group") == group)
                own = sum(groups[name] == group for name, _, _ in placed)
                require(own in (0, asked), "a part of a kit")

    def _order(self, request: Mapping[str, Any], placed: Sequence[tuple[str, int, Body]]) -> None:
        """Judge whether parts can be put in, one after the other."""
        stops = self._stops(request, [name for name, _, _ in placed])
        for n, (name, box, _) in enumerate(placed):
            earlier = [one for one in placed[:n] if one[1] == box]
            require(all(stops[name] <= stops[other] for other, _, _ in earlier), "a later stop")
            self._way(request, placed[n], earlier)

    def deliveries(
        self, request: Mapping[str, Any], placed: Sequence[tuple[str, int, Body]]
    ) -> None:
        """Judge whether parts can be taken out, those of each stop before those of later ones.

        Raises
        ------
        Wrong
            If a part can't.
        """
        stops = self._stops(request, [name for name, _, _ in placed])
        left = list(placed)
        while left:
            first = min(stops[name] for name, _, _ in left)
            before = len(left)
            for one in [one for one in left if stops[one[0]] == first]:
                others = [other for other in left if other is not one and other[1] == one[1]]
                try:
                    self._way(request, one, others)
                except Wrong:
                    continue
                left.remove(one)
            require(len(left) < before, "a part in the way")

    def _stops(self, request: Mapping[str, Any], names: Sequence[str]) -> Mapping[str, int]:
        """Return the stop of each part; 1 for all if nothing is delivered."""
        require(type(request["insertable"]) is bool, "insertable")
        stops = {each["name"]: each.get("stop") for each in request["parts"]}
        if request.get("order") is None:
            return dict.fromkeys(stops, 1)
        require(all(type(stops[name]) is int for name in names), "a part without a stop")
        return stops

    def _way(
        self,
        request: Mapping[str, Any],
        one: tuple[str, int, Body],
        others: Sequence[tuple[str, int, Body]],
    ) -> None:
        """Judge whether others are in a part's way through the door, if it has to be free."""
        if request.get("order") is None and not request["insertable"]:
            return
        if request["fixed"] or request["keep out"]:
            self.doubts.append("ways past obstacles")
        longest = max(float(side) for box in request["boxes"] for side in box["size"])
        x, y, z = (4 * longest * np.array(DOORS[request.get("door", "z+")])).tolist()
        for _, _, other in others:
            width = min(_tolerance(longest, one[2]), _tolerance(longest, other))
            gap = one[2].gap_on_way(other, (x, y, z))
            self._at_most(-gap, 0.3 * width, 2 * width, "a part in the way")

    def _turn(self, part: Mapping[str, Any], pose: Floats) -> None:
        """Judge the size and the rotation of an item."""
        require(pose[3].tolist() == [0, 0, 0, 1], "the last row")
        turn = pose[:3, :3] / part["scale"] @ UPS[part["up"]].T
        size = float(np.abs(turn.T @ turn - np.eye(3)).max())
        self._at_most(size, 3e-7, 1e-5, "another size, or sheared")
        require(np.linalg.det(turn) > 0, "mirrored")
        self._leaning(part, turn)
        if part["rotations"] == "free":
            return
        require(part["rotations"] in SETS, "no rotations")
        far = float(np.abs(SETS[part["rotations"]] - turn).max(axis=(1, 2)).min())
        self._at_most(far, 3e-7, 1e-5, "a rotation that nobody asked for")

    def _leaning(self, part: Mapping[str, Any], turn: Floats) -> None:
        """Judge how far an item leans, and which of its sides faces down."""
        tilt = float(np.degrees(np.arctan2(np.linalg.norm(turn[:2, 2]), turn[2, 2])))
        beyond = tilt - as_number(part.get("max tilt", 180.0))
        self._at_most(np.radians(beyond), 3e-7, 1e-5, "a tilt")
        lowest = {name: float((turn @ way)[2]) for name, way in SIDES.items()}
        least = min(lowest[name] for name in part.get("down", SIDES))
        self._at_most(least - min(lowest.values()), 3e-7, 1e-5, "a side that may not face down")

    def limits(
        self,
        request: Mapping[str, Any],
        box_names: Sequence[str],
        placed: Sequence[tuple[str, int, Body]],
        meshes: Mapping[str, Body],
    ) -> list[float]:
        """Judge the limits of the boxes.

        Returns
        -------
        list of float
            The numbers that the summary has of them.

        Raises
        ------
        Wrong
            If a limit is not kept.
        """
        volumes, masses = _measured(request, meshes)
        boxes = {box["name"]: box for box in request["boxes"]}
        found: list[float] = []
        for number, name in enumerate(box_names):
            inside = [masses[each] for each, box, _ in placed if box == number]
            sums = []
            if (most := boxes[name].get("max mass")) is not None:
                require(None not in masses.values(), "a mass for a limit")
                total = sum(mass or 0.0 for mass in inside)
                require(total <= most * (1 + 1e-6), "a mass above the limit")
                sums += [total, most]
            if (most := boxes[name].get("max parts")) is not None:
                require(len(inside) <= most, "parts above the limit")
                sums += [len(inside), most]
            if (most := boxes[name].get("balance")) is not None:
                known = [each is not None for each in masses.values()]
                require(all(known) or not any(known), "masses for a balance")
                weights = {each: masses[each] or volume for each, volume in volumes.items()}
                own = [
                    (weights[each], body.centre[:2]) for each, box, body in placed if box == number
                ]
                centre = np.average([c for _, c in own], axis=0, weights=[w for w, _ in own])
                off = np.abs(centre / np.array(boxes[name]["size"][:2]) - 0.5)
                self._at_most(float(off.max()) - most, -2e-3, 2e-3, "out of balance")
                sums += [*(100 * off).tolist(), 100 * most]
            if sums and len(box_names) > 1:
                found.append(number + 1)
            found += sums
        return found

    def _powder(
        self,
        powder: Mapping[str, Any],
        request: Mapping[str, Any],
        box_names: Sequence[str],
        placed: Sequence[tuple[str, int, Body]],
        masses: Mapping[str, float | None],
    ) -> list[float]:
        """Judge the powder; return the numbers that the summary has of it."""
        density, refresh = as_number(powder["density"]), as_number(powder["refresh"])
        require(1e-9 <= density <= 1e6 and 0 < refresh <= 1, "the powder")
        require(None not in masses.values(), "a mass for the powder")
        boxes = {box["name"]: box for box in request["boxes"]}
        bed = 0.0
        for number, name in enumerate(box_names):
            x, y, _ = boxes[name]["size"]
            base = x * y * (np.pi / 4 if boxes[name].get("form") == "cylinder" else 1)
            bed += base * max(float(body.high[2]) for _, box, body in placed if box == number)
        parts = sum(body.volume for _, _, body in placed)
        mass = sum(masses[name] or 0.0 for name, _, _ in placed)
        total = (bed - parts) * CENTIMETRES[request["unit"]] ** 3 * density + mass
        return [total, 100 * mass / total, refresh * total, 100 * refresh]

    def _between(self, one: Body, other: Body, clearance: float, longest: float) -> None:
        gap = one.gap(other)
        width = min(_tolerance(longest, one), _tolerance(longest, other))
        self._at_most(-gap, 0.3 * width, 2 * width, "an overlap")
        if clearance > 0 and gap < clearance:
            most = 3e-6 * longest if self.has_request else 1.1 * width
            missing = clearance - one.distance(other)
            self._at_most(missing, 1e-7 * longest, most, "a clearance")

    def _told(
        self,
        record: Mapping[str, Any],
        request: Mapping[str, Any],
        items: Sequence[tuple[str, int, Floats]],
        meshes: Mapping[str, Body],
    ) -> None:
        """Judge volumes, masses and the summary."""
        unit, summary = request["unit"], record["summary"]
        require(all(isinstance(each, str) for each in summary.values()), "the summary")
        volumes, masses = _measured(request, meshes)
        for each in record["parts"]:
            as_number(each["volume"])
            require(each["mass"] is None or as_number(each["mass"]) is not None, "a mass")
            if each["name"] not in volumes:
                continue
            own = (volumes[each["name"]], masses[each["name"]])
            for said, right in zip((as_number(each["volume"]), each["mass"]), own, strict=True):
                require((said is None) == (right is None), "a mass")
                if said is not None and right is not None:
                    wrong = abs(as_number(said) / right - 1) if right else 1.0
                    self._at_most(wrong, 5e-7, 3e-6, "a volume or a mass")
        placed = [(name, box, meshes[name].moved(pose)) for name, box, pose in items]
        total = sum(part["count"] for part in request["parts"])
        is_most = any(part.get("as many as fit") for part in request["parts"])
        of = "" if is_most else f"of {total} "
        require(summary["packed"] == f"{len(items)} {of}parts", "the number of parts")
        boxes = [np.array(size, float) for size in record["boxes"]]
        longest = max(float(side) for box in request["boxes"] for side in box["size"])
        require(all(any(box == n for _, box, _ in placed) for n in range(len(boxes))), "a box")
        volume = sum(volumes[name] for name, _, _ in placed)
        known = None not in [masses[name] for name, _, _ in placed]
        true: dict[str, list[float]] = {
            "boxes": [float(side) for size in boxes for side in size],
            "volume": [volume],
            "density": [volume / sum(float(size.prod()) for size in boxes)],
            "height": [max(float(body.high[2]) for _, _, body in placed)],
        }
        pairs = [
            body.distance(other)
            for n, (_, box, body) in enumerate(placed)
            for _, other_box, other in placed[:n]
            if other_box == box
        ]
        undone = summary.get("check") == "not done" and "smallest distance" not in summary
        if pairs and not undone:
            true["smallest distance"] = [min(pairs)]
        true["mass"] = [sum(masses[name] or 0.0 for name, _, _ in placed)] if known else []
        for number in range(len(boxes)):
            inside = [(name, body) for name, box, body in placed if box == number]
            weights = [(masses[name] or 0.0) if known else volumes[name] for name, _ in inside]
            line = "centre of gravity" if len(boxes) == 1 else f"centre, box {number + 1}"
            centres = np.array([body.centre for _, body in inside])
            true[line] = np.average(centres, axis=0, weights=weights).tolist()
        if (powder := request.get("powder")) is not None:
            true["powder"] = self._powder(powder, request, record["box names"], placed, masses)
        if limits := self.limits(request, record["box names"], placed, meshes):
            true["limits"] = limits
        texts = _deliveries(request, [name for name, _, _ in placed])
        of_stops = {name: summary[name] for name in ("door", "deliveries") if name in summary}
        require(of_stops == texts, "the deliveries")
        lines = set(summary) - {"check", "linked pairs", "door", "deliveries"}
        require(lines == {"packed", *true}, "the lines of the summary")
        convex = summary.get("linked pairs", "none")  # earlier versions have no such line
        require(convex == "none", "the linked pairs")
        for name, values in true.items():
            text = summary[name]
            words = re.sub(NUMBER, "#", self.honest["summary"].get(name, ""))
            words = re.sub(rf"\b{self.honest['unit']}\b", unit, words)
            require(re.sub(NUMBER, "#", text) == words, f"the words of {name!r}")
            stated = [float(each) for each in re.findall(NUMBER, text.replace(unit + "³", ""))]
            if name == "boxes":
                stated = [
                    float(side)
                    for size in re.findall(rf"({NUMBER}) x ({NUMBER}) x ({NUMBER})", text)
                    for side in size[:3]
                ]
            require(len(stated) == len(values), f"the numbers of {name!r}")
            for one, other in zip(stated, values, strict=True):
                last = 10.0 ** (np.floor(np.log10(abs(other) or 1e-30)) + 1 - DIGITS.get(name, 4))
                last = max(last, 1e-3 if name == "density" else 1e-6 * longest)
                self._at_most(abs(one - other), 0.9 * last, 2.1 * last, f"the summary's {name!r}")

    def _geometry(self, record: Mapping[str, Any]) -> None:
        """Judge a record without a request: meshes at their places keep clear of each other."""
        known = {"items", "obstacles", "boxes", "clearance", "unit"}
        if not known <= set(record) or not isinstance(record["unit"], str):
            self.doubts.append("fields of another program")
        sizes = [np.array([as_number(side) for side in size]) for size in record["boxes"]]
        clearance = as_number(record["clearance"])
        self._forms(record)
        require(clearance >= 0 and all((size > 0).all() for size in sizes), "a length")
        bodies: dict[bool, list[tuple[int, Body]]] = {False: [], True: []}
        own: dict[Body, float] = {}
        for is_item, group in ((True, record["items"]), (False, record["obstacles"])):
            for each in group:
                pose, box = as_matrix(each["pose"]), as_integer(each["box"]) if is_item else 0
                scale = np.cbrt(np.linalg.det(pose[:3, :3]))
                require(scale > 0 and pose[3].tolist() == [0, 0, 0, 1], "mirrored")
                turn = pose[:3, :3] / scale
                skew = float(np.abs(turn.T @ turn - np.eye(3)).max())
                self._at_most(skew, 3e-7, 1e-5, "sheared")
                path = self.folder / as_text(each["mesh"])
                self._in_folder(path)
                body = read_obj(path.read_text()).moved(pose)
                bodies[is_item].append((box, body))
                own[body] = as_number(each.get("clearance") or 0.0)
                require(own[body] >= 0, "a clearance of its own")
        for box, body in bodies[True]:
            require(0 <= box < len(sizes), "a box")
            self._inside(body, sizes[box], as_walls(0.0))
        self.doubts += [] if bodies[True] else ["no items"]
        self.doubts += ["a clearance along z"] if record.get("clearance z") is not None else []
        around = [body for _, body in bodies[False]]
        self._apart(bodies[True], sizes, clearance, around, own)

    def _in_folder(self, path: Path) -> None:
        self._leads_inside(path)
        require(os.path.isfile(path), "no mesh")  # also False for a name that is too long

    def _leads_inside(self, path: Path) -> None:
        require(os.path.realpath(path).startswith(self._root), "a file out of the folder")

    def _at_most(self, value: float, right: float, wrong: float, what: str) -> None:
        require(value <= wrong, f"{what}: {value:.3g}")
        if value > right:
            self.doubts.append(f"{what}: {value:.3g}")


def _tolerance(longest: float, body: Body) -> float:
    return min(1e-4 * longest, 1e-3 * float((body.high - body.low).max()))


def _deliveries(request: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
    """Return the lines of the summary on the door, and on the stops of packed parts."""
    texts = {} if request["door"] == "z+" else {"door": str(request["door"])}
    if request["order"] is not None:
        stops = {each["name"]: each.get("stop") for each in request["parts"]}
        require(all(type(stops[name]) is int for name in names), "a part without a stop")
        counts = sorted(Counter(stops[name] for name in names).items())
        texts["deliveries"] = ", ".join(f"stop {stop}: {count}" for stop, count in counts)
    return texts


def _measured(
    request: Mapping[str, Any], meshes: Mapping[str, Body]
) -> tuple[dict[str, float], dict[str, float | None]]:
    """Return the volumes of parts, and their masses in grams, where they have some."""
    parts = {each["name"]: each for each in request["parts"]}
    volumes = {name: mesh.volume * parts[name]["scale"] ** 3 for name, mesh in meshes.items()}
    masses: dict[str, float | None] = {}
    for name, volume in volumes.items():
        masses[name], density = parts[name]["mass"], parts[name]["density"]
        if masses[name] is None and density is not None:
            masses[name] = as_number(density) * volume * CENTIMETRES[request["unit"]] ** 3
    return volumes, masses


def _own_clearance(part: Mapping[str, Any]) -> float:
    return float(part.get("clearance") or 0.0) * float(part["scale"])


def _upright(part: Mapping[str, Any]) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3] = part["scale"] * UPS[part["up"]]
    return matrix
