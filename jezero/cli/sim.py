"""`jezero sim`: look into the simulated world, and change it while it runs."""

from collections.abc import Callable
from math import degrees
from typing import TYPE_CHECKING, Any

import click
import msgspec

from jezero.cli.options import FINITE, NUMBERS, CommandGroup, FiniteRange, common_options
from jezero.cli.terminal import Printer, connected
from jezero.schemas.simulator import SPEED_MAX, SPEED_MIN, STEP_MAX_S, STEP_MIN_S

if TYPE_CHECKING:
    from jezero.client.simulator import SimulatedWorld
    from jezero.schemas.simulator import ActiveFault, ObstaclePlace, SimulatorState


class FaultUnitName(click.ParamType[str]):
    """The name of what may fail in the simulator."""

    name = "unit"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from jezero.schemas.simulator import FAULTS

        if value not in FAULTS:
            self.fail(f"the simulator has no faults of {value!r}; it has those of: {', '.join(FAULTS)}", param, ctx)
        return str(value)


class FaultKindName(click.ParamType[str]):
    """The name of how something fails; whether this unit can fail so is the simulator's to say."""

    name = "kind"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from typing import get_args

        from jezero.schemas.simulator import FaultKind

        if value not in (kinds := (*get_args(FaultKind), "ok")):
            self.fail(f"{value!r} is no kind of fault; these are: {', '.join(kinds)}", param, ctx)
        return str(value)


@click.group(cls=CommandGroup)
def sim() -> None:
    """Play with the simulated world, while it runs: pause it, put things elsewhere, change the wind, let sensors fail.

    A real vehicle has no simulator: there, each of these commands ends with a sentence that says so.
    """


def _change(
    vehicle: str, router: str, as_json: bool, kind: str, change: Callable[["SimulatedWorld"], "SimulatorState"],
    words: Callable[["SimulatorState"], str],
) -> None:  # fmt: skip
    """Make one change, and print what it has become."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        state = change(uav.simulator)
    printer.event(kind, words(state), state=msgspec.to_builtins(state))


@sim.command()
@common_options
def scene(vehicle: str, router: str, as_json: bool) -> None:
    """Print what is in the world: vehicle, rover, obstacles, wind, faults, and the speed of vehicle time."""
    _change(vehicle, router, as_json, "scene", lambda simulator: simulator.state(), _scene)


@sim.command()
@common_options
def reset(vehicle: str, router: str, as_json: bool) -> None:
    """Put vehicle and rover back to their start.

    Goals end, faults end, and the wind is that of the settings. The autopilot starts anew, as after a boot.
    """
    _change(
        vehicle, router, as_json, "reset", lambda simulator: simulator.reset(),
        lambda state: "vehicle and rover are back at their start",
    )  # fmt: skip


@sim.command(context_settings=NUMBERS)
@click.argument("north_m", metavar="NORTH", type=FINITE)
@click.argument("east_m", metavar="EAST", type=FINITE)
@click.option("--height", "height_m", type=FINITE, default=0.0, help="Metres above the ground, of a flying vehicle.")
@click.option("--yaw", "yaw_deg", type=FiniteRange(-360, 360), help="Heading in degrees [default: as it is].")
@click.option("--rover", is_flag=True, help="Put the rover there, not the vehicle.")
@common_options
def place(
    north_m: float, east_m: float, height_m: float, yaw_deg: float | None, rover: bool,
    vehicle: str, router: str, as_json: bool,
) -> None:  # fmt: skip
    """Put the vehicle or the rover NORTH and EAST metres from where the vehicle started, at rest.

    A vehicle whose motors stand still is put on the ground. One that flies is put into the air, with --height: its
    autopilot sees its position jump.
    """

    def words(state: "SimulatorState") -> str:
        return f"the rover is {_rover(state)}" if rover else f"the vehicle is {_vehicle(state)}"

    _change(
        vehicle, router, as_json, "place",
        lambda simulator: simulator.place(
            north_m, east_m, height_m=height_m, yaw_deg=yaw_deg, what="rover" if rover else "vehicle"
        ),
        words,
    )  # fmt: skip


@sim.command(context_settings=NUMBERS)
@click.argument("mean_mps", metavar="MEAN", type=FINITE)
@click.argument("from_deg", metavar="FROM", type=FINITE)
@click.option("--gusts", "std_gust_mps", type=FINITE, help="Standard deviation of the gusts, m/s [default: as it is].")
@common_options
def wind(
    mean_mps: float, from_deg: float, std_gust_mps: float | None, vehicle: str, router: str, as_json: bool
) -> None:
    """Let the wind blow with MEAN m/s from the direction FROM, in degrees: 0 is north, 90 is east."""
    _change(
        vehicle, router, as_json, "wind",
        lambda simulator: simulator.wind(mean_mps, from_deg, std_gust_mps=std_gust_mps), _wind,
    )  # fmt: skip


@sim.command()
@click.argument("unit", required=False, type=FaultUnitName())
@click.argument("kind", required=False, type=FaultKindName())
@click.option("--instance", type=click.IntRange(0, 64), default=0, help="Which motor or UWB anchor, from 1 [all].")
@click.option("--for", "for_s", type=FINITE, help="Seconds of vehicle time after which it ends [until `ok`].")
@common_options
def fault(
    unit: Any, kind: Any, instance: int, for_s: float | None, vehicle: str, router: str, as_json: bool
) -> None:  # fmt: skip
    """Let UNIT fail as KIND says, `ok` ends it; without both, list what has failed.

    Names are those of PX4's failure injection. gps, baro, mag, distance_sensor, uwb and rover_odometry can be off,
    stuck, garbage, wrong, slow, delayed or intermittent; gyro and accel stuck, garbage or wrong; a motor off; the
    camera off, slow or intermittent.
    """
    if unit is not None and kind is None:
        raise click.UsageError(f"say how {unit} fails, or `ok`: jezero sim fault {unit} off")
    _change(
        vehicle, router, as_json, "fault",
        lambda simulator: simulator.state() if unit is None
        else simulator.fault(unit, kind, instance=instance, for_s=for_s),
        lambda state: _faults(state) or "nothing has failed",
    )  # fmt: skip


@sim.command()
@common_options
def pause(vehicle: str, router: str, as_json: bool) -> None:
    """Stop vehicle time: everything waits, also a vehicle in the air."""
    _change(vehicle, router, as_json, "pause", lambda simulator: simulator.pause(), _time)


@sim.command()
@common_options
def resume(vehicle: str, router: str, as_json: bool) -> None:
    """Let vehicle time go on."""
    _change(vehicle, router, as_json, "resume", lambda simulator: simulator.resume(), _time)


@sim.command(context_settings=NUMBERS)
@click.argument("seconds", type=FiniteRange(STEP_MIN_S, STEP_MAX_S), default=1.0)
@common_options
def step(seconds: float, vehicle: str, router: str, as_json: bool) -> None:
    """Let a paused vehicle time go on for SECONDS (1 by default), and wait until they are over."""
    _change(vehicle, router, as_json, "step", lambda simulator: simulator.step(seconds), _time)


@sim.command(context_settings=NUMBERS)
@click.argument("factor", type=FiniteRange(SPEED_MIN, SPEED_MAX))
@common_options
def speed(factor: float, vehicle: str, router: str, as_json: bool) -> None:
    """Let vehicle time go FACTOR times as fast as real time: 0.5 is half as fast.

    A computer that is too slow for FACTOR lets it go as fast as it can; `jezero sim scene` shows how fast that is.
    """
    _change(vehicle, router, as_json, "speed", lambda simulator: simulator.speed(factor), _time)


# -- words ---------------------------------------------------------------------------------------------


def _scene(state: "SimulatorState") -> str:
    link = "" if state.autopilot else "; no autopilot is connected"
    motors = "run" if state.motors else "stand still"
    return "\n".join(
        (
            f"time     {_time(state)}",
            f"vehicle  {_vehicle(state)}, motors {motors}{link}",
            f"rover    {_rover(state)}",
            f"wind     {_wind(state)}",
            f"faults   {_faults(state) or 'none'}",
            *(f"obstacle {_obstacle(each)}" for each in state.obstacles),
        )
    )


def _obstacle(obstacle: "ObstaclePlace") -> str:
    north_m, east_m, _ = obstacle.pos_foot_ned_m
    long_m, wide_m, tall_m = obstacle.size_ned_m
    place = f"{north_m:.2f} m north and {east_m:.2f} m east of the start"
    return f"{obstacle.name}, {place}, {long_m:.2f} x {wide_m:.2f} m, {tall_m:.2f} m high"


def _place(pos_ned_m: tuple[float, float, float], yaw_rad: float) -> str:
    north_m, east_m, _ = pos_ned_m
    return f"{north_m:.2f} m north and {east_m:.2f} m east of the start, heading {degrees(yaw_rad) % 360.0:.0f}°"


def _vehicle(state: "SimulatorState") -> str:
    above = f"{state.height_uav_m:.2f} m above the ground"
    return f"{_place(state.pos_uav_ned_m, state.yaw_uav_rad)}, {above}"


def _rover(state: "SimulatorState") -> str:
    return f"{_place(state.pos_rover_ned_m, state.yaw_rover_rad)}, drives at {state.speed_rover_mps:.2f} m/s"


def _wind(state: "SimulatorState") -> str:
    blows = f"{state.wind_mean_mps:g} m/s from {state.wind_from_deg % 360.0:g}°"
    return f"{blows}, gusts of {state.std_gust_mps:g} m/s (standard deviation)"


def _faults(state: "SimulatorState") -> str:
    return ", ".join(_fault(each, state.t_ns) for each in state.faults)


def _fault(active: "ActiveFault", t_ns: int) -> str:
    which = f" {active.instance}" if active.instance else ""
    left = "" if active.until_t_ns is None else f" for {(active.until_t_ns - t_ns) / 1e9:.1f} s"
    return f"{active.unit}{which} {active.kind}{left}"


def _time(state: "SimulatorState") -> str:
    at = f"vehicle time {state.t_ns / 1e9:.2f} s"
    if state.paused:
        return f"{at}, paused (jezero sim resume, jezero sim step)"
    reached = "" if state.speed_reached is None else f", {state.speed_reached:g} reached in the last second"
    return f"{at}, speed {state.speed:g}{reached}"
