"""Steps of the autopilot's position estimate, by reset counter."""

from collections import deque

from jezero.frames import Vec3, add, scale, subtract

HISTORY = 32
"""Number of resets that are kept; a setpoint computed before them is dropped."""


class ResetHistory:
    """Sum of the autopilot's position steps, which moves a point given before a reset to where it is now.

    Attributes:
        counter: the autopilot's reset counter, unwrapped from its eight bits; -1 before the first odometry.
        offset_ned_m: sum of all steps since the first odometry.
    """

    def __init__(self) -> None:
        self.counter = -1
        self.offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._history: deque[tuple[int, Vec3]] = deque(maxlen=HISTORY)
        self._last: tuple[int, Vec3, Vec3] | None = None

    def update(self, t_ns: int, counter_u8: int, pos_ned_m: Vec3, vel_ned_mps: Vec3) -> Vec3 | None:
        """Update with one odometry.

        Args:
            counter_u8: the counter as MAVLink carries it, 0–255.
        Returns:
            The step (3,) in m, NED, when this odometry is the first after a reset, else None. The step is the change
            of position that the vehicle's velocity doesn't explain.
        """
        last = self._last
        self._last = (t_ns, pos_ned_m, vel_ned_mps)
        if last is None:
            self.counter = counter_u8
            self._history.append((self.counter, self.offset_ned_m))
            return None
        resets = (counter_u8 - self.counter) % 256
        if resets == 0:
            return None
        expected = add(last[1], scale(last[2], (t_ns - last[0]) * 1e-9))
        step = subtract(pos_ned_m, expected)
        self.counter += resets
        self.offset_ned_m = add(self.offset_ned_m, step)
        self._history.append((self.counter, self.offset_ned_m))
        return step

    def step_since(self, counter: int) -> Vec3 | None:
        """Sum of the steps (3,) in m, NED, since `counter`; None when that counter is unknown."""
        if counter == self.counter:
            return (0.0, 0.0, 0.0)
        for known, offset_ned_m in reversed(self._history):
            if known == counter:
                return subtract(self.offset_ned_m, offset_ned_m)
        return None
