"""Draw four moments of a recorded execution: presented, held, on the way down, and packed.

    .venv/bin/python -m benchmarks.robot_pictures build/robot/everyday-v1-closed-loop.jsonl
    .venv/bin/python -m benchmarks.robot_pictures RESULTS --film --name film-robot.gif
    .venv/bin/python -m benchmarks.robot_pictures RESULTS --labels --name robot-cell.png

Draws one attempt of the first result of a file, by PyBullet's software renderer, side by side into
a picture of the page about the robot; or films the whole of it; or names the parts of the cell in
one moment.
"""

from __future__ import annotations

import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import trimesh
from PIL import Image, ImageDraw

from benchmarks.common import argument_parser
from packit_sim import ShapeLibrary
from packit_sim.game.evaluation.results import read_results, stored_trajectory
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CELL
from packit_sim.render import films, robot_films, video
from packit_sim.render.coloring import color_of
from packit_sim.robot.arms import arm_of
from packit_sim.robot.panda import PEDESTAL
from packit_sim.robot.trajectory import Trajectory

PICTURES = Path(__file__).parents[1] / "docs" / "images"

SIDE = 440
"""Pixels of a moment's picture."""

FILM_SIDE = 360
"""Pixels of a film."""

FPS = 8
"""Frames per second of a film."""

EDGE = 0.006
"""Thickness of the box's edges, m."""

STEEL, TABLE, RIM = (0.55, 0.6, 0.66, 1), (0.93, 0.92, 0.9, 1), (0.35, 0.3, 0.25, 1)


VIEWS = {"panda": ((1.6, -1.0, 1.35), (-0.12, 0.28, 0.52))}
"""Positions of the camera and of its target, by arm, in m."""


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--attempt", type=int, default=10)
    parser.add_argument("--name", default="robot.png")
    parser.add_argument("--film", action="store_true", help="all attempts, twelve times as fast")
    parser.add_argument("--labels", action="store_true", help="one moment, with names")
    options = parser.parse_args()
    rollout = read_results(options.results)[0]
    library = ShapeLibrary.open(rollout.pack.library.name)
    trajectory = stored_trajectory(options.results, rollout, library)
    path = PICTURES / options.name
    if options.film:
        box, frames = robot_films.executing(trajectory, fps=FPS, speed=12.0)
        video.write(path, films.shot(box, frames, FILM_SIDE, FILM_SIDE), FPS)
        return
    own = trajectory.attempts[options.attempt].recording
    begin, end = own.held
    arm = arm_of(trajectory.cell, trajectory.cells)
    heights = [arm.poses(joints)[-1].translation[2] for joints in own.joints[begin:end]]
    highest = begin + int(np.argmax(heights))
    if options.labels:
        Image.fromarray(labelled(trajectory, options.attempt, highest)).save(path, optimize=True)
        return
    steps = (begin, highest, (highest + 2 * end) // 3, len(own.joints) - 1)
    pictures = [drawn(trajectory, options.attempt, step) for step in steps]
    Image.fromarray(np.concatenate(pictures, axis=1)).save(path, optimize=True)
    print(f"wrote {path}: steps {steps} of item {options.attempt}")


def labelled(trajectory: Trajectory, attempt: int, step: int) -> Any:
    """Return the picture of a moment with the names of the parts of the cell."""
    cell, cells = trajectory.cell, trajectory.cells
    size, arm = cell.size(cells), arm_of(cell, cells)
    *_, wrist, _, tube, tool = arm.poses(trajectory.attempts[attempt].recording.joints[step])
    named = {
        "box": size * (1, 1, 0.5),
        "station": cell.station(cells),
        "arm": wrist.translation,
        "tube": (2 * tube.translation + wrist.translation) / 3,
        "cup": tool.translation,
    }
    if arm.base.translation.any():
        named["pedestal"] = arm.base.translation * (1, 1, 0.5)
    matrices = [np.array(one).reshape(4, 4).T for one in _camera(trajectory)]
    image = Image.fromarray(drawn(trajectory, attempt, step))
    draw = ImageDraw.Draw(image)
    for name, point in named.items():
        x, y, _, w = matrices[1] @ matrices[0] @ np.append(point, 1.0)
        at = SIDE * (0.5 + x / w / 2), SIDE * (0.5 - y / w / 2)
        end = at[0] + 45, at[1] - 20
        draw.line((at, end), fill=(20, 20, 20))
        own = (end[0] + 3, end[1] - 8)
        draw.text(own, name, (20, 20, 20), font_size=15, stroke_width=3, stroke_fill="white")
    return np.asarray(image)


def _camera(trajectory: Trajectory) -> tuple[Any, Any]:
    """Return the view and the lens of PyBullet's camera."""
    x, y, z = trajectory.cell.size(trajectory.cells)
    default = ((x / 2 - 0.8, -0.6, 0.85), (x / 2, y, z * 0.75))
    place, target = VIEWS.get(trajectory.cell.arm, default)
    view = pybullet.computeViewMatrix(place, target, (0, 0, 1))
    return view, pybullet.computeProjectionMatrixFOV(38, 1, 0.1, 5)


def drawn(trajectory: Trajectory, attempt: int, step: int) -> Any:
    """Return the picture (height, width, 3) of a moment, as uint8."""
    cell = trajectory.cell
    client = pybullet.connect(pybullet.DIRECT)
    try:
        with tempfile.TemporaryDirectory() as folder:
            for number, rows in poses(trajectory, attempt, step).items():
                item = trajectory.attempts[number].chosen.item
                mesh = item.turned(0).mesh
                path = Path(folder) / f"{number}.obj"
                trimesh.Trimesh(mesh.vertices * cell.edge, mesh.faces, process=False).export(path)
                color = (*color_of(item.shape)[:3], 1)
                w, x, y, z = rows[3:].tolist()
                _add(client, rows[:3] * cell.edge, color, file=str(path), turn=(x, y, z, w))
            joints = trajectory.attempts[attempt].recording.joints[step]
            arm = arm_of(cell, trajectory.cells)
            for n, (body, pose) in enumerate(zip(arm.bodies, arm.poses(joints), strict=False)):
                path = Path(folder) / f"arm-{n}.obj"
                body.export(path)
                _add(client, pose.translation, STEEL, file=str(path), turn=pose.xyzw)
            if arm.base.translation.any():
                foot = arm.base.translation * (1, 1, 0.5)
                _add(client, foot, TABLE, np.array((PEDESTAL, PEDESTAL, 2 * foot[2])))
            x, y, z = np.array(trajectory.cells) * CELL * cell.edge
            for a, b in product((0, 1), repeat=2):
                _add(client, (x / 2, a * y, b * z), RIM, np.array((x + EDGE, EDGE, EDGE)))
                _add(client, (a * x, y / 2, b * z), RIM, np.array((EDGE, y + EDGE, EDGE)))
                _add(client, (a * x, b * y, z / 2), RIM, np.array((EDGE, EDGE, z)))
            _add(client, (x / 2, 0, -0.01), TABLE, np.array((3, 3, 0.02)))
            _, _, pixels, *_ = pybullet.getCameraImage(
                2 * SIDE,
                2 * SIDE,
                *_camera(trajectory),
                lightDirection=(-0.6, -1, 2),
                shadow=1,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=client,
            )
            image = Image.fromarray(np.asarray(pixels, np.uint8).reshape(2 * SIDE, 2 * SIDE, 4))
            return np.asarray(image.convert("RGB").resize((SIDE, SIDE), Image.Resampling.LANCZOS))
    finally:
        pybullet.disconnect(client)


def poses(trajectory: Trajectory, attempt: int, step: int) -> dict[int, Floats]:
    """Return position and quaternion (7,) of each item that was tried so far."""
    found: dict[int, Floats] = {}
    for number in range(attempt + 1):
        own = trajectory.attempts[number].recording
        for row, pose in zip(own.rows, own.poses, strict=True):
            if number < attempt or row[0] <= step:
                found[int(row[1])] = pose
    return found


def _add(
    client: int,
    place: Any,
    color: tuple[float, ...],
    size: Floats | None = None,
    file: str = "",
    turn: tuple[float, ...] = (0, 0, 0, 1),
) -> None:
    if size is not None:
        form = {"shapeType": pybullet.GEOM_BOX, "halfExtents": (size / 2).tolist()}
    else:
        form = {"shapeType": pybullet.GEOM_MESH, "fileName": file}
    shape = pybullet.createVisualShape(**form, rgbaColor=color, physicsClientId=client)
    pybullet.createMultiBody(
        baseVisualShapeIndex=shape,
        basePosition=list(map(float, place)),
        baseOrientation=turn,
        physicsClientId=client,
    )


if __name__ == "__main__":
    main()
