"""A mission with its progress, as it is kept over a restart of the service."""

from typing import Any

import msgspec
from msgspec.structs import replace

from jezero.schemas.mission import FailurePolicy, GoalStep, Mission, MissionProgress, MissionState, Step
from jezero.schemas.struct import TEXT_MAX

ENDED: frozenset[MissionState] = frozenset({"idle", "succeeded", "failed", "stopped"})


class MissionRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One mission, and how far it is.

    Attributes:
        mission: the mission.
        mission_id: its id.
        state: as in `MissionProgress`.
        reason: as in `MissionProgress`.
        index: index of the present step, counted from 0.
        attempt: number of the present try of the step, counted from 1; ids of goals contain it.
        epoch_id: epoch of the vehicle that flies it, see `Clock`; 0 until it is known.
        failures: number of failed tries of the present step.
        rest: fields of the goal that takes the images that are still missing, or the rest of a wait; None for the whole
            step.
        left_out: number of steps that were left out.
        last: goal that is flown after a failure, before the mission ends; None while the steps are flown.
        failed_attempt: number of the step's try whose failure made `last` fly; 0 while the steps are flown.
        failure: why the mission fails once its last goal has ended; the reason may change meanwhile.
        altitude_m: altitude over the world's origin at which the mission was held, to which a vehicle that has landed
            since takes off before the mission goes on; None for a mission that goes on where it is.
        step_altitude_m: altitude over the world's origin at which the present step began in flight, for a mission that
            was not held before it ended or the stack was restarted; None on the ground.
    """

    mission: Mission
    mission_id: str
    state: MissionState = "running"
    reason: str = ""
    index: int = 0
    attempt: int = 1
    epoch_id: int = 0
    failures: int = 0
    rest: dict[str, Any] | None = None
    last: GoalStep | None = None
    failed_attempt: int = 0
    failure: str = ""
    altitude_m: float | None = None
    step_altitude_m: float | None = None
    left_out: int = 0

    @property
    def ended(self) -> bool:
        """Whether the mission is over."""
        return self.state in ENDED

    @property
    def step(self) -> Step:
        """The present step."""
        return self.last or self.mission.steps[self.index]

    @property
    def policy(self) -> FailurePolicy:
        """Reaction to a failure of the present step."""
        return self.step.on_failure if isinstance(self.step, GoalStep) else FailurePolicy()

    @property
    def goal_id(self) -> str:
        """Id of the goal of the present try. It is the same after a restart of this service: a goal that still flies is
        found again, and one that is over isn't flown twice. No other try of the mission has it."""
        place = f"end.{self.index + 1}.{self.failed_attempt}" if self.last else f"{self.index + 1}"
        return f"{self.mission_id}.{place}.{self.attempt}"

    def in_state(self, state: MissionState, reason: str = "") -> "MissionRecord":
        """The same mission in another state."""
        return replace(self, state=state, reason=reason)

    def next_step(self) -> "MissionRecord":
        """The mission after its present step: at the next step, or at its end."""
        if self.last is not None:
            return self.in_state("failed", self.failure)
        if self.index + 1 == len(self.mission.steps):
            return self.in_state("succeeded", self.left_out_in_words)
        return replace(
            self,
            index=self.index + 1,
            attempt=1,
            failures=0,
            rest=None,
            step_altitude_m=None,
            state="running",
            reason="",
        )

    def without_step(self, reason: str = "") -> "MissionRecord":
        """The mission after a step that is left out."""
        following = replace(self, left_out=self.left_out + 1).next_step()
        return following if following.ended else replace(following, reason=reason)

    @property
    def left_out_in_words(self) -> str:
        """How many steps were left out, for people, or ""."""
        return f"{self.left_out} of {len(self.mission.steps)} steps left out" if self.left_out else ""

    def again(self) -> "MissionRecord":
        """A mission that has failed, at another try of the step that failed, with whatever vehicle there is now."""
        altitude_m = self.altitude_m if self.altitude_m is not None else self.step_altitude_m
        return replace(
            self,
            state="running",
            reason="",
            attempt=(self.attempt if self.last is None else self.failed_attempt) + 1,
            failures=0,
            last=None,
            failed_attempt=0,
            epoch_id=0,
            altitude_m=altitude_m,
        )

    def from_ground(self, *, armed: bool) -> "MissionRecord":
        """The mission after a landing that nobody has seen, with the altitude of the takeoff before its step.

        Args:
            armed: the motors run, so that a goal may still be in charge; else the one that flew before is over, and its
                result must not count for the next one.
        """
        record = self if armed or self.step_altitude_m is None else self.next_attempt(None)
        return replace(record, altitude_m=self.step_altitude_m)

    def next_attempt(self, rest: dict[str, Any] | None) -> "MissionRecord":
        """The mission at the next try of its present step.

        Args:
            rest: fields of the goal that does what is still missing; None tries the same as before.
        """
        return replace(self, attempt=self.attempt + 1, rest=self.rest if rest is None else rest)

    def message(self, t_ns: int, goal_id: str) -> MissionProgress:
        """The progress for the topic."""
        return MissionProgress(
            t_ns=t_ns,
            state=self.state,
            reason=self.reason[:TEXT_MAX],
            mission_id=self.mission_id,
            name=self.mission.name,
            step=self.index + 1,
            steps=len(self.mission.steps),
            label=self.step.label,
            attempt=self.attempt,
            goal_id=goal_id,
            left_out=self.left_out,
        )
