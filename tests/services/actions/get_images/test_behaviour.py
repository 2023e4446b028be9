"""The orbit's geometry, what is refused, and one turn of a point mass."""

from itertools import pairwise
from math import atan2, degrees, hypot, pi, radians

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from jezero.base.frames import Vec3, frd_from_camera, quat_from_euler, quat_rotate, subtract, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import GetImagesGoal, ImagesFeedback
from jezero.schemas.topics import GET_IMAGES
from jezero.services.actions.get_images.behaviour import Orbit, aim, facing, nearest_phase
from jezero.services.actions.motion.behaviour import Done, Move, Preparation, VehicleState
from jezero.services.actions.motion.straight_path import TimedStraightPath
from tests.services.actions.fake_bridge import follow
from tests.services.actions.test_behaviours import hovering, plan_of, refusal_of

DT_S = 0.01
GOAL = GetImagesGoal(center_ned_m=(-2.0, 0.0, -4.0), radius_m=2.0, num_images=4)


def with_fields(**fields: object) -> GetImagesGoal:
    return GetImagesGoal(**{**{name: getattr(GOAL, name) for name in GOAL.__struct_fields__}, **fields})


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"num_images": 0}, "num_images 0 is not within 1 to 255"),
        ({"num_images": 256}, "num_images 256 is not within 1 to 255"),
        ({"radius_m": 0.0}, "radius 0 m is too small"),
        ({"radius_m": -1.0}, "radius -1 m is too small"),
        ({"radius_m": 600.0}, "beyond the limit of 500 m"),
        ({"center_ned_m": (0.0, 0.0, 4.0)}, "the center's z = 4 m is not above the ground: NED counts down"),
        ({"center_ned_m": (0.0, 0.0, 0.0)}, "5 m up is −5"),
        ({"center_ned_m": (0.0, 0.0, -200.0)}, "altitude 200 m is beyond the limit of 120 m"),
        ({"center_ned_m": (499.0, 0.0, -4.0)}, "the target is 501 m from the origin"),
        ({"target_z_ned_m": -6.0}, "the target at z = -6 m is above the flight at -4 m"),
        ({"speed_mps": 0.0}, "speed 0 m/s is not within"),
        ({"speed_mps": 30.0}, "speed 30 m/s is not within"),
    ],
)
def test_what_nobody_could_fly_is_refused_with_what_to_do(fields: dict[str, object], reason: str) -> None:
    assert reason in refusal_of(GET_IMAGES, with_fields(**fields))


def test_a_speed_that_the_circle_or_the_camera_does_not_allow_is_lowered_and_said() -> None:
    tight = plan_of(GET_IMAGES, with_fields(radius_m=0.5, speed_mps=3.0))
    many = plan_of(GET_IMAGES, with_fields(num_images=255, speed_mps=3.0))
    assert tight.warning.startswith("flown at 0.87 m/s instead of 3 m/s")
    assert many.warning.startswith("flown at 0.37 m/s instead of 3 m/s")
    assert plan_of(GET_IMAGES, with_fields(speed_mps=1.0)).warning == ""


@given(time_s=st.floats(0.01, 14.5), phase_rad=st.floats(-pi, pi))
def test_velocity_and_acceleration_are_the_derivatives(time_s: float, phase_rad: float) -> None:
    step_s = 1e-4
    for path in (
        Orbit((1.0, 2.0, -4.0), 2.0, phase_rad, 1.0, 0.5),
        TimedStraightPath((0.0, 0.0, -1.0), (3.0, -5.0, -2.0), 1.0, 0.5),
    ):
        a, b, c = (path.at(time_s + k * step_s) for k in (-1, 0, 1))
        ramps = (path.profile.top_mps / 0.5, path.profile.duration_s - path.profile.top_mps / 0.5)
        if any(abs(time_s - t) < 3 * step_s for t in (0.0, *ramps, path.profile.duration_s)):
            continue
        for axis in range(3):
            speed_mps = (c.pos_ned_m[axis] - a.pos_ned_m[axis]) / (2 * step_s)
            acceleration_mps2 = (c.vel_ned_mps[axis] - a.vel_ned_mps[axis]) / (2 * step_s)
            assert speed_mps == pytest.approx(b.vel_ned_mps[axis], abs=1e-5)
            assert acceleration_mps2 == pytest.approx(b.acc_ned_mps2[axis], abs=1e-5)


def test_an_orbit_keeps_its_radius_and_height_and_turns_clockwise() -> None:
    orbit = Orbit((1.0, 2.0, -4.0), 2.0, 0.0, 1.0, 0.5)
    quarter = orbit.at(orbit.profile.duration_s / 2.0)
    assert orbit.at(0.0).pos_ned_m == pytest.approx((3.0, 2.0, -4.0))
    assert quarter.pos_ned_m == pytest.approx((-1.0, 2.0, -4.0))
    assert quarter.vel_ned_mps == pytest.approx((0.0, -1.0, 0.0), abs=1e-9)
    assert quarter.acc_ned_mps2 == pytest.approx((0.5, 0.0, 0.0), abs=1e-9)


def test_the_nearest_point_is_on_the_vehicles_side() -> None:
    assert nearest_phase((0.0, 0.0, -4.0), (0.0, 5.0, -2.0), 0.0) == pytest.approx(0.5 * pi)
    assert abs(nearest_phase((0.0, 0.0, -4.0), (0.0, 0.0, -2.0), 0.0)) == pytest.approx(pi)


def test_the_heading_turns_as_fast_as_the_vehicle_goes_around() -> None:
    yaw_rad, rate_rps = facing((2.0, 0.0, -4.0), (0.0, 1.0, 0.0), (0.0, 0.0, -4.0))
    assert abs(yaw_rad) == pytest.approx(pi)
    assert rate_rps == pytest.approx(0.5)


@given(
    roll_deg=st.floats(-15.0, 15.0),
    pitch_deg=st.floats(-15.0, 15.0),
    yaw_deg=st.floats(-180.0, 180.0),
    ahead_m=st.floats(1.5, 5.0),
)
def test_what_the_camera_is_aimed_at_is_in_the_middle(
    roll_deg: float, pitch_deg: float, yaw_deg: float, ahead_m: float
) -> None:
    q = quat_from_euler(radians(roll_deg), radians(pitch_deg), radians(yaw_deg))
    way_ned_m = quat_rotate(quat_from_euler(0.0, 0.0, radians(yaw_deg + 3.0)), (ahead_m, 0.0, 4.0))
    axes_rad = aim(q, way_ned_m, 0.6)
    right, down, forward = (
        quat_rotate(q, frd_from_camera(axis, *axes_rad)) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    )
    assert sum(a * b for a, b in zip(right, way_ned_m, strict=True)) == pytest.approx(0.0, abs=1e-9)
    assert sum(a * b for a, b in zip(down, way_ned_m, strict=True)) == pytest.approx(0.0, abs=1e-9)
    assert sum(a * b for a, b in zip(forward, way_ned_m, strict=True)) > 0.0


def test_the_cameras_axes_are_asked_for_no_more_than_they_can() -> None:
    pitch_rad, roll_rad = aim((1.0, 0.0, 0.0, 0.0), (1.0, -5.0, 0.1), 0.6)
    assert roll_rad == pytest.approx(0.6)
    assert -0.5 * pi <= pitch_rad <= 0.0
    assert aim((1.0, 0.0, 0.0, 0.0), (-3.0, 0.0, 1.0), 0.6)[0] == pytest.approx(-0.5 * pi)


class Turn:
    """Flies one goal with a point mass that turns to each heading setpoint at once."""

    def __init__(
        self, goal: GetImagesGoal, pos_ned_m: Vec3 = (1.0, 1.0, -3.0), relative: Relative | None = None
    ) -> None:
        self.state = replace(hovering(pos_ned_m), relative=relative)
        self.goal = goal
        self.t_ns = 5_000_000_000
        self.moves: list[tuple[VehicleState, Move]] = []
        self.passed: list[VehicleState] = []
        plan = plan_of(GET_IMAGES, goal)
        assert not isinstance(plan.start, Preparation)
        self.capture = plan.capture
        self.behaviour = plan.start(self.t_ns, self.state)

    def run(self, within_s: float = 60.0) -> Done | None:
        capture = self.capture
        assert capture is not None
        for _ in range(int(within_s / DT_S)):
            self.t_ns += int(DT_S * 1e9)
            move = self.behaviour.step(self.t_ns, self.state)
            while capture.is_waiting:
                capture._requested.popleft()
                self.passed.append(self.state)
            if isinstance(move, Done):
                return move
            self.moves.append((self.state, move))
            pos, vel = follow(
                self.state.pos_uav_ned_m, self.state.vel_uav_ned_mps, move.pos_ned_m, move.vel_ned_mps, DT_S
            )
            assert move.yaw_rad is not None
            q_ned_from_frd = quat_from_euler(0.0, 0.0, move.yaw_rad)
            self.state = replace(self.state, pos_uav_ned_m=pos, vel_uav_ned_mps=vel, q_ned_from_frd=q_ned_from_frd)
        return None


def test_pictures_are_asked_for_evenly_around_the_centre_facing_it() -> None:
    turn = Turn(GOAL)
    done = turn.run()
    assert done is not None and done.outcome == "succeeded"
    angles = []
    for state in turn.passed:
        north_m, east_m, _ = subtract(state.pos_uav_ned_m, GOAL.center_ned_m)
        angles.append(degrees(atan2(east_m, north_m)))
        assert hypot(north_m, east_m) == pytest.approx(2.0, abs=0.1)
        assert degrees(wrap_pi(state.yaw_rad - atan2(-east_m, -north_m))) == pytest.approx(0.0, abs=2.0)
    steps = [(b - a) % 360.0 for a, b in pairwise(angles)]
    assert steps == pytest.approx([90.0, 90.0, 90.0], abs=2.5)
    assert {move.phase for _, move in turn.moves} == {Phase.GET_IMAGES}
    assert done.hover_pos_ned_m == pytest.approx(turn.state.pos_uav_ned_m, abs=0.2)


def test_one_picture_needs_no_turn() -> None:
    turn = Turn(with_fields(num_images=1))
    done = turn.run(15.0)
    assert done is not None and done.outcome == "succeeded"
    assert len(turn.passed) == 1


def test_in_the_rovers_frame_the_circle_moves_with_the_rover_and_ends_with_the_estimate() -> None:
    relative = Relative(
        t_ns=0,
        epoch_id=1,
        valid=True,
        pos_uav_rel_rover_ned_m=(1.0, 1.0, -3.0),
        vel_uav_rel_rover_ned_mps=(-0.5, 0.0, 0.0),
        vel_rover_ned_mps=(0.5, 0.0, 0.0),
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.1,
        use_uwb=True,
        use_tag=True,
        cov=(0.0,) * 21,
    )
    goal = with_fields(frame="rover", center_ned_m=(0.0, 0.0, -4.0))
    turn = Turn(goal, relative=relative)
    move = turn.behaviour.step(turn.t_ns, turn.state)
    assert isinstance(move, Move) and move.vel_ned_mps is not None and move.acc_ned_mps2 is not None
    still = Turn(goal, relative=msgspec.structs.replace(relative, vel_rover_ned_mps=(0.0, 0.0, 0.0)))
    other = still.behaviour.step(still.t_ns, still.state)
    assert isinstance(other, Move) and other.vel_ned_mps is not None and other.acc_ned_mps2 is not None
    assert isinstance(move.feedback, ImagesFeedback)
    assert move.vel_ned_mps[0] - other.vel_ned_mps[0] == pytest.approx(0.5)
    assert move.acc_ned_mps2[1] - other.acc_ned_mps2[1] == pytest.approx(0.05)
    assert move.feedback.frame == "rover"
    assert move.feedback.pos_uav_ned_m == (1.0, 1.0, -3.0)
    lost = turn.behaviour.step(turn.t_ns, replace(turn.state, relative=None))
    assert isinstance(lost, Done) and "the estimator is silent" in lost.reason
