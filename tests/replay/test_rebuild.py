"""Services made again from their recorded arguments."""

import pytest

from jezero.recording import RecordingError
from jezero.replay.rebuild import make_service


def test_a_service_is_made_from_its_recorded_arguments() -> None:
    service = make_service("rover", {"address": "here:4810"})
    assert service.spec.made_with == {"address": "here:4810"}


def test_a_server_of_an_action_is_made_by_its_name() -> None:
    assert make_service("takeoff", {"name": "takeoff", "boot_id": 1}).spec.name == "takeoff"


@pytest.mark.parametrize(
    ("name", "made_with", "sentence"),
    [
        ("blank_camera", {}, "'blank_camera' is neither an action server nor a service that this version can replay"),
        ("spiral", {"name": "spiral", "boot_id": 1}, "there is no action 'spiral'.*Is the package that adds it instal"),
        ("ground_station", {}, "can't make 'ground_station' without health: not recorded"),
        ("estimator", {"config": {}}, "can't make 'estimator' without vehicle: not recorded"),
        ("rover", {"address": "here:1", "host": "x"}, "makes 'rover' without the recorded argument 'host'"),
    ],
)
def test_what_can_not_be_made_is_refused_in_one_sentence(
    name: str, made_with: dict[str, object], sentence: str
) -> None:
    with pytest.raises(RecordingError, match=sentence):
        make_service(name, made_with)
