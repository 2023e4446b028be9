"""Missions: lists of goals that the mission service flies, and their progress."""

from typing import Annotated, Any, Literal

from msgspec import Meta

from jezero.schemas.struct import Message, Name, Payload, RallyPoints, Text

STEPS_MAX = 1000
WAIT_MAX_S = 3600.0


class FailurePolicy(Payload, frozen=True, kw_only=True):
    """Reaction to a step that fails: that is refused, or ends by itself before it is done.

    A goal that loses control to a person or to a failsafe doesn't fail: the mission is interrupted, and waits for a
    person.

    Attributes:
        retries: how many times the step is tried again first. A coverage goes on with the first image not taken.
        then: what follows the last try: `stop` hovers, `skip` goes on with the next step, `return` flies home,
            `land` lands here. All but `skip` end the mission.
    """

    retries: Annotated[int, Meta(ge=0, le=10)] = 0
    then: Literal["stop", "skip", "return", "land"] = "stop"


class GoalStep(Payload, frozen=True, kw_only=True, tag_field="kind", tag="goal"):
    """A step that flies a goal.

    Attributes:
        label: what the step does, for people.
        action: name of the action.
        goal: fields of the goal, as in the action's description; ids and times are chosen by the mission service.
        on_failure: reaction to a failure of this step.
    """

    label: Text
    action: Name
    goal: dict[str, Any]
    on_failure: FailurePolicy = FailurePolicy()


class WaitStep(Payload, frozen=True, kw_only=True, tag_field="kind", tag="wait"):
    """A step that waits, in a hover or on the ground.

    Attributes:
        label: what the step does, for people.
        duration_s: time to wait.
    """

    label: Text
    duration_s: Annotated[float, Meta(ge=0.0, le=WAIT_MAX_S)]


Step = GoalStep | WaitStep


class Mission(Payload, frozen=True, kw_only=True):
    """Request to fly a mission. It goes on when the client that sent it is gone.

    Attributes:
        name: name of the mission, for people.
        steps: steps in their order.
        rally_points_ned_m: north and east of places on the ground where the vehicle may land when it returns during the
            mission, besides those of the settings.
    """

    name: Name
    steps: Annotated[tuple[Step, ...], Meta(min_length=1, max_length=STEPS_MAX)]
    rally_points_ned_m: RallyPoints = ()


class MissionCommand(Payload, frozen=True, kw_only=True):
    """Request about the mission that flies.

    Attributes:
        command: `pause` holds the present step, `resume` goes on with a paused or interrupted mission and tries the
            step of a failed one again, `skip` leaves the present step out and goes on, `stop` ends the mission in a
            hover. `swapped` goes on as `resume` does, after a change of the battery; it is refused while the battery is
            low. A vehicle that has landed takes off again first.
    """

    command: Literal["pause", "resume", "skip", "stop", "swapped"]


class MissionReply(Payload, frozen=True, kw_only=True):
    """Reply to `Mission` and `MissionCommand`.

    Attributes:
        accepted: the mission begins, or the command is carried out.
        reason: reason of a refusal, with what to do instead, for people.
        mission_id: id of the mission; "" for none.
    """

    accepted: bool
    reason: Text = ""
    mission_id: str = ""


MissionState = Literal["idle", "running", "paused", "interrupted", "succeeded", "failed", "stopped"]


class MissionProgress(Message, frozen=True, kw_only=True):
    """Progress of the mission that flies, or of the last one.

    Attributes:
        state: `idle` before the first mission. `paused` by a command. `interrupted` when somebody else took control,
            when the service or the vehicle was restarted, and when the vehicle must return: it waits for `resume`,
            `swapped`, `skip` or `stop`. The last three are ends; `resume` tries the step of a failed mission again.
        reason: why the mission is in this state, for people; "" while all goes as planned.
        mission_id: id of the mission; "" before the first.
        name: name of the mission.
        step: number of the present step, counted from 1; 0 before the first mission.
        steps: number of steps.
        label: what the present step does, for people.
        attempt: number of the present try of the step, counted from 1.
        goal_id: id of the goal that the step flies; "" for none.
        left_out: number of steps that were left out: a mission that succeeded without them has not done all.
    """

    state: MissionState
    reason: Text = ""
    mission_id: str = ""
    name: str = ""
    step: Annotated[int, Meta(ge=0)] = 0
    steps: Annotated[int, Meta(ge=0)] = 0
    label: Text = ""
    attempt: Annotated[int, Meta(ge=0)] = 0
    goal_id: str = ""
    left_out: Annotated[int, Meta(ge=0)] = 0
