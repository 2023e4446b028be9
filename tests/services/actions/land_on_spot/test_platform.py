"""What holds a descent back over the platform, and which estimates a landing comes nearer by."""

import pytest

from jezero.base.frames import Vec3
from jezero.schemas.estimate import Relative
from jezero.services.actions.land_on_spot.config import RoverLandingConfig
from jezero.services.actions.land_on_spot.platform import Descent, PlatformState, PlatformTracking
from jezero.services.actions.motion.behaviour import VehicleState

S = 1_000_000_000
STILL: Vec3 = (0.0, 0.0, 0.0)
CONFIG = RoverLandingConfig(cone_m=0.01, cone_per_m=0.08, descent_min_mps=0.35, descent_max_mps=1.5, coast_s=0.5)


def over_platform(height_m: float, vel_mps: tuple[float, float] = (0.0, 0.0), std_m: float = 0.0) -> PlatformState:
    return PlatformState((0.0, 0.0, -height_m), (*vel_mps, 0.0), STILL, 0.0, std_m)


@pytest.mark.parametrize(
    ("vel_mps", "down_mps"),
    [
        ((0.49, 0.0), 1.2),
        ((0.0, -0.49), 1.2),
        ((0.51, 0.0), 0.0),
        ((0.0, 0.51), 0.0),
        ((0.0, -0.51), 0.0),
        ((0.35, 0.35), 1.2),
        ((0.36, -0.36), 0.0),
    ],
)
def test_it_descends_only_while_it_is_slower_than_half_a_metre_per_second_on_both_axes_together(
    vel_mps: tuple[float, float], down_mps: float
) -> None:
    """2 m up the cone is 0.17 m wide, and 0.51 m/s lead 0.153 m away in 0.3 s: the speed alone holds it back."""
    descent = Descent(CONFIG, room_m=0.4)
    assert descent.down_mps(S, over_platform(2.0, vel_mps)) == pytest.approx(down_mps)
    assert descent.may_begin(over_platform(2.0, vel_mps)) is (down_mps > 0.0)


@pytest.mark.parametrize(
    ("height_m", "std_m", "down_mps"),
    [(0.5, 0.174, 0.35), (0.5, 0.176, 0.0), (2.0, 0.39, 1.2), (2.0, 0.41, 0.0)],
)
def test_the_lower_it_is_the_better_an_estimate_it_descends_by(height_m: float, std_m: float, down_mps: float) -> None:
    """0.1 m + 0.15 of the height are permitted: 0.175 m and 0.4 m."""
    assert Descent(CONFIG, room_m=0.4).down_mps(S, over_platform(height_m, std_m=std_m)) == pytest.approx(down_mps)


@pytest.mark.parametrize(
    ("pos_m", "std_m", "age_s", "contradicted", "comes_nearer"),
    [
        ((3.0, 0.0), 1.19, 0.1, False, True),
        ((3.0, 0.0), 1.21, 0.1, False, False),
        ((0.0, -3.0), 1.19, 0.1, False, True),
        ((0.0, -3.0), 1.21, 0.1, False, False),
        ((3.0, 0.0), 0.5, 0.49, False, True),
        ((3.0, 0.0), 0.5, 0.51, False, False),
        ((3.0, 0.0), 0.5, 0.1, True, False),
    ],
)
def test_it_comes_nearer_by_an_invalid_estimate_only_if_that_is_good_for_its_distance_young_and_not_contradicted(
    pos_m: tuple[float, float], std_m: float, age_s: float, contradicted: bool, comes_nearer: bool
) -> None:
    t_ns = 100 * S
    relative = Relative(
        t_ns=t_ns,
        epoch_id=1,
        valid=False,
        reason="too uncertain",
        contradicted=contradicted,
        pos_uav_rel_rover_ned_m=(*pos_m, -4.0),
        vel_uav_rel_rover_ned_mps=STILL,
        cov=(std_m**2 / 2.0, *(0.0,) * 5, std_m**2 / 2.0, *(0.0,) * 14),
        vel_rover_ned_mps=STILL,
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.0,
        use_uwb=True,
        use_tag=True,
        fused_t_ns=t_ns - int(age_s * S),
    )
    state = VehicleState((0.0, 0.0, -5.0), STILL, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, relative=relative)
    tracking = PlatformTracking(90 * S, None, CONFIG.coast_s)
    assert tracking.update(t_ns, 0.02, state, searches=False) is None
    assert (tracking.rough is not None) is comes_nearer
