"""Other robots fly with the same services: camera pitched back, smaller tags, three anchors; or heavier than usual."""

from functools import partial
from math import hypot, radians

import pytest

from jezero.base.vehicle_config import (
    AirframeConfig,
    BatteryConfig,
    CameraMountConfig,
    PlatformConfig,
    UwbLayoutConfig,
    VehicleConfig,
    VehicleLimitsConfig,
)
from jezero.schemas import topics
from jezero.schemas.commands import Hover
from jezero.schemas.goals import LandOnSpotGoal
from jezero.trials.platform import off_platform_reason, on_platform_m
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight, go_to

OTHER = VehicleConfig(
    camera=CameraMountConfig(pos_camera_frd_m=(0.08, 0.0, 0.04), pitch_offset_rad=radians(-15.0)),
    uwb=UwbLayoutConfig(
        pos_tag_frd_m=(-0.1, 0.0, 0.03), pos_anchors_rover_body_m=((0.4, 0.0, 0.0), (-0.4, 0.4, 0.0), (-0.4, -0.4, 0.0))
    ),
    platform=PlatformConfig(side_tag_m=0.45),
)
TURNED = VehicleConfig(
    camera=CameraMountConfig(
        pitch_offset_rad=radians(8.0),
        roll_offset_rad=radians(-10.0),
        turn_rad=radians(30.0),
        distortion=(-0.2, 0.06, 0.001, -0.002, 0.0),
    )
)
HEAVY = VehicleConfig(
    airframe=AirframeConfig(
        mass_kg=2.4,
        inertia_frd_kgm2=(0.06, 0.06, 0.11),
        pos_rotors_frd_m=((0.2, 0.3), (-0.2, -0.22), (0.2, -0.3), (-0.2, 0.22)),
    ),
    battery=BatteryConfig(cells=6),
    limits=VehicleLimitsConfig(altitude_max_m=5.0),
)


@pytest.mark.long
@pytest.mark.parametrize(
    ("vehicle", "use_uwb", "use_tag"),
    [
        pytest.param(OTHER, True, True, marks=pytest.mark.slow),
        (OTHER, False, True),
        (OTHER, True, False),
        (TURNED, False, True),
    ],
    ids=["uwb+tag", "tag", "uwb", "a turned camera with a distorting lens"],
)
def test_it_lands_on_the_rover(vehicle: VehicleConfig, use_uwb: bool, use_tag: bool) -> None:
    flight = Flight(2, partial(build_stack, vehicle=vehicle))
    flight.take_off(4.0)
    spot_ned_m = None if use_uwb else flight.truth.pos_rover_ned_m
    flight.do(topics.LAND_ON_SPOT, LandOnSpotGoal(use_uwb=use_uwb, use_tag=use_tag, landing_spot_ned_m=spot_ned_m))
    truth = flight.truth
    forward_m, right_m, _ = on_platform_m(truth)
    assert hypot(forward_m, right_m) < 0.15
    assert off_platform_reason(truth, 0.5 * vehicle.platform.side_m) == ""
    assert not flight.status.armed


def test_a_heavier_one_with_another_battery_flies_within_its_own_limits() -> None:
    flight = Flight(2, partial(build_stack, vehicle=HEAVY))
    flight.take_off(4.0)
    flight.bus.run_for(3.0)
    assert flight.truths[0].pos_uav_ned_m[2] - flight.truth.pos_uav_ned_m[2] == pytest.approx(4.0, abs=1.0)
    assert flight.status.battery is not None
    assert flight.status.battery.voltage_v == pytest.approx(6 * 4.0, abs=1.0)
    assert "limit of 5 m" in flight.refusal(topics.GO_TO, go_to(0.0, 0.0, -6.0))
    assert "limit of 5 m" in flight.request(topics.HOVER, Hover(hover_pos=(0.0, 0.0, -6.0))).reason
    flight.do(topics.GO_TO, go_to(3.0, 0.0, -3.0))
    north_m, east_m, _ = flight.truth.pos_uav_ned_m
    assert hypot(north_m - 3.0, east_m) < 1.5
