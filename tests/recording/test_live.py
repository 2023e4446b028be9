"""The live server, with a client on its WebSocket."""

import base64
import json
import time
from collections.abc import Callable, Iterator
from itertools import count

import pytest

from jezero.base.codec import encode
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.images import decompress
from jezero.recording.live import LiveServer, ServeError
from jezero.recording.viewer_scene import ViewerScene
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter, CameraFrame
from tests.recording.foxglove_client import FoxgloveClient

FRAME = CameraFrame(
    t_ns=7, sequence=1, width_px=64, height_px=48, pitch_camera_rad=-1.5, exposure_s=0.004, pixels=bytes([120]) * 9216
)
ALTIMETER = topics.ALTIMETER.name
TIMEOUT_S = 5.0


@pytest.fixture
def server() -> Iterator[LiveServer]:
    with LiveServer("uav1", "127.0.0.1", 0, ViewerScene(VehicleConfig())) as server:
        yield server


@pytest.fixture
def client(server: LiveServer) -> Iterator[FoxgloveClient]:
    with FoxgloveClient(server.port) as client:
        yield client


def receive_until(client: FoxgloveClient, condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline_s, (sorted(client.channels), client.messages.keys())
        client.receive(0.05)


def publish_until(server: LiveServer, client: FoxgloveClient, condition: Callable[[], bool]) -> None:
    """Publish an altimeter message and an image each 0.05 s until a condition holds."""
    times_ns = count(step=50_000_000)

    def published_and_holds() -> bool:
        t_ns = next(times_ns)
        server.publish(t_ns, ALTIMETER, encode(Altimeter(t_ns=t_ns, range_m=2.0)))
        server.publish(t_ns, topics.CAMERA.name, encode(FRAME))
        return condition()

    receive_until(client, published_and_holds)


def test_a_channel_is_announced_with_its_schema_and_sends_messages(server: LiveServer, client: FoxgloveClient) -> None:
    publish_until(server, client, lambda: ALTIMETER in client.channels)
    channel = client.channels[ALTIMETER]
    assert (channel["encoding"], channel["schemaName"]) == ("json", "jezero.Altimeter")
    assert json.loads(channel["schema"])["properties"]["range_m"]["type"] == "number"
    client.subscribe(ALTIMETER)
    publish_until(server, client, lambda: ALTIMETER in client.messages)
    logged_ns, message = client.messages[ALTIMETER][0]
    assert message == {"t_ns": logged_ns, "range_m": 2.0}


def test_the_scene_is_served_too(server: LiveServer, client: FoxgloveClient) -> None:
    publish_until(server, client, lambda: {"viewer/scene", "viewer/transforms"} <= client.channels.keys())
    client.subscribe("viewer/transforms")
    publish_until(server, client, lambda: "viewer/transforms" in client.messages)
    _, message = client.messages["viewer/transforms"][0]
    assert {"map", "frd"} <= {each["parent_frame_id"] for each in message["transforms"]}


def test_images_are_wanted_and_encoded_only_while_somebody_has_subscribed(
    server: LiveServer, client: FoxgloveClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = topics.CAMERA.name
    receive_until(client, lambda: camera in client.channels)  # announced without a message
    assert not server.wants_images
    with monkeypatch.context() as patch:
        patch.setattr("jezero.recording.images.compress", lambda *_: pytest.fail("encoded for nobody"))
        publish_until(server, client, lambda: ALTIMETER in client.channels)
    client.subscribe(camera)
    receive_until(client, lambda: server.wants_images)
    publish_until(server, client, lambda: camera in client.messages)
    _, image = client.messages[camera][0]
    assert client.channels[camera]["schemaName"] == "foxglove.CompressedImage"
    assert base64.b64decode(image["data"]).startswith(b"\xff\xd8")
    assert decompress(json.dumps(image).encode()).shape == (48, 64, 3)
    client.unsubscribe(camera)
    receive_until(client, lambda: not server.wants_images)


def test_a_port_in_use_is_refused_with_its_number(server: LiveServer) -> None:
    with pytest.raises(ServeError, match=rf"127.0.0.1, port {server.port}: .*in use"):
        LiveServer("uav1", "127.0.0.1", server.port, ViewerScene(VehicleConfig()))
