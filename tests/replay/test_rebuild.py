"""Services made again from their recorded arguments."""

import pytest

from jezero.recording import RecordingError
from jezero.recording.journals import ServiceRun
from jezero.replay.rebuild import make_service


def recorded(name: str, made_with: dict[str, object], made_by: str = "jezero.services") -> ServiceRun:
    return ServiceRun(name, 1, made_with, f"{made_by}:Service")


def test_a_service_is_made_from_its_recorded_arguments() -> None:
    service = make_service(recorded("rover", {"address": "here:4810"}), {})
    assert service.spec.made_with == {"address": "here:4810"}


def test_a_server_of_an_action_is_made_by_its_name() -> None:
    assert make_service(recorded("takeoff", {"name": "takeoff", "boot_id": 1}), {}).spec.name == "takeoff"


def test_gravity_and_air_of_an_older_recording_are_the_vehicles() -> None:
    """They were settings of the simulator."""
    settings = {"config": {"gravity_mps2": 9.7, "density_air_kgpm3": 1.1, "pace": 0.5}, "vehicle": {}}
    made = make_service(recorded("simulator", {**settings, "seed": 1, "boot_id": 1}), {})
    planet = made.spec.made_with["vehicle"].planet
    assert (planet.gravity_mps2, planet.density_air_kgpm3) == (9.7, 1.1)
    assert made.spec.made_with["config"].pace == 0.5


@pytest.mark.parametrize(
    ("name", "made_with", "sentence"),
    [
        ("blank_camera", {"seed": 1}, "the recorded 'blank_camera' is not jezero's: name its class with --class"),
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
        make_service(recorded(name, made_with), {})
