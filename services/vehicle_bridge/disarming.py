"""The end of a landing: the motors stop, by force where the landing alone has detected the ground."""

from jezero.services.vehicle_bridge.admission import force_disarm_refusal
from jezero.services.vehicle_bridge.vehicle import Command, VehicleSnapshot
from jezero.vehicle_config import VehicleConfig

DISARM_TIMEOUT_S = 10.0
"""Time-out of a normal disarm on the ground: the autopilot must first detect the ground."""


class Disarming:
    """Chooses the command that stops the motors on the ground.

    Attributes:
        by_force: the finished landing detected the ground, although the autopilot's land detector did not.
    """

    def __init__(self, robot: VehicleConfig) -> None:
        self.by_force = False
        self._robot = robot

    def command(self, vehicle: VehicleSnapshot) -> Command:
        """The command to the autopilot."""
        by_force = self.by_force and not vehicle.landed and not force_disarm_refusal(vehicle, self._robot)
        return Command.FORCE_DISARM if by_force else Command.DISARM

    def overdue_reason(self, vehicle: VehicleSnapshot, elapsed_s: float) -> str:
        """Reason to leave the vehicle to the autopilot, or ""."""
        if elapsed_s <= DISARM_TIMEOUT_S:
            return ""
        return f"the autopilot did not disarm within {elapsed_s:.0f} s: {vehicle.failure_reason}"
