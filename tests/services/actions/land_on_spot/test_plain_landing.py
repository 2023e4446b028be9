"""A landing on a spot by the vehicle's own position: its climbs before the approach and after a slide, and a tilt over
what it touches."""

from math import hypot

import pytest
from msgspec.structs import replace

from jezero.base.frames import Quat, Vec3, add, quat_from_euler, subtract
from jezero.schemas.commands import Phase
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig, PlainLandingConfig
from jezero.services.actions.land_on_spot.plain_landing import (
    PlainLanding,
    TiltContactDetector,
)
from jezero.services.actions.motion.behaviour import Done, Move, VehicleState
from tests.services.actions.fake_bridge import follow

S = 1_000_000_000
DT_NS = 20_000_000
STILL: Vec3 = (0.0, 0.0, 0.0)
SETTINGS = LandOnSpotConfig(plain=PlainLandingConfig(approach_height_min_m=1.5))
CONFIG = ActionsConfig(land_on_spot=SETTINGS)


def at(pos_ned_m: Vec3, height_m: float | None, vel_ned_mps: Vec3 = STILL) -> VehicleState:
    return VehicleState(pos_ned_m, vel_ned_mps, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, height_m=height_m)


def landing(spot_ned_m: Vec3, state: VehicleState) -> PlainLanding:
    return PlainLanding(spot_ned_m, CONFIG, force=False, t_ns=0, state=state)


@pytest.mark.parametrize(
    ("z_ned_m", "height_m", "z_approach_ned_m"),
    [
        (-5.0, 0.5, -6.0),  # over raised ground, which the altitude knows nothing of
        (-5.0, 1.5, -5.0),
        (-0.5, 3.0, -0.5),  # over a hole
        (-0.5, None, -1.5),
        (-2.0, None, -2.0),
    ],
)
def test_it_approaches_at_least_a_metre_and_a_half_above_what_the_altimeter_measures(
    z_ned_m: float, height_m: float | None, z_approach_ned_m: float
) -> None:
    state = at((0.0, 0.0, z_ned_m), height_m)
    behaviour = landing((0.0, 10.0, 0.0), state)
    assert behaviour.path(state)[1] == pytest.approx((0.0, 10.0, z_approach_ned_m))
    move = behaviour.step(S, state)
    assert isinstance(move, Move)
    assert move.pos_ned_m is not None
    climbs = z_approach_ned_m < z_ned_m
    assert (move.pos_ned_m[2] < z_ned_m) is climbs
    assert (move.pos_ned_m[1] == 0.0) is climbs, "it climbs first, and comes nearer then"


@pytest.mark.parametrize("spot_ned_m", [STILL, (30.0, -20.0, 0.0)])
@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0)])
def test_a_vehicle_that_slides_over_the_ground_climbs_and_comes_down_again(
    direction: tuple[float, float], spot_ned_m: Vec3
) -> None:
    north, east = direction

    def at_spot(slid_m: float, height_m: float) -> VehicleState:
        return at(add(spot_ned_m, (north * slid_m, east * slid_m, -height_m)), height_m)

    behaviour, t_ns = landing(spot_ned_m, at_spot(0.0, 2.0)), 0
    moves: list[Move] = []

    def step(state: VehicleState) -> Move:
        nonlocal t_ns
        t_ns += DT_NS
        move = behaviour.step(t_ns, state)
        assert isinstance(move, Move)
        moves.append(move)
        return move

    while behaviour.approaches:
        step(at_spot(0.0, 2.0))
    slid_m = 0.0
    while (move := step(at_spot(slid_m, 0.05))).feedback.phase != "go_around":
        slid_m += 0.01  # 0.5 m/s
        assert slid_m < 0.3
    assert slid_m > 0.15
    assert move.vel_ned_mps == pytest.approx((0.0, 0.0, -1.5)), "upwards"
    assert step(at_spot(slid_m, 1.4)).vel_ned_mps == pytest.approx((0.0, 0.0, -1.5))
    step(at_spot(slid_m, 1.6))
    again = step(at_spot(slid_m, 1.6)).vel_ned_mps
    assert again is not None and again[2] > 0.0


def tilted(angle_rad: float, *, sideways: bool) -> Quat:
    return quat_from_euler(angle_rad, 0.0, 0.0) if sideways else quat_from_euler(0.0, angle_rad, 0.0)


@pytest.mark.parametrize("sideways", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("free_rad", "tilt_rad", "down_mps", "stalled_s", "tilts"),
    [
        (0.0, 0.19, 0.0, 0.3, True),
        (0.0, 0.16, 0.0, 0.3, False),
        (0.0, 0.19, 0.24, 0.3, True),
        (0.0, 0.19, 0.26, 0.3, False),
        (0.0, 0.19, -0.15, 0.3, True),
        (0.0, 0.19, -0.25, 0.3, False),
        (0.0, 0.19, 0.0, 0.1, False),
        (0.25, 0.25, 0.0, 0.3, False),
        (-0.1, 0.19, 0.0, 0.3, True),
    ],
    ids=[
        "an edge",
        "level ground",
        "slow",
        "a gust while it descends",
        "hardly rises",
        "a gust while it rises",
        "for a moment",
        "the wind",
        "against the wind",
    ],
)
def test_a_tilt_counts_as_contact_above_ten_degrees_more_than_in_the_air_in_a_descent_that_has_stopped(
    free_rad: float, tilt_rad: float, down_mps: float, stalled_s: float, tilts: bool, sign: float, sideways: bool
) -> None:
    """0.17 rad are permitted, half of the commanded 0.5 m/s or 0.2 m/s upwards, and 0.2 s."""
    detector, t_ns, found = TiltContactDetector(), 0, []
    for q, vel_down_mps, duration_s in (
        (tilted(sign * free_rad, sideways=sideways), 0.5, 4.0),
        (tilted(sign * tilt_rad, sideways=sideways), down_mps, stalled_s),
    ):
        for _ in range(round(duration_s * S / DT_NS)):
            t_ns += DT_NS
            state = VehicleState((0.0, 0.0, -1.0), (0.0, 0.0, vel_down_mps), q, armed=True, landed=False)
            found.append(detector.update(t_ns, state, 0.5))
    assert found[-1] is tilts
    assert not any(found[:200]), "in the air"


@pytest.mark.parametrize("sideways", [False, True])
def test_a_short_tilt_in_the_air_is_no_wind_yet(sideways: bool) -> None:
    """0.2 s of 0.2 rad pass a filter of 0.5 s with a third."""
    detector, level = TiltContactDetector(), (1.0, 0.0, 0.0, 0.0)
    for t_ns in range(DT_NS, 4 * S + 10 * DT_NS, DT_NS):
        q = tilted(0.2, sideways=sideways) if t_ns > 4 * S else level
        detector.update(t_ns, VehicleState(STILL, (0.0, 0.0, 0.5), q, armed=True, landed=False), 0.5)
    north, east = detector.free_down_ned
    assert 0.05 < hypot(north, east) < 0.08
    assert (east < -0.05, north > 0.05) == (sideways, not sideways), "as far as it counts, it leans the same way"


@pytest.mark.parametrize(("descends_s", "tilts"), [(0.1, True), (0.3, False)])
def test_a_vehicle_that_descends_again_from_what_it_touched_may_tilt_over_it_for_a_fifth_of_a_second(
    descends_s: float, tilts: bool
) -> None:
    detector, t_ns, found = TiltContactDetector(), 0, []
    level, over = (1.0, 0.0, 0.0, 0.0), tilted(0.25, sideways=True)
    for q, down_mps, duration_s in ((level, 0.5, 2.0), (level, 0.0, 0.4), (level, 0.5, descends_s), (over, 0.5, 0.06)):
        for _ in range(round(duration_s * S / DT_NS)):
            t_ns += DT_NS
            state = VehicleState((0.0, 0.0, -1.0), (0.0, 0.0, down_mps), q, armed=True, landed=False)
            found.append(detector.update(t_ns, state, 0.5))
    assert any(found) is tilts


@pytest.mark.parametrize("sideways", [False, True])
def test_a_tilt_that_lasts_in_the_air_is_that_of_the_wind(sideways: bool) -> None:
    detector = TiltContactDetector()
    blown = VehicleState(STILL, (0.0, 0.0, 0.5), tilted(0.2, sideways=sideways), armed=True, landed=False)
    detector.update(DT_NS, at(STILL, None, (0.0, 0.0, 0.5)), 0.5)
    for step in range(2, 200):
        detector.update(step * DT_NS, blown, 0.5)
    assert detector.free_down_ned == pytest.approx(blown.down_ned, abs=0.01)


def test_a_tilt_of_the_wind_before_a_time_without_steps_counts_still() -> None:
    """Ten seconds without a step, as in a pause, are no ten seconds of measurements."""
    detector, t_ns = TiltContactDetector(), 0
    for _ in range(200):
        t_ns += DT_NS
        detector.update(t_ns, at(STILL, None, (0.0, 0.0, 0.5)), 0.5)
    blown = VehicleState(STILL, (0.0, 0.0, 0.5), tilted(0.2, sideways=True), armed=True, landed=False)
    detector.update(t_ns + 10 * S, blown, 0.5)
    assert hypot(*detector.free_down_ned) < 0.2 * hypot(*blown.down_ned) + 0.01


def descending() -> PlainLanding:
    """A landing that has begun to descend from 5 m over the origin."""
    behaviour, t_ns = landing(STILL, at((0.0, 0.0, -5.0), 5.0)), 0
    while behaviour.approaches:
        t_ns += DT_NS
        behaviour.step(t_ns, at((0.0, 0.0, -5.0), 5.0))
    return behaviour


@pytest.mark.parametrize(
    ("height_m", "way_m", "down_s"),
    [
        (5.0, 5.0, 3.5 / 0.7 + 1.5 / 0.3),
        (0.3, 0.3, 1.0),
        (-0.1, 0.0, 0.0),
        (None, 4.0, 2.5 / 0.7 + 1.5 / 0.3),
    ],
)
def test_what_remains_of_a_descent_is_the_way_down_and_the_time_until_the_motors_stop(
    height_m: float | None, way_m: float, down_s: float
) -> None:
    """The altimeter measures the way down; where it measures nothing, the altitude of 4 m is the way down."""
    remaining = descending().remaining(at((0.0, 0.0, -4.0), height_m))
    assert (remaining.distance_m, remaining.time_s) == pytest.approx((way_m, down_s + 4.0))


@pytest.mark.parametrize("off_m", [0.1, -0.2, 30.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_descent_comes_back_to_its_spot_without_overshoot_and_not_faster_than_it_may(off_m: float, axis: int) -> None:
    behaviour = descending()
    move = behaviour.step(20 * S, at((off_m, 0.0, -4.0) if axis == 0 else (0.0, off_m, -4.0), 4.0))
    assert isinstance(move, Move) and move.vel_ned_mps is not None
    back_mps = -move.vel_ned_mps[axis] if off_m > 0.0 else move.vel_ned_mps[axis]
    assert 0.5 * min(abs(off_m), 0.5) < back_mps <= min(abs(off_m) / 1.0, 0.5) + 1e-9
    assert move.vel_ned_mps[1 - axis] == 0.0


class Flight:
    """A landing of a point mass on a spot, the origin by default; the ground is at the world's origin.

    Attributes:
        altimeter: whether it measures.
        grounded: whether the autopilot detects the ground.
        holds: whether something holds the vehicle where it is.
        q_ned_from_frd: attitude.
        wind_ned_mps: estimated wind.
    """

    def __init__(
        self, start_ned_m: Vec3, spot_ned_m: Vec3 = STILL, *, altimeter: bool = True, force: bool = False
    ) -> None:
        self.pos_m, self.vel_mps, self.t_ns = start_ned_m, STILL, 0
        self.altimeter, self.grounded, self.holds = altimeter, True, False
        self.q_ned_from_frd: Quat = (1.0, 0.0, 0.0, 0.0)
        self.wind_ned_mps: Vec3 | None = None
        self.moves: list[tuple[float, Vec3, Move]] = []
        self._still_s = 0.0
        self.behaviour = PlainLanding(spot_ned_m, CONFIG, force=force, t_ns=0, state=self.state())

    def state(self) -> VehicleState:
        return VehicleState(
            self.pos_m,
            self.vel_mps,
            self.q_ned_from_frd,
            armed=True,
            landed=self.grounded and self._still_s > 1.0,
            height_m=-self.pos_m[2] if self.altimeter else None,
            wind_ned_mps=self.wind_ned_mps,
        )

    @property
    def phases(self) -> list[str]:
        return list(dict.fromkeys(move.feedback.phase for _, _, move in self.moves))

    @property
    def phase(self) -> str:
        return str(self.moves[-1][2].feedback.phase)

    def phase_begin(self, phase: str) -> int:
        """Number of the first move of a phase."""
        return next(number for number, (_, _, move) in enumerate(self.moves) if move.feedback.phase == phase)

    def run(self, within_s: float, until: str = "") -> Done | None:
        """Fly on, until a phase of the landing at most."""
        for _ in range(round(within_s * S / DT_NS)):
            self.t_ns += DT_NS
            move = self.behaviour.step(self.t_ns, self.state())
            if isinstance(move, Done):
                return move
            self.moves.append((self.t_ns / S, self.pos_m, move))
            if move.feedback.phase == until:
                return None
            if not self.holds:
                self.pos_m, self.vel_mps = follow(self.pos_m, self.vel_mps, move.pos_ned_m, move.vel_ned_mps, DT_NS / S)
            self._still_s = self._still_s + DT_NS / S if self.pos_m[2] == 0.0 else 0.0
        return None


@pytest.mark.parametrize("altimeter", [True, False])
@pytest.mark.parametrize("start_ned_m", [(3.0, -2.0, -4.0), (-3.0, 4.0, -0.5)])
def test_a_landing_comes_down_slowly_over_its_spot_and_presses_down_until_the_autopilot_finds_the_ground(
    start_ned_m: Vec3, altimeter: bool
) -> None:
    flight = Flight(start_ned_m, (2.0, -1.0, 0.0), altimeter=altimeter)
    assert flight.run(60.0) == Done("succeeded", then="disarm")
    assert flight.phases == ["approach", "descent", "contact"]
    slow_m = 1.5 if altimeter else 2.5
    begin = flight.phase_begin("descent")
    for number, (_, pos_m, move) in enumerate(flight.moves):
        from_spot_m = subtract(pos_m, (2.0, -1.0, 0.0))
        assert move.feedback.pos_rel_ned_m == pytest.approx(from_spot_m)
        assert move.phase is Phase.LANDING
        if move.feedback.phase == "descent" and number > begin:
            assert move.vel_ned_mps is not None
            assert move.vel_ned_mps[2] == (0.3 if -pos_m[2] < slow_m else 0.7)
            assert hypot(*from_spot_m[:2]) < 0.6
    assert hypot(*from_spot_m[:2]) < 0.1
    pressed = [move for _, _, move in flight.moves if move.feedback.phase == "contact"]
    assert {move.vel_ned_mps for move in pressed} == {(0.0, 0.0, 0.5)}
    assert pressed[-1].acc_ned_mps2 is not None and pressed[-1].acc_ned_mps2[2] > 1.0, "its thrust goes down"
    assert flight.behaviour.result(True, (0.1, 0.2, 0.0)).touchdown_ned_m == (0.1, 0.2, 0.0)
    assert flight.behaviour.result(False, (0.1, 0.2, 0.0)).touchdown_ned_m is None


def test_the_rest_of_a_landing_has_its_climb_its_way_and_its_descent() -> None:
    low, high = Flight((0.0, 4.0, -0.5)), Flight((0.0, 4.0, -1.5))
    flights = (low, high)
    for flight in flights:
        flight.run(0.04)
    rests = [flight.behaviour.remaining(flight.state()) for flight in flights]
    assert [rest.distance_m for rest in rests] == pytest.approx([1.0 + 4.0 + 1.5, 4.0 + 1.5], abs=0.1)
    assert rests[0].time_s > rests[1].time_s + 0.5
    begin_s = high.t_ns / S
    high.run(60.0)
    assert high.t_ns / S - begin_s == pytest.approx(rests[1].time_s, abs=4.0)


def test_a_descent_that_is_held_up_in_the_air_is_no_contact_in_its_first_second() -> None:
    flight = Flight((0.0, 0.0, -4.0))
    flight.run(10.0, until="descent")
    begin_s = flight.t_ns / S
    flight.holds, flight.vel_mps = True, STILL
    flight.run(5.0, until="contact")
    assert flight.t_ns / S - begin_s == pytest.approx(1.0, abs=0.1)
    assert flight.phase == "contact"
    assert flight.moves[-1][2].acc_ned_mps2 is None, "a vehicle that a gust holds up keeps its thrust"


@pytest.mark.parametrize("down_mps", [0.09, 0.11])
def test_a_descent_that_has_stopped_for_half_a_second_is_contact_without_an_altimeter(down_mps: float) -> None:
    flight = Flight((0.0, 0.0, -4.0), altimeter=False)
    flight.run(10.0, until="descent")
    flight.run(2.0)
    flight.holds, flight.vel_mps = True, (0.0, 0.0, down_mps)
    flight.run(0.45)
    assert flight.phase == "descent"
    flight.run(0.15)
    assert flight.phase == ("contact" if down_mps < 0.1 else "descent")


@pytest.mark.parametrize(("height_m", "thrust_goes_down"), [(0.25, True), (0.35, False)])
def test_the_thrust_of_a_vehicle_whose_descent_has_stopped_goes_down_only_close_to_the_ground(
    height_m: float, thrust_goes_down: bool
) -> None:
    flight = Flight((0.0, 0.0, -4.0))
    flight.run(10.0, until="descent")
    flight.pos_m, flight.vel_mps, flight.holds = (0.0, 0.0, -height_m), STILL, True
    flight.run(5.0, until="contact")
    flight.run(0.1)
    acc_ned_mps2 = flight.moves[-1][2].acc_ned_mps2
    assert (acc_ned_mps2 is not None and acc_ned_mps2[2] > 1.0) is thrust_goes_down


@pytest.mark.parametrize(("height_m", "phase"), [(0.155, "contact"), (0.18, "descent")])
def test_a_range_as_short_as_the_altimeter_can_measure_is_contact_at_once(height_m: float, phase: str) -> None:
    """The altimeter measures 0.15 m and more, though it is lower than that on the ground."""
    flight = Flight((0.0, 0.0, -4.0))
    flight.run(10.0, until="descent")
    flight.pos_m, flight.vel_mps, flight.holds = (0.0, 0.0, -height_m), (0.0, 0.0, 0.2), True
    flight.run(0.04)
    assert flight.phase == phase


def test_ground_that_gives_way_is_no_contact_any_more() -> None:
    flight = Flight((0.0, 0.0, -2.0))
    flight.run(20.0, until="contact")
    flight.vel_mps, flight.pos_m = (0.0, 0.0, 0.24), (0.0, 0.0, -0.2)
    flight.holds = True
    flight.run(0.04)
    assert flight.phase == "contact"
    flight.vel_mps = (0.0, 0.0, 0.26)
    flight.run(0.04)
    assert flight.phase == "descent"


def test_ground_that_the_autopilot_does_not_find_ends_the_landing_after_fifteen_seconds() -> None:
    flight = Flight((0.0, 0.0, -2.0))
    flight.grounded = False
    flight.run(20.0, until="contact")
    begin_s = flight.t_ns / S
    done = flight.run(20.0)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "hover")
    assert done.reason == "the autopilot doesn't detect the ground 15 s after contact"
    assert flight.t_ns / S - begin_s == pytest.approx(15.0, abs=0.6)


def test_a_descent_without_a_contact_ends_after_ten_minutes() -> None:
    behaviour = descending()
    sinking = at((0.0, 0.0, -4.0), 4.0, (0.0, 0.0, 0.7))
    assert isinstance(behaviour.step(590 * S, sinking), Move)
    done = behaviour.step(610 * S, sinking)
    assert isinstance(done, Done)
    assert done.reason.startswith("no contact after 6")


@pytest.mark.parametrize("sideways", [True, False])
def test_a_vehicle_that_tilts_over_an_edge_climbs_for_a_moment_and_lands_nowhere(sideways: bool) -> None:
    flight = Flight((0.0, 0.0, -2.0))
    flight.grounded = False
    flight.run(20.0, until="contact")
    flight.run(0.5)
    assert flight.behaviour.pause_refusal(flight.state())
    flight.q_ned_from_frd = tilted(0.25, sideways=sideways)
    before = len(flight.moves)
    done = flight.run(5.0)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "hover")
    assert done.reason == "the vehicle tilted over an edge or a rock at the landing spot: land somewhere else"
    up = [move.vel_ned_mps for _, _, move in flight.moves[before:] if move.vel_ned_mps == (0.0, 0.0, -1.0)]
    assert len(up) * DT_NS / S == pytest.approx(1.5, abs=0.1)
    assert flight.pos_m[2] < -1.0


def test_a_tilt_against_the_wind_is_no_edge() -> None:
    flight = Flight((0.0, 0.0, -2.0))
    flight.q_ned_from_frd = tilted(0.25, sideways=False)
    assert flight.run(30.0) == Done("succeeded", then="disarm")


def test_a_vehicle_that_lies_on_its_side_has_not_landed() -> None:
    flight = Flight((0.0, 0.0, -2.0))
    flight.run(20.0, until="contact")
    lying = replace(flight.state(), landed=True, q_ned_from_frd=(0.6, 0.8, 0.0, 0.0))
    assert flight.behaviour.step(flight.t_ns + DT_NS, lying) == Done(
        "aborted", "the vehicle fell over: it is tilted by 106 degrees", "disarm"
    )


def test_a_vehicle_that_slides_again_and_again_ends_its_landing_in_a_hover() -> None:
    flight, slides = Flight((0.0, 0.0, -2.0)), 0
    flight.grounded = False
    done = None
    while done is None:
        done = flight.run(20.0, until="contact")
        for step in range(100):
            if done is not None or flight.phase == "go_around":
                break
            flight.pos_m = (0.02 * step, 0.0, 0.0)
            done = flight.run(0.02)
        slides += flight.phase == "go_around"
        if done is None:
            done = flight.run(5.0, until="descent")
            assert done is not None or flight.behaviour.pause_refusal(flight.state()) == ""
        flight.pos_m = (0.0, 0.0, flight.pos_m[2])
        assert slides < 10
    assert slides == 4
    assert "the vehicle slid on what it touched, in spite of 3 go-arounds" in done.reason


@pytest.mark.parametrize("sideways", [False, True])
def test_a_gust_that_tilts_a_vehicle_which_still_rises_after_a_slide_is_no_edge(sideways: bool) -> None:
    flight = Flight((0.0, 0.0, -2.0))
    flight.grounded = False
    flight.run(20.0, until="contact")
    for step in range(100):
        flight.pos_m = (0.02 * step, 0.0, 0.0)
        flight.run(0.02)
        if flight.phase == "go_around":
            break
    assert flight.run(5.0, until="descent") is None
    assert flight.vel_mps[2] < -1.0, "it still rises"
    flight.q_ned_from_frd = tilted(0.25, sideways=sideways)
    assert flight.run(0.3) is None
    flight.q_ned_from_frd = (1.0, 0.0, 0.0, 0.0)
    assert flight.run(1.0) is None
    assert flight.phase == "descent"
    assert flight.moves[-1][2].vel_ned_mps is not None and flight.moves[-1][2].vel_ned_mps[2] > 0.0, "it descends"


def test_a_pause_hovers_in_the_descent_and_climbs_first_when_it_is_low() -> None:
    flight = Flight((0.0, 0.0, -2.0))
    assert flight.behaviour.pause_refusal(flight.state()) == ""
    assert flight.behaviour.hold(0, 0.02, flight.state()) is None, "the pause of a straight way needs no own hover"
    flight.run(10.0, until="descent")
    flight.run(1.0)
    for height_m, climbs in ((1.8, False), (0.5, True)):
        flight.pos_m = (0.0, 0.0, -height_m)
        flight.t_ns += DT_NS
        for _ in range(100):
            move = flight.behaviour.hold(flight.t_ns, 0.02, flight.state())
        assert isinstance(move, Move) and move.vel_ned_mps is not None
        assert (move.vel_ned_mps[2] < -0.1) is climbs
    assert flight.behaviour.pause_refusal(flight.state()) == ""


def test_each_pause_of_a_descent_hovers_where_the_vehicle_is_then() -> None:
    flight = Flight((0.0, 0.0, -5.0))
    flight.run(10.0, until="descent")
    for north_m in (0.0, 2.0):
        flight.pos_m = (north_m, 0.0, -4.0)
        flight.t_ns += DT_NS
        for _ in range(50):
            move = flight.behaviour.hold(flight.t_ns, 0.02, flight.state())
        assert isinstance(move, Move) and move.vel_ned_mps == pytest.approx(STILL, abs=0.01)


@pytest.mark.parametrize("force", [False, True])
def test_an_approach_ends_when_the_wind_stays_above_the_limit_unless_forced(force: bool) -> None:
    flight = Flight((0.0, 30.0, -4.0), force=force)
    flight.run(1.0)
    flight.wind_ned_mps = (0.0, 12.5, 0.0)
    done = flight.run(5.0)
    assert (done is None) is force
    assert done is None or "the wind is 12.5 m/s, and a landing is limited to 12 m/s" in done.reason


def test_a_vehicle_that_does_not_come_to_its_spot_says_so() -> None:
    flight = Flight((0.0, 30.0, -4.0))
    flight.holds = True
    done = flight.run(120.0)
    assert done is not None
    assert done.reason.startswith("approach: ")
