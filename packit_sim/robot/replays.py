"""Files with which other simulators replay a trajectory: JSON, URDF, MJCF and meshes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from packit_sim.core.files import replace_text, require_replaceable, require_same
from packit_sim.robot.arms import arm_of
from packit_sim.robot.cell import GRAVITY
from packit_sim.robot.mjcf import mjcf
from packit_sim.robot.trajectory import Trajectory
from packit_sim.robot.urdf import with_cup

FORMAT = "packit-robot-replay 1"

_DIGITS = 12
"""Digits of a digest in the names of files."""


def write_replay(trajectory: Trajectory, folder: Path) -> Path:
    """Write a trajectory for other simulators.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory.
    folder : Path
        A folder, which is created: `replay.json`, and the files that it names, each with digits of
        its SHA-256 in its name: the URDF of the arm with each cup, the mesh of each item as OBJ,
        in m, and an MJCF with box and items as they are at the end. An earlier replay in it holds
        until `replay.json` is replaced.

    Returns
    -------
    Path
        The JSON file.

    Raises
    ------
    ArgumentError
        If the folder has a `replay.json` of something else, or another file in the way.
    OSError
        If a file can't be written.
    """
    file = folder / "replay.json"
    require_replaceable(file, field=FORMAT)
    cell, cells = trajectory.cell, trajectory.cells
    arm = arm_of(cell, cells)
    robot = etree.fromstring(arm.urdf.encode())
    attempts: list[dict[str, Any]] = []
    for n, one in enumerate(trajectory.attempts):
        item, own = one.chosen.item, one.recording
        vertices = np.asarray(item.turned(0).mesh.vertices) * cell.edge
        body = trimesh.Trimesh(vertices, item.shape.mesh.faces, process=False)
        mesh = _written(folder / "meshes" / f"{n:03d}.obj", str(body.export(file_type="obj")))
        urdf = None
        if own.radius:
            name = f"arm-{own.radius:g}.urdf"
            urdf = _written(folder / name, with_cup(arm.urdf, own.radius)).name
        attempts.append(
            {
                "shape": item.shape.id,
                "mesh": f"meshes/{mesh.name}",
                "mass": cell.mass(item.volume),
                "outcome": str(one.outcome),
                "urdf": urdf,
                "held": list(own.held),
                "joints": own.joints.tolist(),
                "items": own.rows.tolist(),
                "poses": (own.poses * np.array([cell.edge] * 3 + [1.0] * 4)).tolist(),
            }
        )
    last = {
        item: pose
        for one in attempts
        for (_, item), pose in zip(one["items"], one["poses"], strict=True)
    }
    meshes, masses = [one["mesh"] for one in attempts], [one["mass"] for one in attempts]
    model = _written(folder / "cell.xml", mjcf(cell, cells, meshes, masses, last))
    content = {
        "format": FORMAT,
        "arm": cell.arm,
        "base": {
            "position": arm.base.translation.tolist(),
            "quaternion": list(arm.base.wxyz),
        },
        "joints": [one.get("name") for one in robot.iter("joint") if one.get("type") != "fixed"],
        "step": cell.world.step,
        "gravity": GRAVITY,
        "friction": cell.friction,
        "box": cell.size(cells).tolist(),
        "mjcf": model.name,
        "attempts": attempts,
    }
    replace_text(file, json.dumps(content) + "\n")
    return file


def _written(file: Path, text: str) -> Path:
    """Write a file whose name gets digits of its content's digest, and return its path."""
    content = text.encode()
    digest = hashlib.sha256(content).hexdigest()[:_DIGITS]
    own = file.with_name(f"{file.stem}-{digest}{file.suffix}")
    require_same(own, content)
    own.parent.mkdir(parents=True, exist_ok=True)
    replace_text(own, text)
    return own
