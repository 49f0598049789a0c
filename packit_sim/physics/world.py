"""A PyBullet world in which packed items move: gravity, the box's walls, contacts, friction."""

from __future__ import annotations

import contextlib
import functools
import math
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from packit_sim.core.errors import PhysicsError
from packit_sim.core.silence import quiet
from packit_sim.geometry.obj_text import UNIT, objects
from packit_sim.geometry.poses import Pose
from packit_sim.physics.convex.pieces import Floats, MassProperties, Piece
from packit_sim.physics.settings import PhysicsSettings

WALLS = ("left", "right", "back", "front", "floor")
"""What a box is made of: low and high x, low and high y, and the ground that it stands on."""

_THICKNESS = 0.25
"""Of the walls, in box units."""

_ITERATIONS = 120
"""Of the solver of contacts, in each step."""

_NEAR = 0.002
"""Box units at which PyBullet begins to watch a contact, and forgets it again."""

_NO_BOUNCE = 0.05
"""m/s below which nothing bounces: else items would rattle and never rest."""


@dataclass(frozen=True, eq=False)
class _Body:
    """PyBullet's number for an item, and where it was put.

    bulk: of its pieces, in box units. reach: from the centre of mass to its farthest corner.
    """

    number: int
    mass: float
    bulk: MassProperties
    reach: float


class World:
    """The box's walls on the ground, and what is put in, in a PyBullet world of its own.

    size: (3,) of the box in box units. The box is open above; what leaves it lands beside it. Close
    it, or use it in a `with`. PyBullet's own units are 100 to a box unit, in which its tolerances,
    such as the 0.001 by which it grows hulls, are far below the contact tolerance.
    """

    def __init__(self, size: Floats, settings: PhysicsSettings) -> None:
        self._pybullet = _pybullet()
        self._settings = settings
        self._scale = UNIT / settings.side
        with contextlib.ExitStack() as undo:
            self._folder = Path(tempfile.mkdtemp(prefix="packit-world-"))
            undo.callback(shutil.rmtree, self._folder, ignore_errors=True)
            with quiet():
                self._client = self._pybullet.connect(self._pybullet.DIRECT)
            if self._client < 0:
                raise PhysicsError("PyBullet has no room for another world: close other ones")
            undo.callback(_disconnect, self._client)
            self._set_up()
            self._walls = self._build_walls(size)
            self.close = weakref.finalize(self, undo.pop_all().close)
        self._bodies: list[_Body] = []

    def __enter__(self) -> World:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def add(self, pieces: Sequence[Piece], mass: float) -> int:
        """Puts in an item of convex pieces, where they are; returns its number.

        mass: kg, spread evenly over the pieces; 0 for an item that stays where it is.
        """
        bulk = MassProperties.of(pieces)
        own = [((p.vertices - bulk.center) @ bulk.axes, p.faces) for p in pieces]
        path = self._folder / f"{len(self._bodies)}.obj"
        path.write_text(objects(own, 1.0))
        with quiet():
            shape = self._pybullet.createCollisionShape(
                self._pybullet.GEOM_MESH, fileName=str(path), physicsClientId=self._client
            )
        number = self._body(shape, mass, Pose.from_axes(bulk.center, bulk.axes))
        if mass:
            self._pybullet.changeDynamics(
                number,
                -1,
                mass=mass,  # else it becomes 0
                localInertiaDiagonal=(bulk.moments * mass * UNIT**2).tolist(),
                physicsClientId=self._client,
            )
        reach = max(float(np.linalg.norm(vertices, axis=1).max()) for vertices, _ in own)
        self._bodies.append(_Body(number, mass, bulk, reach))
        return len(self._bodies) - 1

    def ignore(self, one: int, other: int) -> None:
        """Lets two items pass through each other."""
        numbers = (self._bodies[n].number for n in (one, other))
        self._pybullet.setCollisionFilterPair(*numbers, -1, -1, 0, physicsClientId=self._client)

    def step(self) -> None:
        """Goes on by one step of time."""
        self._pybullet.stepSimulation(physicsClientId=self._client)

    @property
    def speeds(self) -> Floats:
        """(n,) m/s that no point of an item exceeds."""
        found = []
        for body in self._bodies:
            linear, angular = (np.linalg.norm(v) for v in self._velocity(body))
            found.append(float(linear + angular * body.reach * UNIT) / self._scale)
        return np.array(found)

    @property
    def moves(self) -> list[Floats]:
        """How each item has moved since it was put in: (4, 4) matrices, in box units."""
        found = []
        for body in self._bodies:
            pose = self._pose(body)
            move = np.eye(4)
            move[:3, :3] = pose.axes @ body.bulk.axes.T
            move[:3, 3] = pose.position - move[:3, :3] @ body.bulk.center
            found.append(move)
        return found

    @property
    def contacts(self) -> set[tuple[int, int | str]]:
        """Items that press on each other, the lower number first, and on which of `WALLS`."""
        names: dict[int, int | str] = {body.number: n for n, body in enumerate(self._bodies)}
        names |= dict(zip(self._walls, WALLS, strict=True))
        points = self._pybullet.getContactPoints(physicsClientId=self._client)
        found = set()
        for point in points:
            one, other = names[point[1]], names[point[2]]
            if isinstance(one, str) or (isinstance(other, int) and other < one):
                one, other = other, one
            if isinstance(one, int) and point[9] > 0:
                found.add((one, other))
        return found

    @property
    def energy(self) -> float:
        """J of all that can move: of its motion, and of its height above the ground."""
        total = 0.0
        for body in self._bodies:
            pose = self._pose(body)
            linear, angular = (np.array(v) for v in self._velocity(body))
            spin = body.bulk.moments * UNIT**2 @ (pose.axes.T @ angular) ** 2
            height = pose.position[2] * self._settings.side
            total += body.mass * (
                (linear @ linear + spin) / self._scale**2 / 2 + self._settings.gravity * height
            )
        return total

    def _set_up(self) -> None:
        settings = self._settings
        self._pybullet.setGravity(
            0, 0, -settings.gravity * self._scale, physicsClientId=self._client
        )
        self._pybullet.setPhysicsEngineParameter(
            fixedTimeStep=settings.step,
            numSolverIterations=_ITERATIONS,
            useSplitImpulse=0,  # with it light items below heavy ones creep for seconds
            contactBreakingThreshold=_NEAR * UNIT,
            restitutionVelocityThreshold=_NO_BOUNCE * self._scale,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            physicsClientId=self._client,
        )

    def _build_walls(self, size: Floats) -> list[int]:
        """Bodies of `WALLS`, in order."""
        walls = []
        for axis in (0, 1):
            half = size / 2 + _THICKNESS * np.array((1, 1, 0))
            half[axis] = _THICKNESS / 2
            for side in (-half[axis], size[axis] + half[axis]):
                center = size / 2
                center[axis] = side
                shape = self._pybullet.createCollisionShape(
                    self._pybullet.GEOM_BOX,
                    halfExtents=(half * UNIT).tolist(),
                    physicsClientId=self._client,
                )
                walls.append(self._body(shape, 0.0, Pose(center)))
        ground = self._pybullet.createCollisionShape(
            self._pybullet.GEOM_PLANE, physicsClientId=self._client
        )
        return [*walls, self._body(ground, 0.0, Pose(np.zeros(3)))]

    def _body(self, shape: int, mass: float, pose: Pose) -> int:
        number: int = self._pybullet.createMultiBody(
            baseMass=mass,
            baseCollisionShapeIndex=shape,
            basePosition=(pose.position * UNIT).tolist(),
            baseOrientation=pose.xyzw,
            useMaximalCoordinates=1,
            physicsClientId=self._client,
        )
        settings = self._settings
        friction = math.sqrt(settings.friction)  # PyBullet multiplies those of the two bodies,
        arm = settings.rolling * self._scale  # and adds up one's arm times the other's friction
        resistance = arm / friction / 2 if friction else 0.0
        self._pybullet.changeDynamics(
            number,
            -1,
            lateralFriction=friction,
            rollingFriction=resistance,
            spinningFriction=resistance,
            restitution=math.sqrt(settings.restitution),
            linearDamping=settings.damping,
            angularDamping=settings.damping,
            activationState=self._pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        return number

    def _pose(self, body: _Body) -> Pose:
        """Look up the pose of the centre of mass and the principal axes, in box units."""
        position, xyzw = self._pybullet.getBasePositionAndOrientation(
            body.number, physicsClientId=self._client
        )
        return Pose.from_xyzw(np.array(position) / UNIT, xyzw)

    def _velocity(self, body: _Body) -> tuple[Sequence[float], Sequence[float]]:
        """PyBullet's, linear and in radians."""
        found: tuple[Sequence[float], Sequence[float]] = self._pybullet.getBaseVelocity(
            body.number, physicsClientId=self._client
        )
        return found


@functools.cache
def _pybullet() -> Any:
    """Import PyBullet, which takes a tenth of a second and prints its build time."""
    with quiet():
        import pybullet
    return pybullet


def _disconnect(client: int) -> None:
    with quiet():
        _pybullet().disconnect(physicsClientId=client)
