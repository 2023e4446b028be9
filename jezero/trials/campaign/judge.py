"""The rules that hold in every flight, restated from the specification, and the collection of their violations.

The judges read no service's internals: they check the inputs and outputs on the bus and on MAVLink, and the truth.
"""

from collections import Counter
from dataclasses import dataclass
from math import cos, degrees, radians

import msgspec

from jezero.base.frames import norm, tilt_from_quat
from jezero.schemas import topics
from jezero.schemas.state import StatusCode as Code
from jezero.schemas.state import Truth
from jezero.schemas.units import NS_PER_S

VIOLATIONS_PER_RULE_MAX = 5
UPSIDE_DOWN_COS = cos(radians(90.0))
IN_PROGRESS = (Code.TAKEOFF, Code.GO_TO, Code.GET_IMAGES, Code.LANDING, Code.COVERAGE, Code.ACTION)
ALLOWED: frozenset[tuple[Code, Code]] = frozenset(
    [
        # 0 -> 1 -> 2 -> 3
        (Code.IDLE, Code.TAKEOFF),
        (Code.TAKEOFF, Code.TAKEOFF_DONE),
        (Code.TAKEOFF_DONE, Code.HOVER),
        # 0 -> 1 -> 4
        (Code.TAKEOFF, Code.GO_TO),
        # 3 -> {4, 6, 8, 10, 14}
        (Code.HOVER, Code.GO_TO),
        (Code.HOVER, Code.GET_IMAGES),
        (Code.HOVER, Code.LANDING),
        (Code.HOVER, Code.COVERAGE),
        (Code.HOVER, Code.ACTION),
        # 4, 6, 10, 14 -> done -> 3
        (Code.GO_TO, Code.GO_TO_DONE),
        (Code.GO_TO_DONE, Code.HOVER),
        (Code.GET_IMAGES, Code.GET_IMAGES_DONE),
        (Code.GET_IMAGES_DONE, Code.HOVER),
        (Code.COVERAGE, Code.COVERAGE_DONE),
        (Code.COVERAGE_DONE, Code.HOVER),
        (Code.ACTION, Code.ACTION_DONE),
        (Code.ACTION_DONE, Code.HOVER),
        # 8 -> 9 -> 0
        (Code.LANDING, Code.LANDING_DONE),
        (Code.LANDING_DONE, Code.IDLE),
        # {1, 4, 6, 8, 10, 14} -> 12 -> {3, 0}
        *((code, Code.ABORT) for code in IN_PROGRESS),
        (Code.ABORT, Code.HOVER),
        (Code.ABORT, Code.IDLE),
        # any -> 13 -> {0, 3}
        *((code, Code.EXTERNAL) for code in Code if code is not Code.EXTERNAL),
        (Code.EXTERNAL, Code.IDLE),
        (Code.EXTERNAL, Code.HOVER),
    ]
)
"""Allowed transitions of the status code."""


@dataclass(frozen=True)
class Violation:
    """One violation of a rule.

    Attributes:
        t_s: virtual time.
        rule: the rule that was broken.
        text: details, with numbers.
    """

    t_s: float
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.t_s:.3f} s: {self.rule}: {self.text}"


class Judge:
    """Collects violations, the first few of each rule, and counts the status codes reached.

    Attributes:
        violations: the violations so far.
        states: number of times that each status was reached, by its name.
    """

    def __init__(self) -> None:
        self.violations: list[Violation] = []
        self.states: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()

    def check(self, holds: bool, t_ns: int, rule: str, text: str) -> None:
        """Record a violation of `rule` unless it holds."""
        if holds:
            return
        self._counts[rule] += 1
        if self._counts[rule] <= VIOLATIONS_PER_RULE_MAX:
            self.violations.append(Violation(t_ns / NS_PER_S, rule, text))


class TruthJudge:
    """Observer of a bus that checks the vehicle's true attitude.

    Attributes:
        truth: the latest truth.
        falls_in_epoch: epoch in which the autopilot was killed: the vehicle may fall in any attitude until its respawn.
    """

    def __init__(self, judge: Judge) -> None:
        self.truth: Truth | None = None
        self.falls_in_epoch: int | None = None
        self._judge = judge
        self._decoder = msgspec.json.Decoder(Truth)

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic != topics.TRUTH.name:
            return
        self.truth = truth = self._decoder.decode(data)
        tilt_rad = tilt_from_quat(truth.q_ned_from_frd)
        upright = cos(tilt_rad) > UPSIDE_DOWN_COS or truth.epoch_id == self.falls_in_epoch
        self._judge.check(upright, t_ns, "never upside down", f"tilted by {degrees(tilt_rad):.0f} degrees")

    @property
    def speed_mps(self) -> float:
        return 0.0 if self.truth is None else norm(self.truth.vel_uav_ned_mps)
