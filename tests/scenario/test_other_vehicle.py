"""Another robot flies with the same services: camera pitched back, smaller tags, three anchors."""

from functools import partial
from math import hypot, radians

import pytest

from jezero.schemas import topics
from jezero.schemas.actions import LandOnSpotGoal
from jezero.trials.platform import off_platform_reason, on_platform_m
from jezero.trials.stack import build_stack
from jezero.vehicle_config import CameraMountConfig, PlatformConfig, UwbLayoutConfig, VehicleConfig
from tests.scenario.rig import Flight

OTHER = VehicleConfig(
    camera=CameraMountConfig(pos_camera_frd_m=(0.08, 0.0, 0.04), pitch_offset_rad=radians(-15.0)),
    uwb=UwbLayoutConfig(
        pos_tag_frd_m=(-0.1, 0.0, 0.03), pos_anchors_rover_body_m=((0.4, 0.0, 0.0), (-0.4, 0.4, 0.0), (-0.4, -0.4, 0.0))
    ),
    platform=PlatformConfig(side_tag_m=0.45),
)


@pytest.mark.parametrize(("use_uwb", "use_tag"), [(True, True), (False, True), (True, False)])
def test_it_lands_on_the_rover(use_uwb: bool, use_tag: bool) -> None:
    flight = Flight(2, partial(build_stack, vehicle=OTHER))
    flight.take_off(4.0)
    spot_ned_m = None if use_uwb else flight.truth.pos_rover_ned_m
    flight.do(topics.LAND_ON_SPOT, LandOnSpotGoal(use_uwb=use_uwb, use_tag=use_tag, landing_spot_ned_m=spot_ned_m))
    truth = flight.truth
    forward_m, right_m, _ = on_platform_m(truth)
    assert hypot(forward_m, right_m) < 0.15
    assert off_platform_reason(truth, 0.5 * OTHER.platform.side_m) == ""
    assert not flight.status.armed
