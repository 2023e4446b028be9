"""Odometry on a line that is too narrow for it."""

from math import cos, sin

import pytest

from jezero.services.vehicle_bridge.narrow_line import OdometryRate, PairedOdometry, rate_refusal

S, MS = 1_000_000_000, 1_000_000


def run(rate: OdometryRate, begin_s: float, end_s: float, hz: float, round_trip_ns: int = MS) -> list[float]:
    """Times at which the line was found too narrow."""
    found, arrived = [], 0
    steps = range(int(begin_s * 50), int(end_s * 50))
    for step in steps:
        while arrived < (step - steps[0]) * hz / 50:
            arrived += 1
            rate.add(step * 20 * MS)
        if rate.update(step * 20 * MS, round_trip_ns):
            found.append(step / 50)
    return found


def test_fifty_odometries_a_second_are_enough() -> None:
    rate = OdometryRate()
    assert run(rate, 0, 20, 50.0) == []
    assert not rate.narrow
    assert rate.hz == pytest.approx(50.0, abs=1.0)


def test_four_a_second_are_too_few_but_not_before_the_controller_got_the_request() -> None:
    rate = OdometryRate()
    (found_s,) = run(rate, 0, 10, 4.0)
    assert 5.9 < found_s < 6.5
    assert rate.narrow
    assert rate.hz is None  # the smaller messages are judged anew
    run(rate, 10, 20, 30.0)
    assert rate.hz == pytest.approx(30.0, abs=1.0)


@pytest.mark.parametrize(
    ("hz", "round_trip_ms", "narrow"), [(22.0, 1, False), (17.0, 1, True), (50.0, 40, False), (50.0, 70, True)]
)
def test_a_line_is_too_narrow_below_20_hz_and_when_an_answer_takes_more_than_50_ms(
    hz: float, round_trip_ms: int, narrow: bool
) -> None:
    rate = OdometryRate()
    assert bool(run(rate, 0, 10, hz, round_trip_ms * MS)) is narrow
    assert rate.narrow is narrow


def test_a_line_that_is_full_is_too_narrow_also_where_enough_arrives() -> None:
    rate = OdometryRate()
    assert len(run(rate, 0, 10, 25.0, round_trip_ns=190 * MS)) == 1


def test_an_interrupted_line_is_judged_anew() -> None:
    rate = OdometryRate()
    run(rate, 0, 8, 50.0)
    rate.restart()
    assert run(rate, 60, 64, 4.0) == []
    assert rate.hz is None


@pytest.mark.parametrize(("hz", "refused"), [(None, False), (15.0, False), (20.0, False), (14.4, True)])
def test_odometry_that_comes_too_rarely_for_an_action_is_refused(hz: float | None, refused: bool) -> None:
    reason = rate_refusal(hz, 15.0, "land on spot", "udpin:0.0.0.0:14540")
    assert bool(reason) is refused
    if refused:
        assert reason == (
            "odometry comes at 14 Hz over udpin:0.0.0.0:14540, and land on spot needs 15 Hz: raise MAV_2_RATE, or use "
            "a better network"
        )
        assert "SER_TEL2_BAUD" in rate_refusal(hz, 15.0, "land on spot", "serial:/dev/ttyACM0:57600")


def test_a_line_that_got_faster_is_not_found_too_narrow_a_second_time() -> None:
    rate = OdometryRate()
    assert len(run(rate, 0, 40, 4.0)) == 1
    assert rate.narrow


def test_the_rate_is_that_of_the_last_three_seconds() -> None:
    rate = OdometryRate()
    run(rate, 0, 20, 50.0)
    run(rate, 20, 24, 30.0)
    assert rate.hz == pytest.approx(30.0, abs=1.0)
    run(rate, 24, 28, 22.0)
    assert rate.hz == pytest.approx(22.0, abs=1.0)


@pytest.mark.parametrize(("position_ms", "turned_rad"), [(1050, 0.05), (950, -0.05), (1200, None), (800, None)])
def test_a_pair_is_turned_to_the_positions_time_and_needs_an_attitude_of_about_that_time(
    position_ms: int, turned_rad: float | None
) -> None:
    pair, still = PairedOdometry(), (0.0, 0.0, 0.0)
    pair.on_attitude(S, (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    found = pair.on_position(position_ms * MS, still, still)
    if turned_rad is None:
        assert found is None
    else:
        assert found is not None
        assert found[0] == pytest.approx((cos(turned_rad / 2.0), sin(turned_rad / 2.0), 0.0, 0.0))
        assert found[1] == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(("unexplained_m", "steps"), [(0.4, 0), (-0.4, 0), (0.7, 1), (-0.7, 1)])
def test_a_step_counts_from_half_a_metre_on(unexplained_m: float, steps: int) -> None:
    pair = PairedOdometry()
    pair.on_position(0, (0.0, 0.0, -3.0), (3.0, 0.0, 0.0))
    pair.on_position(33 * MS, (0.1 + unexplained_m, 0.0, -3.0), (3.0, 0.0, 0.0))
    assert pair.reset_counter == steps


def test_the_counter_of_steps_has_a_byte_as_px4s() -> None:
    pair = PairedOdometry()
    for number in range(258):
        pair.on_position(number * 33 * MS, (float(number % 2), 0.0, -3.0), (0.0, 0.0, 0.0))
    assert pair.reset_counter == 1


def test_a_pair_has_the_attitude_of_the_positions_time() -> None:
    pair = PairedOdometry()
    assert pair.on_position(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) is None  # no attitude yet
    pair.on_attitude(S, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    found = pair.on_position(S + 20 * MS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert found is not None
    assert found[0] == pytest.approx((cos(0.01), 0.0, 0.0, sin(0.01)))
    assert pair.on_position(S + 300 * MS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) is None  # the attitude is too old


def test_a_step_that_the_velocity_does_not_explain_counts_as_a_reset() -> None:
    pair = PairedOdometry()
    pair.on_position(0, (0.0, 0.0, -3.0), (10.0, 0.0, 0.0))
    pair.on_position(100 * MS, (1.05, 0.0, -3.0), (10.0, 0.0, 0.0))
    assert pair.reset_counter == 0
    pair.on_position(200 * MS, (2.05, 0.8, -3.0), (10.0, 0.0, 0.0))
    assert pair.reset_counter == 1
    pair.on_position(300 * MS, (3.05, 0.8, -3.0), (10.0, 0.0, 0.0))
    assert pair.reset_counter == 1


def test_a_vehicle_that_brakes_while_the_line_is_interrupted_is_no_step() -> None:
    """Within 2 s it stops from 5 m/s in 1 s: 2.5 m, where the last velocity leads 10 m on."""
    pair = PairedOdometry()
    pair.on_position(0, (0.0, 0.0, -3.0), (5.0, 0.0, 0.0))
    pair.on_position(2 * S, (2.5, 0.0, -3.0), (0.0, 0.0, 0.0))
    assert pair.reset_counter == 0
    pair.on_position(2 * S + 33 * MS, (2.5, 0.6, -3.0), (0.0, 0.0, 0.0))
    assert pair.reset_counter == 1
