"""The page of the Python client lists what a program gets from it."""

import pkgutil
import re
from pathlib import Path

from jezero import aio
from jezero.client.camera import Camera
from jezero.client.goal import Goal
from jezero.client.images import ImagesGoal, Picture
from jezero.client.rover import Leg, Rover
from jezero.client.subscription import Subscription
from jezero.client.vehicle import Vehicle
from jezero.schemas.sensors import CameraFrame, CameraPreview

PAGE = (Path(__file__).parents[2] / "docs/reference/python.md").read_text(encoding="utf-8")
LISTED = re.findall(r"^::: (\S+)", PAGE, re.MULTILINE)


def test_every_name_on_the_page_exists() -> None:
    for name in LISTED:
        assert pkgutil.resolve_name(name), name


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
