"""No valid message ends a service: each field at the ends of its range, at zero and tiny, in flight.

The bus raises what a service raises.
"""

from collections.abc import Iterable
from typing import Any

import msgspec
import pytest

from jezero.base.codec import BadPayloadError, decode, has_attachment
from jezero.cli.reference.topics import all_specs, all_topics
from jezero.schemas import topics
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, Goal, LandOnSpotGoal, ReturnHomeGoal
from jezero.schemas.rows import Action, Topic
from jezero.schemas.sensors import CameraInfo
from jezero.schemas.state import Odometry
from tests.scenario.extremes import example_of, extreme_messages
from tests.scenario.rig import Flight

READ = {
    topic.name: topic
    for topic in all_topics()
    if not has_attachment(topic.type) and any(topic in (*s.inputs, *s.on_demand) for s in all_specs().values())
}
"""Topics that a service reads. Those with images are left out: their numbers are few, and the images' sizes."""
ENDING = (topics.STATUS.name, topics.CLOCK.name)
"""Topics whose lies end a goal."""


class Stranger:
    """Publishes extreme messages among the true ones of a flight."""

    def __init__(self) -> None:
        self.flight = Flight(3)
        self.newest = {name: example_of(topic.type) for name, topic in READ.items()}
        self._lies = False
        self.flight.bus.observe(self._observe)
        self.flight.take_off(4.0)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if not self._lies:
            self.newest[topic] = data

    def publish(self, topic: Topic[Any], fields: dict[str, Any]) -> None:
        """Publish a message that looks new, and let the services step."""
        newest = msgspec.json.decode(self.newest[topic.name])
        looks_new = {"t_ns": self.flight.bus.t_ns}
        if "sequence" in newest:
            looks_new["sequence"] = newest["sequence"] + 1
        self._lies = True
        self.flight.bus.publish("stranger", topic, msgspec.json.encode(fields | looks_new))
        self._lies = False
        self.flight.bus.run_for(0.02)

    def lies(self, topic: Topic[Any], **options: Any) -> list[dict[str, Any]]:
        """All extreme messages of a topic, like the newest true one in all other fields."""
        return [msgspec.json.decode(lie) for lie in extreme_messages(topic.type, self.newest[topic.name], **options)]


def lie_in_flight(action: Action[Any], goal: Goal, names: Iterable[str]) -> dict[str, int]:
    """Publish all extreme messages of some topics while goals of an action are flown; returns their numbers."""
    stranger, numbers = Stranger(), dict[str, int]()
    for name in names:
        lies = stranger.lies(READ[name])
        numbers[name] = len(lies)
        for number, lie in enumerate(lies):
            if stranger.flight.status.in_charge in ("none", "external", "failsafe"):
                stranger = Stranger()
            if stranger.flight.status.in_charge != "goal" and number % GOAL_AFTER_LIES == 0:
                stranger.flight.bus.send_request(action.endpoint, goal)
                stranger.flight.bus.run_for(0.3)
            stranger.publish(READ[name], lie)
    return numbers


GOAL_AFTER_LIES = 20
"""A goal that the lies have ended is sent again after this many; most are refused, as the estimate needs time."""
GOALS: dict[Action[Any], Goal] = {
    topics.LAND_ON_SPOT: LandOnSpotGoal(),
    topics.RETURN_HOME: ReturnHomeGoal(),
    topics.GET_IMAGES: GetImagesGoal(frame="rover", center_ned_m=(0.0, 0.0, -4.0), radius_m=3.0, num_images=8),
    topics.AREA_COVERAGE: AreaCoverageGoal(
        polygon_ned_m=((0, 0), (12, 0), (12, 12), (0, 12)), z_ned_m=-6.0, overlap=0.5
    ),
}


@pytest.mark.parametrize(
    "action",
    [
        topics.LAND_ON_SPOT,
        pytest.param(topics.RETURN_HOME, marks=pytest.mark.long),
        pytest.param(topics.GET_IMAGES, marks=pytest.mark.long),
        pytest.param(topics.AREA_COVERAGE, marks=pytest.mark.slow),  # takes its images as get_images does
    ],
    ids=lambda action: action.name,
)
def test_no_extreme_message_ends_a_service_in_flight(action: Action[Any]) -> None:
    names = [name for name in READ if name not in ENDING]
    numbers = lie_in_flight(action, GOALS[action], names)
    assert set(numbers) == set(names)
    assert not [name for name, number in numbers.items() if number < 4]


def test_no_extreme_status_and_no_extreme_time_ends_a_service() -> None:
    stranger = Stranger()
    for name in ENDING:
        for lie in stranger.lies(READ[name], keep=()):
            stranger._lies = True
            stranger.flight.bus.publish("stranger", READ[name], msgspec.json.encode(lie))
            stranger._lies = False
            stranger.flight.bus.run_for(0.1)
    assert stranger.flight.status.t_ns > 0


def test_no_extreme_request_ends_a_service() -> None:
    stranger, replied = Stranger(), 0
    for endpoint in (each for each in topics.ENDPOINTS if each is not topics.UNKNOWN_ACTION):
        for request in extreme_messages(endpoint.request_type, example_of(endpoint.request_type), keep=()):
            if stranger.flight.status.in_charge not in ("goal", "hover"):
                stranger = Stranger()
            sent = stranger.flight.bus.send_request(endpoint, decode(endpoint.request_type, request))
            stranger.flight.bus.run_for(0.02)
            replied += bool(sent.replies)
    assert replied > 500


def test_a_camera_without_a_real_focal_length_and_a_vehicle_without_an_attitude_are_refused() -> None:
    info = msgspec.json.decode(example_of(CameraInfo))
    for focal_px in (0.0, 1e-300, -500.0, 1e300):
        with pytest.raises(BadPayloadError, match="focal_px"):
            decode(CameraInfo, msgspec.json.encode(info | {"focal_px": focal_px}))
    odometry = msgspec.json.decode(example_of(Odometry))
    with pytest.raises(BadPayloadError, match="q_ned_from_frd has the length 0"):
        decode(Odometry, msgspec.json.encode(odometry | {"q_ned_from_frd": (0.0, 0.0, 0.0, 0.0)}))
