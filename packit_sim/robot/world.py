"""A world in which an arm moves, and holds an item by a constraint that can break."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from packit_sim.core.files import naming
from packit_sim.core.silence import quiet
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.bullet_meshes import UNIT
from packit_sim.geometry.motions import Motion
from packit_sim.physics.convex.pieces import Piece
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.world import FAST, World
from packit_sim.robot.arm import Arm
from packit_sim.robot.urdf import with_cup

_STIFF = 1e9
"""Largest force of the arm's motors, in the world's unit: the arm is stronger than any load."""


class ArmWorld(World):
    """A world with the walls of a box, items, and an arm.

    Parameters
    ----------
    size : ndarray of float64, shape (3,)
        Extents of the box, in box units.
    radius : float
        Radius of the cup, m.
    """

    def __init__(self, size: Floats, settings: PhysicsSettings, arm: Arm, radius: float) -> None:
        super().__init__(size, settings)
        path = self._folder / "arm.urdf"
        with naming(path):
            path.write_text(with_cup(arm.urdf, radius))
        with quiet():
            self._arm = self._pybullet.loadURDF(
                str(path),
                basePosition=(arm.base.translation * self._scale).tolist(),
                useFixedBase=1,
                globalScaling=self._scale,
                flags=self._pybullet.URDF_USE_INERTIA_FROM_FILE,  # else 0 for links without shapes
                physicsClientId=self._client,
            )
        count = self._pybullet.getNumJoints(self._arm, physicsClientId=self._client)
        kinds = [self._kind(n) for n in range(count)]
        self._joints = [n for n, kind in enumerate(kinds) if kind != self._pybullet.JOINT_FIXED]
        self._tool = count - 1
        is_straight = np.array([kinds[n] == self._pybullet.JOINT_PRISMATIC for n in self._joints])
        self._units = np.where(is_straight, self._scale, 1.0)
        self._links = range(-1, count)
        self.collide_arm(False)
        for link in self._links:
            self._pybullet.changeDynamics(
                self._arm,
                link,
                maxJointVelocity=FAST,
                jointDamping=0.0,
                linearDamping=0.0,
                angularDamping=0.0,
                lateralFriction=math.sqrt(settings.friction),
                physicsClientId=self._client,
            )
        self._grip: int | None = None
        self._fixture: int | None = None
        self._sleeping: frozenset[int] = frozenset()

    def start_at(self, joints: Floats) -> None:
        """Put the arm somewhere, at rest."""
        for n, value in zip(self._joints, (joints * self._units).tolist(), strict=True):
            self._pybullet.resetJointState(self._arm, n, value, 0.0, physicsClientId=self._client)

    def drive(self, joints: Floats) -> None:
        """Drive the arm to joints in m and radians, within one time step."""
        speeds = (joints - self.joints) / self._settings.step * self._units
        self._pybullet.setJointMotorControlArray(
            self._arm,
            self._joints,
            self._pybullet.VELOCITY_CONTROL,
            targetVelocities=speeds.tolist(),
            forces=[_STIFF] * len(self._joints),
            physicsClientId=self._client,
        )
        self.step()

    @property
    def joints(self) -> Floats:
        """Positions of the joints, in m and radians."""
        states = self._pybullet.getJointStates(
            self._arm, self._joints, physicsClientId=self._client
        )
        return np.array([state[0] for state in states]) / self._units

    def present(self, pieces: Sequence[Piece], mass: float) -> int:
        """Add an item that stays where it is, and collides with nothing, until it is gripped."""
        item = self.add(pieces, mass, carried=True)
        self.collide(item, False)
        self._fix(item)
        return item

    def collide(self, item: int, enabled: bool) -> None:
        """Let an item collide with everything, or with nothing."""
        group = 1 if enabled else 0
        everything = -1 if enabled else 0
        self._pybullet.setCollisionFilterGroupMask(
            self._items[item].number, -1, group, everything, physicsClientId=self._client
        )

    def collide_arm(self, enabled: bool) -> None:
        """Let the arm and its cup collide with everything, or with nothing."""
        for link in self._links:
            self._pybullet.setCollisionFilterGroupMask(
                self._arm,
                link,
                int(enabled),
                -1 if enabled else 0,
                physicsClientId=self._client,
            )

    def sleep(self, items: Sequence[int], enabled: bool) -> None:
        """Let items at rest sleep until something touches them, or keep them awake."""
        state = (
            self._pybullet.ACTIVATION_STATE_SLEEP
            if enabled
            else self._pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        )
        for item in items:
            self._pybullet.changeDynamics(
                self._items[item].number, -1, activationState=state, physicsClientId=self._client
            )
        self._sleeping = self._sleeping | {*items} if enabled else self._sleeping - {*items}

    def grip(self, item: int) -> None:
        """Attach an item to the tool where both are, and open the fixture."""
        body = self._items[item].number
        state = self._pybullet.getLinkState(
            self._arm, self._tool, computeForwardKinematics=1, physicsClientId=self._client
        )
        world_from_tool = Motion.from_xyzw(state[5], np.array(state[4]))
        position, xyzw = self._pybullet.getBasePositionAndOrientation(
            body, physicsClientId=self._client
        )
        world_from_item = Motion.from_xyzw(xyzw, np.array(position))
        self._grip = self._constraint(
            body, self._tool, world_from_item.seen_from(world_from_tool), self._arm
        )
        self.release()

    def let_go(self, item: int) -> None:
        """Detach the item, which stays where it is until it is released."""
        self._fix(item)
        self._remove(self._grip)
        self._grip = None

    def release(self) -> None:
        """Let the item move that stayed where it was."""
        self._remove(self._fixture)
        self._fixture = None

    @property
    def load(self) -> tuple[float, float]:
        """The force in N, and the moment in N m, with which the held item pulls at the cup."""
        state = self._pybullet.getConstraintState(self._grip, physicsClientId=self._client)
        force = math.hypot(*state[:3]) / self._scale
        return force, math.hypot(*state[3:6]) / self._scale**2

    @property
    def awake(self) -> list[int]:
        """The items that do not sleep."""
        return [n for n in range(len(self._items)) if n not in self._sleeping]

    def poses(self, items: Sequence[int]) -> Floats:
        """Look up poses of bodies, (n, 7): position in box units and quaternion x, y, z, w."""
        found = np.empty((len(items), 7))
        for row, item in enumerate(items):
            found[row, :3], found[row, 3:] = self._pybullet.getBasePositionAndOrientation(
                self._items[item].number, physicsClientId=self._client
            )
        found[:, :3] /= UNIT
        return found

    def axes_from(self, item: int, pose: Motion) -> Motion:
        """Return the motion from a frame to that of `poses`, of an item added at a pose of it."""
        properties = self._items[item].properties
        box_from_axes = Motion(properties.axes, properties.center)
        return pose.seen_from(box_from_axes)

    def _fix(self, item: int) -> None:
        body = self._items[item].number
        position, xyzw = self._pybullet.getBasePositionAndOrientation(
            body, physicsClientId=self._client
        )
        self._fixture = self._constraint(body, -1, Motion.from_xyzw(xyzw, np.array(position)))

    def _constraint(self, body: int, link: int, where: Motion, arm: int | None = None) -> int:
        """Fix a body to a link, or to the world: where it is in the link's frame."""
        parent, child = (body, -1) if arm is None else (arm, body)
        frames, turns = [np.zeros(3), where.translation], [(0.0, 0.0, 0.0, 1.0), where.xyzw]
        if arm is not None:
            frames, turns = frames[::-1], turns[::-1]
        number: int = self._pybullet.createConstraint(
            parent,
            -1 if arm is None else link,
            child,
            -1,
            self._pybullet.JOINT_FIXED,
            [0, 0, 0],
            *(frame.tolist() for frame in frames),
            *turns,
            physicsClientId=self._client,
        )
        self._pybullet.changeConstraint(number, maxForce=_STIFF, physicsClientId=self._client)
        return number

    def _remove(self, constraint: int | None) -> None:
        assert constraint is not None
        self._pybullet.removeConstraint(constraint, physicsClientId=self._client)

    def _kind(self, number: int) -> int:
        info = self._pybullet.getJointInfo(self._arm, number, physicsClientId=self._client)
        kind: int = info[2]
        return kind
