"""The preflight checks that need no mathematics of sensors: services, clock, battery, storage, autopilot.

Each check is a function from the readings of one round to a `Check`.
"""

from collections.abc import Collection

from jezero.base.fence import nearest
from jezero.schemas.preflight import Check, CheckName, Verdict
from jezero.schemas.state import STATUS_WORDS, StatusCode
from jezero.schemas.struct import TEXT_MAX
from jezero.schemas.topics import CLOCK, FENCE, STATUS
from jezero.services.preflight.readings import Readings

CAMERAS = frozenset({"camera", "camera_driver"})
"""The simulated camera, and the driver of a real one: a vehicle has one of them."""
LANDING_CHAIN = CAMERAS | {"tag_detector", "estimator", "land_on_spot"}
"""Services without which no landing on the rover is possible."""
AGE_MAX_S = 0.5
RATE_MIN = 0.9
"""Vehicle time may run slower than wall time by this factor: a slower simulator is worth knowing."""
BATTERY_RESERVE = 0.15
"""Fraction of the capacity above the critical one below which the battery gets a warning."""
ROOM_MIN_BYTES = 50_000_000
ROOM_LOW_BYTES = 2_000_000_000
"""Recording takes about 1 MB a second with images."""
RECORDER = "recorder"


def check_autopilot(readings: Readings) -> Check:
    """Whether the vehicle is ready by its own bridge and autopilot."""
    status = readings.status
    if status is None:
        return _check("autopilot", "failed", "the vehicle bridge publishes no status: is it running?")
    if not status.ready:
        return _check(
            "autopilot", "failed", status.not_ready_reason or f"the vehicle {STATUS_WORDS[StatusCode(status.code)]}"
        )
    bridge = readings.health.get("vehicle_bridge")
    if status.code == StatusCode.IDLE and bridge is not None and bridge.state == "degraded":
        return _check("autopilot", "warning", bridge.text)
    if status.code == StatusCode.IDLE:
        return _check("autopilot", "passed", f"its arming checks pass in mode {status.autopilot_mode}")
    return _check("autopilot", "passed", f"it flies, in mode {status.autopilot_mode}")


def check_services(readings: Readings) -> Check:
    """Whether every service that ran before still runs, and says that it is well.

    Silence in one round is a warning: on a loaded computer a service that draws pictures may be late by seconds.
    """
    lost = sorted(readings.heard_services - readings.health.keys())
    ill = [health for _, health in sorted(readings.health.items()) if health.state != "ok"]
    # The bridge and the recorder have a check of their own.
    ill = [health for health in ill if health.service not in ("vehicle_bridge", RECORDER)]
    parts = [f"{name} is silent" for name in lost] + [f"{health.service}: {health.text}" for health in ill]
    missing = _missing({*readings.health, *lost})
    parts += [f"no {name} runs" for name in missing] + ([readings.keys_problem] if readings.keys_problem else [])
    verdict: Verdict = "warning" if parts else "passed"
    if LANDING_CHAIN & set(lost) & readings.silent_services:
        verdict = "failed"
    hint = ": the vehicle could not land on the rover; see jezero ps" if LANDING_CHAIN & {*lost, *missing} else ""
    return _check("services", verdict, "; ".join(parts) + hint or f"all {len(readings.health)} are well")


def _missing(known: Collection[str]) -> list[str]:
    """Services of the landing chain that are not among these; one camera is enough."""
    other_camera = CAMERAS if CAMERAS & set(known) else {"camera_driver"}
    return sorted(LANDING_CHAIN - other_camera - set(known))


def check_clock(readings: Readings) -> Check:
    """Whether vehicle time goes on, as fast as wall time, and messages are young."""
    clocks = readings.all(CLOCK)
    if len(clocks) < 2:
        return _check("clock", "failed", "vehicle time stands still: see simulator and vehicle_bridge in jezero ps")
    age_s = readings.age_s(STATUS)
    if age_s is not None and abs(age_s) > AGE_MAX_S:
        return _check("clock", "failed", f"the status is {age_s:.2f} s old on arrival, {AGE_MAX_S:g} s is the limit")
    wall_ns = clocks[-1].wall_ns - clocks[0].wall_ns
    rate = (clocks[-1].t_ns - clocks[0].t_ns) / wall_ns if wall_ns > 0 else 1.0
    age = "" if age_s is None else f", the status is {max(age_s, 0.0) * 1000.0:.0f} ms old"
    verdict: Verdict = "passed" if rate >= RATE_MIN else "warning"
    slow = "" if verdict == "passed" else ": this computer is too slow for the simulation, close other programs"
    return _check("clock", verdict, f"vehicle time runs at {100.0 * rate:.0f} % of wall time{age}{slow}")


def check_battery(readings: Readings) -> Check:
    """Whether the battery is above the level at which the autopilot ends a flight, and its charge falls in flight."""
    battery = None if readings.status is None else readings.status.battery
    if battery is None or battery.remaining is None:
        return _check("battery", "warning", "the autopilot does not measure its charge")
    if readings.charge_problem:
        return _check("battery", "failed", readings.charge_problem)
    text = f"{100.0 * battery.remaining:.0f} %, {battery.voltage_v:.1f} V"
    if battery.critical is None:
        return _check("battery", "warning", f"{text}; the level at which the autopilot returns is unknown")
    text += f"; the autopilot ends a flight at {100.0 * battery.critical:.0f} %"
    if battery.remaining <= battery.critical:
        return _check("battery", "failed", f"{text}: charge it")
    low = battery.remaining < battery.critical + BATTERY_RESERVE
    return _check("battery", "warning" if low else "passed", f"{text}: enough for a short flight only" if low else text)


def check_fence(readings: Readings) -> Check:
    """Whether the vehicle stands inside its fence, and the autopilot has the fence too."""
    status, held = readings.status, readings.latest(FENCE)
    if status is None or held is None:
        return _check("fence", "warning", "the vehicle bridge publishes no fence: is it running?")
    if not held.fence_id:
        return _check("fence", "passed", "no fence is set")
    if held.outside:
        away = "carry it inside, or change the fence with jezero fence set or jezero fence clear"
        return _check("fence", "failed", f"the vehicle is {held.outside}: {away}")
    if held.fence is None or status.odometry is None:
        return _check("fence", "warning", "the fence waits for the vehicle's origin, which GNSS gives")
    if held.autopilot_failure:
        text = f"the bridge alone holds the fence, the autopilot has not taken it: {held.autopilot_failure}"
        return _check("fence", "warning", text)
    edge = nearest(held.fence, status.odometry.pos_uav_ned_m)
    where = "" if edge is None else f", {edge.inside_m:.1f} m from the edge of {edge.in_words}"
    return _check("fence", "passed", f"the vehicle is inside {held.fence.name!r}{where}")


def check_storage(readings: Readings) -> Check:
    """Whether the flight is recorded, and there is room for it."""
    recorder = readings.health.get(RECORDER)
    if recorder is None:
        return _check("storage", "warning", "no recorder runs: this flight is not recorded")
    room_bytes = recorder.room_bytes
    if room_bytes is not None and room_bytes < ROOM_MIN_BYTES:
        return _check("storage", "failed", f"{room_bytes / 1e6:.0f} MB free for recordings: delete old ones")
    if recorder.state == "degraded":
        return _check("storage", "warning", recorder.text)
    if room_bytes is None:
        return _check("storage", "passed", recorder.text)
    text = f"{room_bytes / 1e9:.1f} GB free for recordings"
    low = room_bytes < ROOM_LOW_BYTES
    return _check("storage", "warning" if low else "passed", f"{text}: delete old ones soon" if low else text)


def _check(name: CheckName, verdict: Verdict, text: str) -> Check:
    return Check(name=name, verdict=verdict, text=text[:TEXT_MAX])
