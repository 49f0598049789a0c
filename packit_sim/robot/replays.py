"""Files with which other simulators replay a trajectory: JSON, the arm's URDF and meshes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from packit_sim.core.files import replace_text
from packit_sim.robot.arm import with_cup
from packit_sim.robot.arms import arm_of
from packit_sim.robot.cell import GRAVITY
from packit_sim.robot.trajectory import Trajectory

FORMAT = "packit-robot-replay 1"


def write_replay(trajectory: Trajectory, folder: Path) -> Path:
    """Write a trajectory for other simulators.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory.
    folder : Path
        A folder, which is created: `replay.json`, the URDF of the arm with each cup, and the mesh
        of each item as OBJ, in m.

    Returns
    -------
    Path
        The JSON file.

    Raises
    ------
    OSError
        If a file can't be written.
    """
    cell, cells = trajectory.cell, trajectory.cells
    arm = arm_of(cell, cells)
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    robot = etree.fromstring(arm.urdf.encode())
    attempts: list[dict[str, Any]] = []
    for n, one in enumerate(trajectory.attempts):
        item, own = one.chosen.item, one.recording
        mesh = folder / "meshes" / f"{n:03d}.obj"
        vertices = np.asarray(item.turned(0).mesh.vertices) * cell.edge
        body = trimesh.Trimesh(vertices, item.shape.mesh.faces, process=False)
        replace_text(mesh, str(body.export(file_type="obj")))
        urdf = f"arm-{own.radius:g}.urdf"
        if own.radius:
            replace_text(folder / urdf, with_cup(arm.urdf, own.radius))
        attempts.append(
            {
                "shape": item.shape.id,
                "mesh": f"meshes/{mesh.name}",
                "mass": cell.mass(item.volume),
                "outcome": str(one.outcome),
                "urdf": urdf if own.radius else None,
                "held": list(own.held),
                "joints": own.joints.tolist(),
                "items": own.rows.tolist(),
                "poses": (own.poses * np.array([cell.edge] * 3 + [1.0] * 4)).tolist(),
            }
        )
    file = folder / "replay.json"
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
        "attempts": attempts,
    }
    replace_text(file, json.dumps(content) + "\n")
    return file
