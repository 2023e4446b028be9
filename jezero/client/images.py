"""Goals that take images, which the client fetches one by one.

```python
goal = uav.get_images((0.0, 0.0, -4.0), radius_m=2.0, num_images=8)
with Dataset("runs/target") as dataset:
    for picture in goal.pictures():
        dataset.add(picture)
goal.result()
```
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from jezero.base.codec import encode
from jezero.base.zenoh_client import LAST
from jezero.client.errors import EndedError, JezeroError
from jezero.client.goal import Goal
from jezero.client.session import Connection, decode
from jezero.schemas.goals import ImagesFeedback, ImagesResult
from jezero.schemas.images import GetImage, Image, ImageReply
from jezero.schemas.rows import Action

IMAGE_TIMEOUT_S = 10.0


class Picture(NamedTuple):
    """One image of a goal with its pixels.

    Attributes:
        image: time, camera pose, intrinsics and the vehicle's state; `schemas/images.py` gives units and frames.
        pixels: rows from the top, each pixel three bytes red, green, blue.
    """

    image: Image
    pixels: bytes


class ImagesGoal(Goal[ImagesFeedback, ImagesResult]):
    """A running goal that takes images."""

    def pictures(self, on_feedback: Callable[[ImagesFeedback], None] = lambda feedback: None) -> Iterator[Picture]:
        """Yield each image once: as it is taken if the goal streams its images, else at the goal's end.

        Call `result()` afterwards: an aborted or canceled goal has images too.

        Args:
            on_feedback: called with each feedback.

        Raises:
            JezeroError: an image can't be fetched.
        """
        fetched: set[int] = set()
        for feedback in self.feedback():
            on_feedback(feedback)
            for image in feedback.images:
                fetched.add(image.index)
                yield self.picture(image)
        for image in self._images():
            if image.index not in fetched:
                yield self.picture(image)

    def picture(self, image: Image) -> Picture:
        """Fetch the pixels of one image, also after the goal's end.

        Raises:
            JezeroError: the server does not have them, or not any more.
            Unreachable: no action server replies.
            TimedOut: the reply is missing.
        """
        return fetch_picture(self._connection, self._action, self.goal_id, image)

    def _images(self) -> tuple[Image, ...]:
        """All images in the result, however the goal ended."""
        try:
            return self.result().images
        except EndedError as error:
            return error.result.images if isinstance(error.result, ImagesResult) else ()


def fetch_picture(connection: Connection, action: Action[Any], goal_id: str, image: Image) -> Picture:
    """Fetch one image of a goal from its server; raises the errors of `ImagesGoal.picture`."""
    request = encode(GetImage(goal_id=goal_id, index=image.index))
    arrivals = connection.stream(action.image.name, request, IMAGE_TIMEOUT_S, LAST)
    reply: ImageReply = decode(ImageReply, connection.first(arrivals, action.image.name, IMAGE_TIMEOUT_S))
    if reply.reason:
        raise JezeroError(reply.reason)
    return Picture(image, reply.pixels)
