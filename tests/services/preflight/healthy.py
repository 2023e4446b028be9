"""Readings of a healthy vehicle that stands on the rover, from which each test changes what it is about."""

import random
from math import cos, sin
from typing import Any

import msgspec

from jezero.base.frames import quat_from_euler
from jezero.schemas.estimate import SetParameters, TagEstimate
from jezero.schemas.fence import FenceState
from jezero.schemas.health import ServiceHealth
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import Altimeter, Barometer, Gnss, Imu, Magnetometer, RoverOdometry, Uwb, UwbRange
from jezero.schemas.state import Battery, Clock, Odometry, Status
from jezero.schemas.topics import (
    ALTIMETER,
    BARO,
    CLOCK,
    ESTIMATE_TAG,
    FENCE,
    GNSS,
    IMU,
    MAG,
    ROVER_ODOMETRY,
    STATUS,
    UWB,
)
from jezero.services.preflight.readings import Readings
from jezero.services.preflight.service import checked_services

END_NS = 5_000_000_000
DURATION_S = 1.0
ORIGIN_DEG = (47.397742, 8.545594, 488.0)
PARAMETERS = SetParameters(std_altimeter_m=0.03, std_uwb_m=0.02)
HEARD = frozenset(t.name for t in (IMU, GNSS, BARO, MAG, ALTIMETER, UWB, ROVER_ODOMETRY))


def times_ns(topic: Topic[Any]) -> list[int]:
    """Times of a second of messages; the newest is one period old."""
    count = int(DURATION_S * (topic.rate_hz or 1.0))
    return [END_NS - int((count - i) / (topic.rate_hz or 1.0) * 1e9) for i in range(count)]


def health(service: str, state: Any = "ok", text: str = "well", room_bytes: int | None = None) -> ServiceHealth:
    return ServiceHealth(t_ns=END_NS, service=service, boot_id=1, state=state, text=text, room_bytes=room_bytes)


def status(**changes: Any) -> Status:
    odometry = Odometry(
        t_ns=END_NS - 50_000_000,
        epoch_id=1,
        pos_uav_ned_m=(0.0, 0.0, 0.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=quat_from_euler(0.0, 0.0, 0.5),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
        origin_deg=ORIGIN_DEG,
        std_pos_m=0.3,
    )
    plain = Status(
        t_ns=END_NS - 50_000_000,
        code=0,
        name="IDLE",
        odometry=odometry,
        armed=False,
        landed=True,
        autopilot_mode="AUTO.LOITER",
        in_charge="none",
        bridge_boot_id=1,
        ready=True,
        battery=Battery(voltage_v=16.2, remaining=0.9, critical=0.07),
    )
    return msgspec.structs.replace(plain, **changes)


def clocks(rate: float = 1.0) -> tuple[Clock, ...]:
    """Clocks of a second of vehicle time that runs at a rate against wall time."""
    return tuple(Clock(t_ns=t_ns, epoch_id=1, wall_ns=int(t_ns / rate)) for t_ns in times_ns(CLOCK))


def imu(std_acc_mps2: float = 0.05, std_gyro_rps: float = 0.004) -> tuple[Imu, ...]:
    noise = random.Random(1)
    return tuple(
        Imu(
            t_ns=t_ns,
            acc_imu_frd_mps2=(noise.gauss(0.0, std_acc_mps2), 0.0, -9.81),
            gyro_imu_frd_rps=(0.0, noise.gauss(0.0, std_gyro_rps), 0.0),
        )
        for t_ns in times_ns(IMU)
    )


def gnss(satellites: int = 14) -> tuple[Gnss, ...]:
    return tuple(
        Gnss(
            t_ns=t_ns,
            position_deg=ORIGIN_DEG,
            vel_uav_ned_mps=(0.0, 0.0, 0.0),
            std_horizontal_m=0.4,
            std_vertical_m=0.5,
            satellites=satellites,
        )
        for t_ns in times_ns(GNSS)
    )


def mag(error_rad: float = 0.05, std_gauss: float = 0.003) -> tuple[Magnetometer, ...]:
    """Fields whose north lies east of the autopilot's north, which turns the vehicle by 0.5 rad."""
    noise, angle = random.Random(2), error_rad - 0.5
    return tuple(
        Magnetometer(t_ns=t_ns, field_frd_gauss=(0.2 * cos(angle) + noise.gauss(0.0, std_gauss), 0.2 * sin(angle), 0.4))
        for t_ns in times_ns(MAG)
    )


def baro(std_pa: float = 2.0) -> tuple[Barometer, ...]:
    noise = random.Random(5)
    return tuple(
        Barometer(
            t_ns=t_ns,
            pressure_pa=70_000.0 + noise.gauss(0.0, std_pa),
            altitude_pressure_m=3000.0,
            temperature_degc=15.0,
        )
        for t_ns in times_ns(BARO)
    )


def altimeter(std_m: float = 0.02) -> tuple[Altimeter, ...]:
    noise = random.Random(3)
    return tuple(Altimeter(t_ns=t_ns, range_m=abs(0.5 + noise.gauss(0.0, std_m))) for t_ns in times_ns(ALTIMETER))


def uwb(std_m: float = 0.01, speed_rover_mps: float = 0.0, outliers_m: float = 0.0) -> tuple[Uwb, ...]:
    """Ranges to two anchors; one in ten is an outlier."""
    noise = random.Random(4)
    found = []
    for i, t_ns in enumerate(times_ns(UWB)):
        range_m = 5.0 + speed_rover_mps * i / (UWB.rate_hz or 1.0) + (outliers_m if i % 10 == 5 else 0.0)
        ranges = tuple(
            UwbRange(t_ns=t_ns, anchor=anchor, pos_anchor_rover_body_m=(0.3, 0.0, 0.0), range_m=r)
            for anchor, r in enumerate((range_m + noise.gauss(0.0, std_m), range_m + noise.gauss(0.0, std_m)))
        )
        found.append(Uwb(t_ns=t_ns, ranges=ranges))
    return tuple(found)


def rover(yaw_rad: float = 0.5) -> tuple[RoverOdometry, ...]:
    return tuple(
        RoverOdometry(
            t_ns=t_ns,
            pos_odom_m=(0.0, 0.0),
            yaw_rover_rad=yaw_rad,
            speed_rover_body_mps=0.0,
            yaw_rate_rover_rps=0.0,
        )
        for t_ns in times_ns(ROVER_ODOMETRY)
    )


def tags(yaw_rad: float | None = 0.5) -> tuple[TagEstimate, ...]:
    return tuple(
        TagEstimate(
            t_ns=t_ns,
            tag_ids=(0,),
            pos_uav_rel_rover_ned_m=(0.0, 0.0, -1.0),
            cov_pos_ned_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4),
            range_m=1.0,
            yaw_rover_rad=yaw_rad,
            reprojection_px=0.2,
        )
        for t_ns in times_ns(ESTIMATE_TAG)
    )


def readings(messages: dict[str, tuple[Any, ...]] | None = None, **changes: Any) -> Readings:
    """Readings of a healthy vehicle.

    Args:
        messages: messages of the topics that the test changes.
        changes: other fields that it changes.
    """
    healthy = {
        STATUS.name: (status(),),
        CLOCK.name: clocks(),
        IMU.name: imu(),
        GNSS.name: gnss(),
        BARO.name: baro(),
        MAG.name: mag(),
        ALTIMETER.name: altimeter(),
        UWB.name: uwb(),
        ROVER_ODOMETRY.name: rover(),
        ESTIMATE_TAG.name: tags(),
        FENCE.name: (FenceState(t_ns=END_NS),),
    }
    services = (*checked_services(), "land_on_spot")
    fields: dict[str, Any] = {
        "t_ns": END_NS,
        "duration_s": DURATION_S,
        "health": {name: health(name, room_bytes=50_000_000_000) for name in services},
        "heard": HEARD,
        "heard_services": frozenset(services),
        "parameters": PARAMETERS,
    }
    return Readings(messages=healthy | (messages or {}), **(fields | changes))
