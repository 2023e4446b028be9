"""Small services that the tests of the runtime run as processes: `python toy_services.py NAME`."""

import sys
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial

from jezero.runtime.instance import instance_from_environment
from jezero.runtime.process import new_boot_id, run_service
from jezero.runtime.service import BackgroundTask, Inbox, Output, Publish, Reply, Service, Spec
from jezero.schemas import topics
from jezero.schemas.commands import AbortReply
from jezero.schemas.images import GetImage, ImageReply
from jezero.schemas.state import Clock


class Echo:
    """Replies to aborts with the newest epoch of the clock."""

    spec = Spec(
        name="echo",
        inputs=(topics.CLOCK,),
        outputs=(topics.TRUTH,),
        serves=(topics.ABORT,),
        triggers=(topics.ABORT.name,),
        rate_hz=20,
    )

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        clock = inbox.latest(topics.CLOCK)
        for request in inbox.requests(topics.ABORT):
            newest = "nothing" if clock is None else f"epoch {clock.epoch_id}"
            yield Reply(request.request_id, AbortReply(hovering=True, reason=newest))


class SlowViewer:
    """Spends half a second on each picture; replies to aborts with the newest one's number and how many there were."""

    spec = Spec(name="slow_viewer", inputs=(topics.CAMERA,), serves=(topics.ABORT,), triggers=(topics.CAMERA.name,))
    seen = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        if inbox.new(topics.CAMERA):
            self.seen += len(inbox.new(topics.CAMERA))
            time.sleep(0.5)
        frame = inbox.latest(topics.CAMERA)
        for request in inbox.requests(topics.ABORT):
            newest = -1 if frame is None else frame.sequence
            whole = frame is not None and frame.pixels == bytes([newest]) * (640 * 480 * 3)
            yield Reply(request.request_id, AbortReply(hovering=whole, reason=f"{newest} {self.seen}"))


class Album:
    """Has one picture, number 0."""

    spec = Spec(name="album", serves=(topics.GET_IMAGES.image,), triggers=(topics.GET_IMAGES.image.name,), rate_hz=20)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for request in inbox.requests(topics.GET_IMAGES.image):
            wanted: GetImage = request.payload
            picture = ImageReply(goal_id=wanted.goal_id, index=wanted.index, reason=f"no picture {wanted.index}")
            if wanted.index == 0:
                picture = ImageReply(goal_id=wanted.goal_id, width_px=2, height_px=1, pixels=b"\n\x00\xffabc")
            yield Reply(request.request_id, picture)


class Busy:
    """Starts a background task of seconds at the first abort; replies to each with the number of tasks done."""

    spec = Spec(name="busy", serves=(topics.ABORT,), triggers=(topics.ABORT.name,), rate_hz=20)
    asked, done = False, 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.done += sum(response.tag == "count" and bool(response.payload) for response in inbox.responses)
        for request in inbox.requests(topics.ABORT):
            yield Reply(request.request_id, AbortReply(hovering=True, reason=f"{self.done} done"))
            if not self.asked:
                self.asked = True
                # never releases the interpreter, as one call of a geometry library
                yield BackgroundTask(partial(sum, range(50_000_000)), "count")


class Undeclared:
    """Publishes what it doesn't declare: a programming error, on which the process ends."""

    spec = Spec(name="undeclared", rate_hz=20)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(topics.CLOCK, Clock(t_ns=0, epoch_id=0, wall_ns=0))


class Hung:
    """Blocks for ever in its first step after a second, as a deadlock does; Zenoh's threads go on."""

    spec = Spec(name="hung", rate_hz=20)

    def __init__(self) -> None:
        self._first_ns: int | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self._first_ns = self._first_ns or inbox.wall_ns
        if inbox.wall_ns - self._first_ns > 1_000_000_000:
            threading.Event().wait()
        return ()


SERVICES: dict[str, Callable[[], Service]] = {
    "album": Album,
    "busy": Busy,
    "echo": Echo,
    "hung": Hung,
    "slow_viewer": SlowViewer,
    "undeclared": Undeclared,
}

if __name__ == "__main__":
    sys.exit(run_service(SERVICES[sys.argv[1]](), instance_from_environment(), new_boot_id()))
