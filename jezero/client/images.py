"""Goals that take pictures: their pictures come one by one, each with a question of its own.

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

from jezero.client.errors import EndedError, JezeroError
from jezero.client.goal import Goal
from jezero.client.session import Connection, decode
from jezero.codec import encode
from jezero.schemas.actions import ImagesFeedback, ImagesResult
from jezero.schemas.images import GetImage, Image, ImageReply
from jezero.schemas.topics import Action

ANSWER_S = 10.0


class Picture(NamedTuple):
    """One picture of a goal.

    Attributes:
        image: where, when and with what it was taken.
        pixels: rows from the top, three bytes red, green, blue each.
    """

    image: Image
    pixels: bytes


class ImagesGoal(Goal[ImagesFeedback, ImagesResult]):
    """A running goal that takes pictures."""

    def pictures(self, watch: Callable[[ImagesFeedback], None] = lambda feedback: None) -> Iterator[Picture]:
        """Every picture once: as it is taken where the goal streams them, the others at its end.

        Then ask for the `result()`: a goal that is aborted or canceled has pictures too.

        Args:
            watch: called with each feedback.

        Raises:
            JezeroError: a picture can't be had.
        """
        seen: set[int] = set()
        for feedback in self.feedback():
            watch(feedback)
            for image in feedback.images:
                seen.add(image.index)
                yield self.picture(image)
        for image in self._images():
            if image.index not in seen:
                yield self.picture(image)

    def picture(self, image: Image) -> Picture:
        """The pixels of one picture, also after the goal's end.

        Raises:
            JezeroError: the server doesn't have them, or not any more.
            Unreachable, TimedOut: no answer.
        """
        return fetch_picture(self._connection, self._action, self.goal_id, image)

    def _images(self) -> tuple[Image, ...]:
        """All that the result tells of, however the goal ended."""
        try:
            return self.result().images
        except EndedError as error:
            return error.result.images if isinstance(error.result, ImagesResult) else ()


def fetch_picture(connection: Connection, action: Action[Any], goal_id: str, image: Image) -> Picture:
    """One picture of a goal, from its server.

    Raises:
        As `ImagesGoal.picture`.
    """
    question = encode(GetImage(goal_id=goal_id, index=image.index))
    arrivals = connection.stream(action.image.name, question, ANSWER_S)
    reply: ImageReply = decode(ImageReply, connection.first(arrivals, action.image.name, ANSWER_S))
    if reply.reason:
        raise JezeroError(reply.reason)
    return Picture(image, reply.pixels)
