"""The simulated world of one vehicle: what is in it, and requests that change it."""

from math import radians
from typing import Literal

from jezero.client.errors import Refused, TimedOut, Unreachable
from jezero.client.session import Connection
from jezero.client.status import REPLY_TIMEOUT_S
from jezero.schemas.simulator import (
    SPEED_MIN,
    Change,
    ControlSimulator,
    FaultKind,
    FaultUnit,
    PauseWorld,
    PlaceBody,
    ResetWorld,
    ResumeWorld,
    SetFault,
    SetSpeed,
    SetWind,
    SimulatorReply,
    SimulatorState,
    StepWorld,
)
from jezero.schemas.topics import CONTROL_SIMULATOR


class SimulatedWorld:
    """The simulated world of one vehicle, the attribute `Vehicle.simulator`.

    Each method returns the state of the world after the change. It raises `Refused` with the reason, `Unreachable` for
    a vehicle without a simulator, `TimedOut` without a reply, and `ValueError` for a number that is NaN or infinite.

    Positions are metres north and east of where the vehicle started.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def state(self) -> SimulatorState:
        """What is in the world: vehicle, rover, wind, faults, and the speed of vehicle time."""
        return self._request(None)

    def reset(self) -> SimulatorState:
        """Put vehicle and rover back to their start, in a new epoch: goals end, faults too."""
        return self._request(ResetWorld())

    def place(
        self,
        north_m: float,
        east_m: float,
        *,
        height_m: float = 0.0,
        yaw_deg: float | None = None,
        what: Literal["vehicle", "rover"] = "vehicle",
    ) -> SimulatorState:
        """Put the vehicle or the rover somewhere, at rest.

        A vehicle whose motors stand still is put on the ground, one that flies to a height of 1 m or more.

        Args:
            height_m: height of the vehicle above the ground.
            yaw_deg: heading, clockwise from north; None keeps the present one.
            what: "vehicle" or "rover".
        """
        yaw_rad = None if yaw_deg is None else radians(yaw_deg)
        return self._request(PlaceBody(what=what, north_m=north_m, east_m=east_m, height_m=height_m, yaw_rad=yaw_rad))

    def wind(self, mean_mps: float, from_deg: float, *, std_gust_mps: float | None = None) -> SimulatorState:
        """Change the wind.

        Args:
            from_deg: direction from which it blows, clockwise from north.
            std_gust_mps: standard deviation of the gusts; None keeps the present one.
        """
        return self._request(SetWind(mean_mps=mean_mps, from_deg=from_deg, std_gust_mps=std_gust_mps))

    def fault(
        self, unit: FaultUnit, kind: FaultKind | Literal["ok"], *, instance: int = 0, for_s: float | None = None
    ) -> SimulatorState:
        """Begin a fault, or end it with the kind "ok": `uav.simulator.fault("gps", "off", for_s=10.0)`.

        Args:
            unit: what fails, see `jezero.schemas.simulator.FAULTS`.
            kind: how it fails.
            instance: which motor, or which anchor of "uwb", counted from 1; 0 is all of them.
            for_s: vehicle time after which it ends; None until it is ended.
        """
        return self._request(SetFault(unit=unit, kind=kind, instance=instance, duration_s=for_s))

    def pause(self) -> SimulatorState:
        """Stop vehicle time: everything waits."""
        return self._request(PauseWorld())

    def resume(self) -> SimulatorState:
        """Let vehicle time go on."""
        return self._request(ResumeWorld())

    def step(self, duration_s: float = 1.0) -> SimulatorState:
        """Let a paused vehicle time go on for a duration; returns when it is over."""
        return self._request(StepWorld(duration_s=duration_s), REPLY_TIMEOUT_S + 2.0 * max(0.0, duration_s) / SPEED_MIN)

    def speed(self, factor: float) -> SimulatorState:
        """Change the speed of vehicle time: 1 is real time. The field `speed_reached` is what this computer does."""
        return self._request(SetSpeed(speed=factor))

    def _request(self, change: Change | None, timeout_s: float = REPLY_TIMEOUT_S) -> SimulatorState:
        try:
            reply: SimulatorReply = self._connection.request(CONTROL_SIMULATOR, ControlSimulator(do=change), timeout_s)
        except Unreachable:
            if not self._connection.connected or not self._connection.sees_bridge():
                raise
            raise Unreachable(
                f"{self._connection.vehicle} has no simulator: its stack runs without one, as that of a real vehicle "
                "does (`jezero ps`)"
            ) from None
        except TimedOut:
            raise TimedOut(
                f"the simulator of {self._connection.vehicle} did not reply within {timeout_s:g} s; it replies from "
                "the first connection of an autopilot on (`jezero ps`)"
            ) from None
        if not reply.accepted or reply.state is None:
            raise Refused(reply.reason)
        return reply.state
