"""A PyBullet world in which items move: gravity, the box's walls, contacts and friction."""

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
from typing import Any, Self

import numpy as np

from packit_sim.core.errors import PhysicsError
from packit_sim.core.extras import needed_for
from packit_sim.core.files import naming
from packit_sim.core.silence import quiet
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.bullet_meshes import UNIT, obj
from packit_sim.geometry.motions import IDENTITY, Motion
from packit_sim.physics.convex.pieces import MassProperties, Piece
from packit_sim.physics.settings import PhysicsSettings

WALLS_AND_FLOOR = ("left", "right", "back", "front", "floor")
"""The parts of a box: the walls at low and high x and at low and high y, and the floor."""

FAST = 1e6
"""Largest speed of what an arm moves, in PyBullet's units, instead of 100."""

_THICKNESS = 0.25
"""Thickness of the walls, in box units."""

_ITERATIONS = 120
"""Iterations of the contact solver in each time step."""

_NEAR = 0.002
"""Distance in box units up to which PyBullet keeps a contact."""

_NO_BOUNCE = 0.05
"""Speed in m/s below which items don't bounce, or else they would rattle and never rest."""

_CHECK_STEPS = 10
"""Time steps between two checks of the speeds."""


@dataclass(frozen=True, eq=False)
class _SimulatedItem:
    """An item in the world, as it was added.

    number: PyBullet's number of its body. properties: mass properties of its pieces, in box units.
    reach: distance from the centre of mass to its farthest corner, in box units.
    """

    number: int
    mass: float
    properties: MassProperties
    reach: float


class World:
    """A separate PyBullet world with the walls of a box on the ground, and items.

    The box is open at the top; items that leave it land next to it. Close the world after use, or
    use it in a `with` statement.

    Parameters
    ----------
    size : ndarray of float64, shape (3,)
        Extents of the box, in box units.

    Attributes
    ----------
    close : Callable[[], None]
        Disconnects from PyBullet; calling it again does nothing.

    Raises
    ------
    PhysicsError
        If PyBullet refuses another world.

    Notes
    -----
    A box unit is 100 of PyBullet's units, so that its tolerances, such as the 0.001 by which it
    grows hulls, are far below the contact tolerance.
    """

    def __init__(self, size: Floats, settings: PhysicsSettings) -> None:
        self._pybullet = pybullet_module()
        self._settings = settings
        self._scale = UNIT / settings.side
        with contextlib.ExitStack() as undo:
            self._folder = Path(tempfile.mkdtemp(prefix="packit-world-"))
            undo.callback(shutil.rmtree, self._folder, ignore_errors=True)
            with quiet():
                self._client = self._pybullet.connect(self._pybullet.DIRECT)
            if self._client < 0:
                raise PhysicsError("PyBullet allows no further world: close other ones")
            undo.callback(_disconnect, self._client)
            self._set_up()
            self._walls = self._build_walls(size)
            self.close = weakref.finalize(self, undo.pop_all().close)
        self._items: list[_SimulatedItem] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def add(self, pieces: Sequence[Piece], mass: float, *, carried: bool = False) -> int:
        """Add an item.

        Parameters
        ----------
        pieces : sequence of Piece
            The convex pieces of the item where it is, in box units.
        mass : float
            Mass in kg, uniform over the pieces; 0 for an item that is fixed.
        carried : bool
            Whether an arm carries it, which takes PyBullet's other, slower kind of body. It rests
            on others a little differently.

        Returns
        -------
        int
            The number of the item.
        """
        properties = MassProperties.of(pieces)
        own = [((p.vertices - properties.center) @ properties.axes, p.faces) for p in pieces]
        path = self._folder / f"{len(self._items)}.obj"
        with naming(path):
            path.write_text(obj(own, 1.0))
        with quiet():
            shape = self._pybullet.createCollisionShape(
                self._pybullet.GEOM_MESH, fileName=str(path), physicsClientId=self._client
            )
        pose = Motion(properties.axes, properties.center)
        number = self._create_body(shape, mass, pose, maximal=not carried)
        if mass:
            self._pybullet.changeDynamics(
                number,
                -1,
                mass=mass,  # else it becomes 0
                localInertiaDiagonal=(properties.moments * mass * UNIT**2).tolist(),
                physicsClientId=self._client,
            )
        if carried:
            self._pybullet.changeDynamics(
                number,
                -1,
                maxJointVelocity=FAST,
                linearDamping=0.0,
                angularDamping=0.0,
                physicsClientId=self._client,
            )
        reach = max(float(np.linalg.norm(vertices, axis=1).max()) for vertices, _ in own)
        self._items.append(_SimulatedItem(number, mass, properties, reach))
        return len(self._items) - 1

    def ignore(self, one: int, other: int) -> None:
        """Disable collisions between two items."""
        numbers = (self._items[n].number for n in (one, other))
        self._pybullet.setCollisionFilterPair(*numbers, -1, -1, 0, physicsClientId=self._client)

    def step(self) -> None:
        """Advance by one time step."""
        self._pybullet.stepSimulation(physicsClientId=self._client)

    def run(self) -> tuple[float, bool]:
        """Advance until all items are at rest, or the time limit of the settings is over.

        Returns
        -------
        seconds : float
            The simulated time.
        at_rest : bool
            Whether all items are at rest.
        """
        settings = self._settings
        rested = seconds = 0.0
        interval = _CHECK_STEPS * settings.step
        while rested < settings.rest_time and seconds < settings.time_limit:
            for _ in range(_CHECK_STEPS):
                self.step()
            seconds += interval
            rested = rested + interval if (self.speeds < settings.rest_speed).all() else 0.0
        return seconds, rested >= settings.rest_time

    @property
    def speeds(self) -> Floats:
        """Upper bound of the speed of each item's points: (n,) in m/s."""
        found = []
        for item in self._items:
            linear, angular = (np.linalg.norm(v) for v in self._velocity(item))
            found.append(float(linear + angular * item.reach * UNIT) / self._scale)
        return np.array(found)

    @property
    def moves(self) -> list[Motion]:
        """Motion of each item since it was added, in box units."""
        return [self._move(item, self._box_from_axes(item)) for item in self._items]

    @property
    def contacts(self) -> set[tuple[int, int | str]]:
        """Pairs in contact: two items, the lower number first, or an item and a wall."""
        names: dict[int, int | str] = {item.number: n for n, item in enumerate(self._items)}
        names |= dict(zip(self._walls, WALLS_AND_FLOOR, strict=True))
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
        """Kinetic and potential energy of the items that can move, in J."""
        total = 0.0
        for item in self._items:
            box_from_axes = self._box_from_axes(item)
            linear, angular = (np.array(v) for v in self._velocity(item))
            spin = item.properties.moments * UNIT**2 @ (box_from_axes.rotation.T @ angular) ** 2
            height = box_from_axes.translation[2] * self._settings.side
            total += item.mass * (
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
        """Create the bodies of `WALLS_AND_FLOOR` and return their numbers, in order."""
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
                walls.append(self._create_body(shape, 0.0, Motion.shift(center)))
        ground = self._pybullet.createCollisionShape(
            self._pybullet.GEOM_PLANE, physicsClientId=self._client
        )
        return [*walls, self._create_body(ground, 0.0, IDENTITY)]

    def _create_body(self, shape: int, mass: float, pose: Motion, *, maximal: bool = True) -> int:
        number: int = self._pybullet.createMultiBody(
            baseMass=mass,
            baseCollisionShapeIndex=shape,
            basePosition=(pose.translation * UNIT).tolist(),
            baseOrientation=pose.xyzw,
            useMaximalCoordinates=int(maximal),
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

    def _move(self, item: _SimulatedItem, box_from_axes: Motion) -> Motion:
        """Compute the motion of an item since it was added from where its axes are."""
        turned = Motion(box_from_axes.rotation @ item.properties.axes.T)
        return turned.at(box_from_axes.translation - turned.direction(item.properties.center))

    def _box_from_axes(self, item: _SimulatedItem) -> Motion:
        """Look up the pose of the centre of mass and the principal axes, in box units."""
        position, xyzw = self._pybullet.getBasePositionAndOrientation(
            item.number, physicsClientId=self._client
        )
        return Motion.from_xyzw(xyzw, np.array(position) / UNIT)

    def _velocity(self, item: _SimulatedItem) -> tuple[Sequence[float], Sequence[float]]:
        """Look up the linear and the angular velocity, the latter in radians per second."""
        found: tuple[Sequence[float], Sequence[float]] = self._pybullet.getBaseVelocity(
            item.number, physicsClientId=self._client
        )
        return found


def require_engine() -> None:
    """Raise MissingPackageError if PyBullet is missing; call it before long work."""
    pybullet_module()


@functools.cache
def pybullet_module() -> Any:
    """Import PyBullet, which takes a tenth of a second and prints its build time."""
    with quiet(), needed_for("physics simulations"):
        import pybullet
    return pybullet


def _disconnect(client: int) -> None:
    with quiet():
        pybullet_module().disconnect(physicsClientId=client)
