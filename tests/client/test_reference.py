"""The page of the Python client lists what a program gets from it."""

from jezero import aio
from jezero.cli.reference.python import names, page
from jezero.client.camera import Camera
from jezero.client.goal import Goal
from jezero.client.images import ImagesGoal, Picture
from jezero.client.rover import Leg, Rover
from jezero.client.subscription import Subscription
from jezero.client.vehicle import Vehicle
from jezero.schemas.sensors import CameraFrame, CameraPreview

LISTED = names()


def test_every_class_that_a_program_gets_from_a_vehicle_is_on_the_page() -> None:
    asynchronous = (aio.Vehicle, aio.Goal, aio.ImagesGoal, aio.Camera, aio.Subscription, aio.Rover)
    for found in (
        Vehicle,
        Goal,
        ImagesGoal,
        Picture,
        Camera,
        CameraFrame,
        CameraPreview,
        Subscription,
        Rover,
        Leg,
        *asynchronous,
    ):
        assert f"{found.__module__}.{found.__qualname__}" in LISTED


def test_a_method_has_its_signature_with_units_and_its_arguments_in_words() -> None:
    chapter = page().partition("#### Vehicle.takeoff\n")[2].partition("####")[0]
    assert "    altitude_m: float = 2.0,\n    *,\n" in chapter and ") -> Goal[MoveFeedback, MoveResult]\n" in chapter
    assert "Take off.\n\n**Args**\n\n- `altitude_m`: altitude above the take-off point, positive up.\n" in chapter


def test_a_method_that_a_base_class_or_a_thread_has_is_described_too() -> None:
    text = page()
    assert "async get_images(" in text or "async hover(" in text
    for name in ("Vehicle.go_to", "Vehicle.hover", "Goal.result", "ImagesGoal.pictures", "Recording.table"):
        assert f"#### {name}\n" in text
    assert "### jezero.base.frames.quat_rotate\n" in text and ":::" not in text
