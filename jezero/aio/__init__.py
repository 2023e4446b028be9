"""The Python SDK for asyncio: the methods of `jezero.Vehicle` as coroutines, with the same names and errors.

```python
import asyncio
from jezero.aio import Vehicle

async def main() -> None:
    async with await Vehicle.connect("uav1") as uav:
        await uav.wait_ready()
        goal = await uav.takeoff(altitude_m=2.0)
        async for feedback in goal:
            print(feedback.distance_m)
        await goal.result()
        await (await uav.land_on_spot()).result()

asyncio.run(main())
```

`jezero.client` does the work. A call that replies within seconds is executed in a thread; a task that waits for
feedback, a result or a message needs none (`arrivals.py`).
"""

from jezero.aio.goal import Goal, ImagesGoal, VelocityGoal
from jezero.aio.rover import Rover
from jezero.aio.subscription import Subscription
from jezero.aio.vehicle import Camera, Vehicle
from jezero.client.actions import described
from jezero.client.errors import Aborted, Canceled, JezeroError, Refused, TimedOut, Unreachable
from jezero.client.rover import Wheel

__all__ = [
    "Aborted",
    "Camera",
    "Canceled",
    "Goal",
    "ImagesGoal",
    "JezeroError",
    "Refused",
    "Rover",
    "Subscription",
    "TimedOut",
    "Unreachable",
    "Vehicle",
    "VelocityGoal",
    "Wheel",
    "described",
]
