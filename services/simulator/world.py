"""Rigid bodies and contact: the only module that uses PyBullet, its ENU/FLU axes and its quaternion order.

All arguments and results are in the map's NED and the body's FRD.
"""

import weakref
from collections.abc import Sequence
from itertools import product
from math import cos, sin, sqrt

import numpy as np

from jezero.base.arrays import Array
from jezero.base.config import ConfigError
from jezero.base.frames import (
    Quat,
    Vec3,
    enu_from_ned,
    ned_from_enu,
    q_enu_from_flu,
    q_ned_from_frd,
    quat_conjugate,
    quat_rotate,
    scale,
)
from jezero.base.vehicle_config import PLATFORM_THICKNESS_M, AirframeConfig, PlatformConfig, VehicleConfig
from jezero.services.simulator.body import BodyState, RoverState
from jezero.services.simulator.config import SimulatorConfig, UavConfig
from jezero.services.simulator.obstacles import StandingObstacle
from jezero.services.simulator.quiet_pybullet import pybullet
from jezero.services.simulator.rover import WHEEL_FORWARD_M, WHEEL_RADIUS_PER_HEIGHT, WHEEL_SIDE_M, WHEEL_WIDTH_M
from jezero.services.simulator.schedule import DT_S, STEPS_PER_S
from jezero.services.simulator.terrain import HALF_SIDE_M, POINTS, SPACING_M, Terrain

RADIUS_FOOT_M = 0.06
SETTLE_STEPS = 500
ROTOR_PLANE_HALF_HEIGHT_M = 0.01
HEIGHT_ROTOR_PLANE_M = 0.03
APRON_HALF_WIDTH_M = 2000.0
FLOOR_HALF_M = 5.0
CLEAR_OF_OBSTACLES_M = 0.05


class World:
    """One vehicle, the ground and the rover's platform.

    Args:
        rover: state of the rover at the start.
        obstacles: what stands in the terrain.

    Raises:
        ConfigError: the vehicle starts in an obstacle.

    Attributes:
        state: state after the last step.
        start_ned_m: centre of mass of the vehicle at its start.
        height_stand_m: height of the centre of mass there over the ground or the platform.
    """

    def __init__(
        self,
        config: SimulatorConfig,
        vehicle: VehicleConfig,
        terrain: Terrain,
        rover: RoverState,
        obstacles: Sequence[StandingObstacle] = (),
    ) -> None:
        self._has_water = config.terrain.water_depth_m > 0.0
        self._gravity_mps2 = vehicle.planet.gravity_mps2
        self._client = int(pybullet.connect(pybullet.DIRECT))
        self._disconnect = weakref.finalize(self, pybullet.disconnect, physicsClientId=self._client)
        pybullet.setTimeStep(DT_S, physicsClientId=self._client)
        pybullet.setGravity(0.0, 0.0, -self._gravity_mps2, physicsClientId=self._client)
        self._add_ground(terrain, config.terrain.friction)
        self.state = BodyState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        self._rover_id = self._add_rover(vehicle.platform, config.rover.friction_platform, rover)
        self._uav_id = self._add_uav(config.uav, vehicle.airframe)
        bodies = {self._add_triangles(each.corners_ned_m, config.terrain.friction): each for each in obstacles}
        self._settle(config.uav, vehicle.airframe, terrain, rover)
        for body, each in bodies.items():
            touches = pybullet.getClosestPoints(self._uav_id, body, CLEAR_OF_OBSTACLES_M, physicsClientId=self._client)
            if touches or each.holds(self.start_ned_m):
                raise ConfigError(f"{each.name} in simulator.toml is where the vehicle starts: move it a metre away")

    def close(self) -> None:
        """Free the physics engine; happens by itself when the world is no longer used."""
        self._disconnect()

    # -- every step --

    def step(self, force_ned_n: Vec3, torque_frd_nm: Vec3) -> BodyState:
        """Advance by 4 ms under a force and a torque on the vehicle's centre of mass."""
        before = self.state
        pos_enu_m = enu_from_ned(before.pos_ned_m)
        torque_enu_nm = enu_from_ned(quat_rotate(before.q_ned_from_frd, torque_frd_nm))
        client, uav = self._client, self._uav_id
        pybullet.applyExternalForce(uav, -1, enu_from_ned(force_ned_n), pos_enu_m, pybullet.WORLD_FRAME, client)
        pybullet.applyExternalTorque(uav, -1, torque_enu_nm, pybullet.WORLD_FRAME, client)
        pybullet.stepSimulation(client)
        self.state = self._read(before.vel_ned_mps)
        return self.state

    def range_m(self, mount_frd_m: Vec3, direction_frd: Vec3, range_max_m: float) -> float | None:
        """Distance from a point on the vehicle along a direction to the nearest surface, None beyond the maximum.

        Water reflects the beam as ground does. The vehicle's own hull, rotors and feet stop a beam too: a beam starts
        outside the hull.

        Args:
            mount_frd_m: start of the beam, from the vehicle's centre of mass.
            direction_frd: unit vector; (0, 0, 1) is the body's down axis, (1, 0, 0) its forward axis.
            range_max_m: length of the beam.
        """
        pos_ned_m, q = self.state.pos_ned_m, self.state.q_ned_from_frd
        mount_ned_m = quat_rotate(q, mount_frd_m)
        beam_ned_m = quat_rotate(q, scale(direction_frd, range_max_m))
        x, y, z = (p + m for p, m in zip(pos_ned_m, mount_ned_m, strict=True))
        start_enu_m = enu_from_ned((x, y, z))
        end_enu_m = enu_from_ned((x + beam_ned_m[0], y + beam_ned_m[1], z + beam_ned_m[2]))
        hit = pybullet.rayTest(start_enu_m, end_enu_m, physicsClientId=self._client)[0]
        share = 1.0 if hit[0] < 0 else float(hit[2])
        if self._has_water and z < 0.0 < z + beam_ned_m[2]:
            share = min(share, -z / beam_ned_m[2])  # the water's level is the map's 0
        return None if share == 1.0 else share * range_max_m

    def contact_force_n(self) -> float:
        """Sum of the normal forces on the vehicle in the last step."""
        contacts = pybullet.getContactPoints(bodyA=self._uav_id, physicsClientId=self._client)
        return float(sum(contact[9] for contact in contacts))

    def respawn(self) -> None:
        """Put the vehicle back to its start, at rest."""
        pybullet.resetBasePositionAndOrientation(self._uav_id, *self._start_pose, physicsClientId=self._client)
        pybullet.resetBaseVelocity(self._uav_id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), physicsClientId=self._client)
        self.state = self._read((0.0, 0.0, -self._gravity_mps2 * DT_S))

    def move_rover(self, rover: RoverState) -> None:
        """Set the platform's pose and velocity; friction at this velocity carries a vehicle that stands on it along."""
        pybullet.resetBasePositionAndOrientation(self._rover_id, *_rover_pose(rover), physicsClientId=self._client)
        velocity_enu_mps = enu_from_ned(rover.vel_ned_mps)
        turn_enu_rps = enu_from_ned(rover.rates_ned_rps)
        pybullet.resetBaseVelocity(self._rover_id, velocity_enu_mps, turn_enu_rps, physicsClientId=self._client)

    def place_uav(self, pos_ned_m: Vec3, yaw_rad: float, vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """Put the vehicle to a position, level, not turning."""
        orientation = _orientation(yaw_rad)
        pybullet.resetBasePositionAndOrientation(self._uav_id, enu_from_ned(pos_ned_m), orientation, self._client)
        pybullet.resetBaseVelocity(self._uav_id, enu_from_ned(vel_ned_mps), (0.0, 0.0, 0.0), self._client)
        self.state = self._read(vel_ned_mps)

    def _read(self, vel_before_ned_mps: Vec3) -> BodyState:
        position, (qx, qy, qz, qw) = pybullet.getBasePositionAndOrientation(self._uav_id, self._client)
        velocity, rates = pybullet.getBaseVelocity(self._uav_id, self._client)
        q: Quat = q_ned_from_frd((qw, qx, qy, qz))
        inverse = quat_conjugate(q)
        vel_ned_mps = ned_from_enu(velocity)
        specific_ned_mps2 = (
            (vel_ned_mps[0] - vel_before_ned_mps[0]) * STEPS_PER_S,
            (vel_ned_mps[1] - vel_before_ned_mps[1]) * STEPS_PER_S,
            (vel_ned_mps[2] - vel_before_ned_mps[2]) * STEPS_PER_S - self._gravity_mps2,
        )
        return BodyState(
            ned_from_enu(position),
            vel_ned_mps,
            q,
            quat_rotate(inverse, ned_from_enu(rates)),
            quat_rotate(inverse, specific_ned_mps2),
        )

    # -- building --

    def _add_ground(self, terrain: Terrain, friction: float) -> None:
        """Height field, rocks, four slabs that continue the level edge outwards, and a floor that stops fast falls."""
        client = self._client
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_HEIGHTFIELD,
            meshScale=(SPACING_M, SPACING_M, 1.0),
            heightfieldData=np.ascontiguousarray(terrain.heights_m).ravel(),
            numHeightfieldRows=POINTS,
            numHeightfieldColumns=POINTS,
            physicsClientId=client,
        )
        middle_m = 0.5 * float(terrain.heights_m.min() + terrain.heights_m.max())
        self._add_fixed(shape, (0.0, 0.0, middle_m), friction)
        reach_m = APRON_HALF_WIDTH_M
        far_m = HALF_SIDE_M + reach_m
        long_slab = self._box((far_m + reach_m, reach_m, 1.0))
        short_slab = self._box((reach_m, HALF_SIDE_M, 1.0))
        for sign in (-1.0, 1.0):
            self._add_fixed(long_slab, (0.0, sign * far_m, -1.0), friction)
            self._add_fixed(short_slab, (sign * far_m, 0.0, -1.0), friction)
        floor = self._box((far_m + reach_m, far_m + reach_m, FLOOR_HALF_M))
        self._add_fixed(floor, (0.0, 0.0, float(terrain.heights_m.min()) - 0.2 - FLOOR_HALF_M), friction)
        if len(terrain.rock_faces):
            self._add_rocks(terrain, friction)

    def _add_rocks(self, terrain: Terrain, friction: float) -> None:
        """All rocks as one body: each further body, even a fixed one, costs 0.3 us per step."""
        self._add_triangles(terrain.rock_vertices_ned_m, friction, terrain.rock_faces.ravel().tolist())

    def _add_triangles(self, corners_ned_m: Array, friction: float, indices: list[int] | None = None) -> int:
        """A fixed body of triangles: three corners after the other, unless there are indices of corners."""
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=[enu_from_ned(tuple(corner)) for corner in corners_ned_m.tolist()],
            indices=indices or list(range(len(corners_ned_m))),
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=self._client,
        )
        return self._add_fixed(shape, (0.0, 0.0, 0.0), friction)

    def _box(self, half_m: Vec3) -> int:
        return int(pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half_m, physicsClientId=self._client))

    def _add_fixed(self, shape: int, pos_enu_m: Vec3, friction: float) -> int:
        body = int(pybullet.createMultiBody(0.0, shape, basePosition=pos_enu_m, physicsClientId=self._client))
        pybullet.changeDynamics(body, -1, lateralFriction=friction, physicsClientId=self._client)
        return body

    def _add_rover(self, platform: PlatformConfig, friction: float, rover: RoverState) -> int:
        """Platform slab, chassis and six wheels; the body's origin is on top of the platform."""
        half_m = 0.5 * platform.side_m
        top_m = platform.height_m
        radius_m = WHEEL_RADIUS_PER_HEIGHT * top_m
        places_m = (WHEEL_FORWARD_M, 0.0, -WHEEL_FORWARD_M), (WHEEL_SIDE_M, -WHEEL_SIDE_M)
        wheels_m = [(forward_m, side_m, radius_m - top_m) for forward_m, side_m in product(*places_m)]
        n = len(wheels_m)
        shape = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * 2 + [pybullet.GEOM_CYLINDER] * n,
            halfExtents=[
                (half_m, half_m, 0.5 * PLATFORM_THICKNESS_M),
                (0.42, 0.26, 0.22 * top_m),
                *[(0.0, 0.0, 0.0)] * n,
            ],
            radii=[0.0] * 2 + [radius_m] * n,
            lengths=[0.0] * 2 + [WHEEL_WIDTH_M] * n,
            collisionFramePositions=[(0.0, 0.0, -0.5 * PLATFORM_THICKNESS_M), (0.0, 0.0, -0.38 * top_m), *wheels_m],
            collisionFrameOrientations=[(0.0, 0.0, 0.0, 1.0)] * 2 + [(sqrt(0.5), 0.0, 0.0, sqrt(0.5))] * n,
            physicsClientId=self._client,
        )
        position, orientation = _rover_pose(rover)
        body = self._add_fixed(shape, position, friction)
        pybullet.resetBasePositionAndOrientation(body, position, orientation, physicsClientId=self._client)
        return body

    def _add_uav(self, uav: UavConfig, airframe: AirframeConfig) -> int:
        """Hull, a flat box for the arms and rotors, and four feet on springs."""
        forward_m, side_m = airframe.feet_frd_m
        down_m = airframe.height_stand_m + uav.sag_legs_m - RADIUS_FOOT_M
        rotor_plane_half_m = (*airframe.rotor_plane_half_frd_m, ROTOR_PLANE_HALF_HEIGHT_M)
        feet_m = [(a * forward_m, b * side_m, -down_m) for a in (1.0, -1.0) for b in (1.0, -1.0)]
        shape = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_SPHERE] * 4 + [pybullet.GEOM_BOX] * 2,
            radii=[RADIUS_FOOT_M] * 4 + [0.0] * 2,
            halfExtents=[(0.0, 0.0, 0.0)] * 4 + [airframe.hull_half_frd_m, rotor_plane_half_m],
            collisionFramePositions=[*feet_m, (0.0, 0.0, 0.0), (0.0, 0.0, HEIGHT_ROTOR_PLANE_M)],
            physicsClientId=self._client,
        )
        body = int(
            pybullet.createMultiBody(
                airframe.mass_kg, shape, basePosition=(0.0, 0.0, 10.0), physicsClientId=self._client
            )
        )
        pybullet.changeDynamics(
            body,
            -1,
            localInertiaDiagonal=airframe.inertia_frd_kgm2,
            linearDamping=0.0,
            angularDamping=0.0,
            lateralFriction=uav.friction_feet,
            contactStiffness=uav.stiffness_foot_npm,
            contactDamping=uav.damping_foot_nspm,
            physicsClientId=self._client,
        )
        return body

    def _settle(self, uav: UavConfig, airframe: AirframeConfig, terrain: Terrain, rover: RoverState) -> None:
        """Let the vehicle come to rest where it starts, and remember that pose."""
        if uav.start == "platform":
            north_m, east_m, down_m = rover.pos_ned_m
        else:
            north_m, east_m, down_m = 0.0, 0.0, -terrain.height_m(0.0, 0.0)
        above_m = airframe.height_stand_m + uav.sag_legs_m
        self.place_uav((north_m, east_m, down_m - above_m), uav.start_yaw_rad)
        for _ in range(SETTLE_STEPS):
            pybullet.stepSimulation(self._client)
        self._start_pose = pybullet.getBasePositionAndOrientation(self._uav_id, self._client)
        self.respawn()
        self.start_ned_m = self.state.pos_ned_m
        self.height_stand_m = down_m - self.start_ned_m[2]


def _orientation(yaw_rad: float) -> tuple[float, float, float, float]:
    """The engine's quaternion (x, y, z, w), FLU to ENU, of a level body with a heading."""
    half_rad = 0.5 * (0.5 * np.pi - yaw_rad)
    return (0.0, 0.0, sin(half_rad), cos(half_rad))


def _rover_pose(rover: RoverState) -> tuple[Vec3, tuple[float, float, float, float]]:
    w, x, y, z = q_enu_from_flu(rover.q_ned_from_rover_body)
    return enu_from_ned(rover.pos_ned_m), (x, y, z, w)
