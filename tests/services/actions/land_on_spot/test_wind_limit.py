"""The limit compares the mean wind of some seconds: a gust ends no landing."""

from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.wind_limit import ABOVE_LIMIT_S, WindLimit, wind_refusal
from jezero.services.actions.motion.behaviour import VehicleState

MAX_MPS = 9.0
STEP_S = 0.1


def in_wind(mean_mps: float | None) -> VehicleState:
    wind_ned_mps = None if mean_mps is None else (0.6 * mean_mps, 0.8 * mean_mps, 0.0)
    return VehicleState(
        (0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), armed=True, landed=False,
        wind_ned_mps=wind_ned_mps, std_gust_mps=2.0,
    )  # fmt: skip


def reasons(*winds: tuple[float | None, float], force: bool = False) -> list[str]:
    """Reasons of all steps in pairs of a mean wind and its duration in s."""
    limit, t_ns, found = WindLimit(MAX_MPS, force), 0, []
    for mean_mps, duration_s in winds:
        for _ in range(round(duration_s / STEP_S)):
            t_ns += int(STEP_S * NS_PER_S)
            limit.update(t_ns, in_wind(mean_mps))
            found.append(limit.reason)
    return found


def test_a_refusal_names_the_wind_the_limit_its_setting_and_what_to_do() -> None:
    refusal = wind_refusal((6.0, 8.0, 0.0), 2.5, MAX_MPS)
    assert refusal == (
        "the wind is 10.0 m/s with gusts to 12.5 m/s, and a landing is limited to 9 m/s (wind_max_mps): "
        "wait for less wind, or use force"
    )


def test_gusts_above_the_limit_are_none_of_its_business() -> None:
    assert wind_refusal((6.0, 6.0, 0.0), 5.0, MAX_MPS) == ""


def test_an_unknown_wind_is_no_reason() -> None:
    assert wind_refusal(None, None, MAX_MPS) == ""
    assert not any(reasons((None, 2.0 * ABOVE_LIMIT_S)))


def test_a_wind_that_stays_above_the_limit_ends_an_approach() -> None:
    assert "a landing is limited to 9 m/s" in reasons((8.0, 1.0), (10.0, ABOVE_LIMIT_S + 1.0))[-1]


def test_a_wind_that_is_above_the_limit_for_a_moment_ends_nothing() -> None:
    moment = (10.0, ABOVE_LIMIT_S - 1.0)
    assert not any(reasons(moment, (8.0, 0.2), moment))


def test_force_lands_in_any_wind() -> None:
    assert not any(reasons((30.0, 2.0 * ABOVE_LIMIT_S), force=True))
