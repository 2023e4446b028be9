"""Drives of the rover: their end, and the files of legs."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, repeat
from pathlib import Path

import pytest

from jezero import TimedOut, Vehicle
from jezero.client import rover
from jezero.client.rover import Leg, Wheel, read_legs
from jezero.schemas import topics
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.state import Clock
from tests.client.rig import Server, endpoint, published, server, vehicle

__all__ = ["endpoint", "server", "vehicle"]

HEADER = "duration_s,speed_mps,yaw_rate_rps\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "drive.csv"
    path.write_text(text)
    return path


def test_a_file_has_one_leg_per_line(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + "10, 0.5, 0\n\n5,-1,0.2\n")
    assert read_legs(path) == [Leg(10.0, 0.5, 0.0), Leg(5.0, -1.0, 0.2)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the first line must be duration_s,speed_mps,yaw_rate_rps"),
        ("1,2,3\n", "the first line must be"),
        (HEADER, "has no line below"),
        (HEADER + "1,2\n", "line 2: '1,2' is not three numbers"),
        (HEADER + "1,1,0\n1,fast,0\n", "line 3"),
        (HEADER + "0,1,0\n", "duration 0 s is not positive"),
        (HEADER + "nan,1,0\n", "duration nan s is not positive"),
        (HEADER + "inf,1,0\n", "duration must be finite"),
        (HEADER + "1,2.5,0\n", "speed 2.5 m/s is not within ±2"),
        (HEADER + "1,nan,0\n", "speed nan m/s"),
        (HEADER + "1,1,-1.5\n", "yaw rate -1.5 rad/s is not within ±1"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ValueError, match=r"drive\.csv") as caught:
        read_legs(written(tmp_path, text))
    assert said in str(caught.value)


@contextmanager
def rolling(server: Server, speeds_mps: Iterator[float], yaw_rate_rps: float = 0.0) -> Iterator[None]:
    """Publish a clock that runs five times as fast as the machine's, and the rover's odometry."""

    def odometry(t_ns: int) -> RoverOdometry:
        return RoverOdometry(
            t_ns=t_ns,
            pos_odom_m=(0.0, 0.0),
            yaw_rover_rad=0.0,
            speed_rover_body_mps=next(speeds_mps),
            yaw_rate_rover_rps=yaw_rate_rps,
        )

    with (
        published(server, lambda number: Clock(t_ns=100_000_000 * number, epoch_id=1, wall_ns=number), topics.CLOCK),
        published(server, odometry, topics.ROVER_ODOMETRY),
    ):
        yield


def test_a_stop_returns_once_the_rover_stands(vehicle: Vehicle, server: Server) -> None:
    published_mps: list[float] = []

    def speeds_mps() -> Iterator[float]:
        for speed_mps in chain([-0.5] * 30, [0.06] * 10, repeat(0.0)):
            published_mps.append(speed_mps)
            yield speed_mps

    with rolling(server, speeds_mps()):
        vehicle.rover.stop()
        assert published_mps[-1] == 0.0
    assert 0.06 in published_mps


@pytest.mark.parametrize(("speed_mps", "yaw_rate_rps"), [(0.4, 0.0), (0.0, 0.4)])
def test_a_rover_that_goes_on_rolling_is_reported_after_a_deadline(
    vehicle: Vehicle, server: Server, speed_mps: float, yaw_rate_rps: float
) -> None:
    with (
        rolling(server, repeat(speed_mps), yaw_rate_rps),
        pytest.raises(TimedOut, match=f"rolls at {speed_mps:.2f} m/s, 10 s after .*does another client drive it"),
    ):
        vehicle.rover.drive(0.5, for_s=0.2)


def test_a_rover_without_odometry_is_not_waited_for(vehicle: Vehicle, server: Server) -> None:
    with published(server, lambda number: Clock(t_ns=100_000_000 * number, epoch_id=1, wall_ns=number), topics.CLOCK):
        vehicle.rover.drive(0.5, for_s=0.2)


def test_a_rover_follows_the_wheel_and_stops_when_nobody_turns_it_any_more(
    vehicle: Vehicle, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rover, "WHEEL_TIMEOUT_S", 0.3)
    commands: list[tuple[float, float]] = []

    def on_command(command: RoverCommand) -> None:
        commands.append((command.speed_rover_body_mps, command.yaw_rate_rover_rps))

    wheel = Wheel()
    wheel.turn(0.5, -0.2)
    with rolling(server, repeat(0.0)), vehicle.subscribe(topics.ROVER_COMMAND, on_command):
        vehicle.rover.steer(wheel)
    assert commands[0] == (0.5, -0.2)
    assert commands[-1] == (0.0, 0.0)


def test_a_wheel_that_is_let_go_has_no_motion_and_one_that_is_turned_too_far_is_refused() -> None:
    wheel = Wheel()
    motions = [wheel.motion]
    wheel.turn(0.5, 0.0)
    motions.append(wheel.motion)
    wheel.release()
    motions.append(wheel.motion)
    assert motions == [None, (0.5, 0.0), None]
    with pytest.raises(ValueError, match="speed 9 m/s is not within"):
        wheel.turn(9.0, 0.0)
