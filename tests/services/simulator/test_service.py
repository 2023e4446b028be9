"""The simulator as the runtime sees it: steps in, messages out."""

import hashlib
from collections import Counter
from itertools import pairwise
from typing import Any, Literal

import msgspec
import pytest

from jezero.base.codec import encode
from jezero.base.config import ConfigError, load_config
from jezero.base.frames import Vec3, distance, norm
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Output, Publish, Reply, Request, Send
from jezero.schemas import topics
from jezero.schemas.commands import RoverCommand
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.terrain import GetGround, Ground
from jezero.services.simulator.config import RoverConfig, SimulatorConfig, UavConfig, WindConfig
from jezero.services.simulator.rover_port import ROVER
from jezero.services.simulator.schedule import Schedule
from jezero.services.simulator.service import HIL, SPEC, Simulator

STEP_NS = 4_000_000
VEHICLE = VehicleConfig()
CALM = SimulatorConfig(wind=WindConfig(mean_mps=0.0, std_gust_mps=0.0))


class Bench:
    """A simulator with the links of an autopilot and of a rover's computer, which the test controls."""

    def __init__(self, config: SimulatorConfig = CALM, seed: int = 1) -> None:
        self.simulator = Simulator(config, VEHICLE, seed, boot_id=7)
        self.t_ns = 0
        self.up = True
        self.count = 1
        self.wall_ns = 0
        self.command: float | None = None
        self.rover_up = False
        self.rover_count = 0
        self.rover_sends = b""
        self.rover_commands: list[RoverCommand] = []
        """Commands on the bus."""
        self.outputs: list[Output] = []
        self.pending: tuple[Request, ...] = ()
        self._codec = MavlinkCodec(1, 1)

    def received(self, link: str) -> bytes:
        if link == ROVER:
            data, self.rover_sends = self.rover_sends, b""
            return data
        if self.command is None or not self.up:
            return b""
        values = [self.command] * 4 + [0.0] * 12
        return self._codec.pack(dialect.MAVLink_hil_actuator_controls_message(self.t_ns // 1000, values, 129, 1))

    def new(self, topic: Topic[Any]) -> list[RoverCommand]:
        assert topic is topics.ROVER_COMMAND
        commands, self.rover_commands = self.rover_commands, []
        return commands

    def requests(self, endpoint: Endpoint[Any, Any]) -> tuple[Request, ...]:
        return self.pending if endpoint is topics.GROUND else ()

    def connections(self, link: str) -> int:
        return self.count if link == HIL else self.rover_count

    def is_up(self, link: str) -> bool:
        return self.up if link == HIL else self.rover_up

    def run(self, steps: int) -> list[Output]:
        inbox: Any = self
        outputs: list[Output] = []
        for _ in range(steps):
            outputs.extend(self.simulator.step(self.t_ns, inbox))
            self.t_ns += STEP_NS
            self.wall_ns += STEP_NS
        self.outputs.extend(outputs)
        return outputs


def published(outputs: list[Output], topic: Topic[Any]) -> list[Any]:
    return [o.message for o in outputs if isinstance(o, Publish) and o.topic is topic]


def sent(outputs: list[Output], message_id: int) -> list[Any]:
    data = b"".join(o.data for o in outputs if isinstance(o, Send) and o.link == HIL)
    return [m for m in MavlinkCodec(1, 1).parse(data) if m.get_msgId() == message_id]


def digest(outputs: list[Output]) -> str:
    sha = hashlib.sha256()
    for output in outputs:
        if isinstance(output, Publish):
            sha.update(encode(output.message))
        elif isinstance(output, Send):
            sha.update(output.data)
    return sha.hexdigest()


def test_every_topic_and_hil_message_keeps_its_rate() -> None:
    bench = Bench()
    bench.run(50)
    outputs = bench.run(2500)
    counts = Counter(o.topic.name for o in outputs if isinstance(o, Publish))
    assert set(counts) == {topic.name for topic in SPEC.outputs}
    for topic in SPEC.outputs:
        assert topic.rate_hz is not None
        assert counts[topic.name] == pytest.approx(10 * topic.rate_hz, abs=1), topic.name
    hil = sent(outputs, dialect.MAVLINK_MSG_ID_HIL_SENSOR)
    assert len(hil) == 2500
    assert sum(m.fields_updated & 0x1C0 == 0x1C0 for m in hil) == 500
    assert sum(m.fields_updated & 0x1A00 == 0x1A00 for m in hil) == 500
    assert len(sent(outputs, dialect.MAVLINK_MSG_ID_HIL_GPS)) == 100


def test_the_imu_is_first_and_in_every_step() -> None:
    bench = Bench()
    for i in range(20):
        links = [o for o in bench.run(1) if isinstance(o, Send)]
        (message,) = MavlinkCodec(1, 1).parse(links[0].data)
        assert message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_SENSOR
        assert message.time_usec == 4000 * i


def test_readings_carry_the_time_at_which_they_were_true() -> None:
    bench = Bench()
    bench.run(100)
    now_ns = bench.t_ns
    delays_s: dict[Topic[Any], float] = {
        topics.GNSS: CALM.gnss.delay_s,
        topics.ALTIMETER: CALM.altimeter.delay_s,
        topics.UWB: CALM.uwb.delay_s,
        topics.ROVER_ODOMETRY: CALM.rover_odometry.delay_s,
        topics.IMU: 0.0,
    }
    ages: dict[str, set[int]] = {topic.name: set() for topic in delays_s}
    for _ in range(100):
        outputs = bench.run(1)
        for topic in delays_s:
            ages[topic.name].update(now_ns - m.t_ns for m in published(outputs, topic))
        now_ns = bench.t_ns
    for topic, delay_s in delays_s.items():
        assert ages[topic.name] == {round(1e9 * delay_s)}, topic.name


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    config = SimulatorConfig()
    runs = []
    for seed in (1, 1, 2):
        bench = Bench(config, seed)
        bench.command = 0.52
        runs.append(digest(bench.run(1000)))
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_at_rest_it_is_at_the_origin_whether_on_ground_or_platform() -> None:
    starts: tuple[Literal["ground", "platform"], ...] = ("ground", "platform")
    for start in starts:
        uav = UavConfig(start=start)
        config = msgspec.structs.replace(CALM, uav=uav, rover=RoverConfig(start_yaw_rad=0.0))
        truth = published(Bench(config).run(50), topics.TRUTH)[-1]
        assert truth.pos_uav_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
        assert truth.contact_force_n == pytest.approx(1.5 * 9.81, rel=0.01)
        assert not truth.armed_motors
        if start == "platform":
            assert truth.pos_rover_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
        else:
            assert truth.pos_rover_ned_m[:2] == pytest.approx((5.0, -3.0), abs=1e-3)
            assert truth.pos_rover_ned_m[2] == pytest.approx(-0.5, abs=0.1)


def test_more_than_half_command_takes_off() -> None:
    bench = Bench()
    bench.command = 0.55
    truth = published(bench.run(500), topics.TRUTH)[-1]
    assert truth.armed_motors
    assert truth.pos_uav_ned_m[2] < -1.0
    assert truth.contact_force_n == 0.0


def test_the_altimeter_sees_the_ground_once_it_flies() -> None:
    bench = Bench()
    assert published(bench.run(50), topics.ALTIMETER)[-1].range_m is None
    bench.command = 0.55
    outputs = bench.run(500)
    altimeter, truth = published(outputs, topics.ALTIMETER)[-1], published(outputs, topics.TRUTH)[-1]
    # the lens is 0.1 m above the feet; the reading is 20 ms old at about 2 m/s
    assert altimeter.range_m == pytest.approx(0.1 - truth.pos_uav_ned_m[2], abs=0.2)


def test_a_lost_autopilot_stops_the_motors_but_not_the_time() -> None:
    bench = Bench()
    bench.command = 0.6
    assert published(bench.run(250), topics.TRUTH)[-1].pos_uav_ned_m[2] < -0.5
    bench.up = False
    outputs = bench.run(500)
    verdicts = [o for o in outputs if isinstance(o, Health)]
    assert [v.state for v in verdicts] == ["degraded"]
    truth = published(outputs, topics.TRUTH)[-1]
    assert not truth.armed_motors
    assert truth.pos_uav_ned_m[2] == pytest.approx(0.0, abs=0.05)
    assert truth.t_ns > 2_900_000_000


def test_vehicle_time_that_fell_behind_is_told_at_once() -> None:
    bench = Bench()
    bench.run(2)
    bench.wall_ns += 400_000_000
    clock = published(bench.run(1), topics.CLOCK)[-1]
    assert (clock.t_ns, clock.wall_ns) == (2 * STEP_NS, 2 * STEP_NS + 400_000_000)
    assert len(published(bench.run(250), topics.CLOCK)) == 10


def test_a_new_autopilot_finds_a_new_vehicle_in_a_new_epoch() -> None:
    bench = Bench()
    bench.command = 0.6
    first = published(bench.run(250), topics.CLOCK)[-1].epoch_id
    bench.up = False
    bench.run(3)
    bench.up, bench.count, bench.command = True, 2, None
    outputs = bench.run(50)
    clock = published(outputs, topics.CLOCK)[0]
    assert clock.epoch_id != first
    assert clock.t_ns == 253 * STEP_NS
    truth = published(outputs, topics.TRUTH)[0]
    assert truth.epoch_id == clock.epoch_id
    assert norm(truth.pos_uav_ned_m) < 1e-3
    assert norm(truth.vel_uav_ned_mps) < 1e-3
    assert not truth.armed_motors
    assert all(fix.t_ns >= clock.t_ns for fix in published(outputs, topics.GNSS))
    assert [o.state for o in outputs if isinstance(o, Health)] == ["ok"]


def test_wind_pushes_the_flying_vehicle() -> None:
    """A gale from the north, 10 m/s on 1.5 kg: it drifts south as soon as its feet leave the ground."""
    bench = Bench(SimulatorConfig(wind=WindConfig(mean_mps=10.0, from_deg=0.0, std_gust_mps=0.0)))
    bench.command = 0.55
    truth = published(bench.run(300), topics.TRUTH)[-1]
    assert truth.wind_ned_mps == pytest.approx((-10.0, 0.0, 0.0), abs=1e-9)
    assert truth.vel_uav_ned_mps[0] < -1.0
    assert abs(truth.vel_uav_ned_mps[1]) < 0.1


def test_uwb_and_gnss_agree_with_the_truth() -> None:
    outputs = Bench().run(300)
    truth = published(outputs, topics.TRUTH)[-1]
    tag: Vec3 = (truth.pos_uav_ned_m[0], truth.pos_uav_ned_m[1], truth.pos_uav_ned_m[2] - 0.1)
    mean_m = sum(r.range_m for r in published(outputs, topics.UWB)[-1].ranges) / 4.0
    assert mean_m == pytest.approx(distance(tag, truth.pos_rover_ned_m), abs=0.06)
    fix = published(outputs, topics.GNSS)[-1]
    assert fix.position_deg[2] == pytest.approx(488.1, abs=3.0)


def test_the_shipped_settings_are_the_defaults() -> None:
    assert load_config(SimulatorConfig, "simulator") == SimulatorConfig()
    config = SimulatorConfig()
    rates: dict[Topic[Any], float] = {
        topics.IMU: config.imu.rate_hz,
        topics.GNSS: config.gnss.rate_hz,
        topics.BARO: config.barometer.rate_hz,
        topics.MAG: config.magnetometer.rate_hz,
        topics.ALTIMETER: config.altimeter.rate_hz,
        topics.UWB: config.uwb.rate_hz,
        topics.ROVER_ODOMETRY: config.rover_odometry.rate_hz,
    }
    for topic, rate_hz in rates.items():
        assert topic.rate_hz == rate_hz, topic.name


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("[wind]\nmean_mp = 3.0", "mean_mp"),
        ("[wind]\nmean_mps = -1.0", "wind.mean_mps"),
        ("[uav]\ntau_motor_s = nan", "uav.tau_motor_s"),
        ('[uav]\nstart = "moon"', "uav.start"),
        ("[gnss]\ndelay_s = 5.0", "gnss.delay_s"),
    ],
)
def test_a_bad_setting_is_refused_by_its_name(tmp_path: Any, text: str, names: str) -> None:
    (tmp_path / "simulator.toml").write_text(text)
    with pytest.raises(ConfigError, match=names):
        load_config(SimulatorConfig, "simulator", tmp_path)


def test_a_schedule_keeps_its_rate_where_the_period_is_no_multiple_of_the_step() -> None:
    """20 Hz in steps of 4 ms: 12 or 13 steps apart."""
    schedule = Schedule[None](20.0)
    due = [i for i in range(2500) if schedule.due(i * STEP_NS)]
    assert len(due) == 200
    assert {b - a for a, b in pairwise(due)} == {12, 13}


def test_a_schedule_delays_readings_and_keeps_their_order() -> None:
    schedule = Schedule[str](100.0, delay_s=0.02)
    schedule.put(0, "first")
    schedule.put(10_000_000, "second")
    assert schedule.arrived(16_000_000) is None
    assert schedule.arrived(30_000_000) == "first"
    assert schedule.arrived(30_000_000) == "second"
    assert schedule.arrived(30_000_000) is None


def test_each_exposure_has_its_scene_in_the_map_where_vehicle_and_rover_are() -> None:
    config = SimulatorConfig(uav=UavConfig(start="platform"))
    scenes = published(Bench(config).run(250), topics.SCENE)
    assert len(scenes) == 15
    assert scenes[-1].pos_rover_ned_m[:2] == pytest.approx((config.rover.start_north_m, config.rover.start_east_m))
    above_m = scenes[-1].pos_rover_ned_m[2] - scenes[-1].pos_uav_ned_m[2]
    assert above_m == pytest.approx(VEHICLE.airframe.height_stand_m, abs=0.02)


def test_the_ground_below_the_standing_vehicle_is_at_height_zero_in_the_frame_of_the_truth() -> None:
    ground = ground_of(CALM)
    north_m, east_m, down_m = ground.corner_ned_m
    row, column = round(-north_m / ground.spacing_m), round(-east_m / ground.spacing_m)
    assert 0.001 * ground.heights_mm[row][column] - down_m == pytest.approx(0.0, abs=0.01)
    assert len(ground.rocks) == CALM.terrain.rocks
    assert len(encode(ground)) < 100_000


def test_the_ground_of_a_vehicle_that_starts_on_the_platform_is_below_its_origin() -> None:
    ground = ground_of(msgspec.structs.replace(CALM, uav=UavConfig(start="platform")))
    on_ground = ground_of(CALM)
    rover = CALM.rover
    assert ground.heights_mm == on_ground.heights_mm
    moved_m = [a - b for a, b in zip(on_ground.corner_ned_m, ground.corner_ned_m, strict=True)]
    assert moved_m[:2] == pytest.approx([rover.start_north_m, rover.start_east_m], abs=0.01)
    row = round((-ground.corner_ned_m[0]) / ground.spacing_m)
    column = round((-ground.corner_ned_m[1]) / ground.spacing_m)
    above_m = ground.corner_ned_m[2] - 0.001 * ground.heights_mm[row][column]
    assert above_m == pytest.approx(VEHICLE.platform.height_m, abs=0.05)


def ground_of(config: SimulatorConfig) -> Ground:
    """The reply to a request for the ground."""
    bench = Bench(config)
    bench.run(1)
    bench.pending = (Request(4, "someone", GetGround()),)
    replies = [output for output in bench.run(1) if isinstance(output, Reply)]
    assert [reply.request_id for reply in replies] == [4]
    ground = replies[0].payload
    assert isinstance(ground, Ground)
    return ground
