"""Small services that the tests of the runtime run as processes: `python toy_services.py NAME`."""

import sys
from collections.abc import Iterable

from jezero.runtime.config import instance_from_environment
from jezero.runtime.service import Inbox, Output, Publish, Reply, Spec
from jezero.runtime.zenoh_bus import new_boot_id, run_service
from jezero.schemas import topics
from jezero.schemas.commands import AbortReply
from jezero.schemas.state import Clock


class Echo:
    """Answers aborts with what it last heard on the clock."""

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
            heard = "nothing" if clock is None else f"epoch {clock.epoch_id}"
            yield Reply(request.request_id, AbortReply(hovering=True, reason=heard))


class Undeclared:
    """Publishes what it doesn't declare: a programming error, on which the process ends."""

    spec = Spec(name="undeclared", rate_hz=20)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(topics.CLOCK, Clock(t_ns=0, epoch_id=0))


SERVICES = {"echo": Echo, "undeclared": Undeclared}

if __name__ == "__main__":
    sys.exit(run_service(SERVICES[sys.argv[1]](), instance_from_environment(), new_boot_id()))
