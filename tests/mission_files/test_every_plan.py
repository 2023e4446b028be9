"""Plans of every version, altitude mode and item, against a reading of their own.

The reading follows QGroundControl's description of its plan files and MAVLink's of MAV_FRAME and MAV_CMD, and knows
nothing of the importer.
"""

import json
import tempfile
from math import cos, hypot, radians
from pathlib import Path
from typing import Any, NamedTuple

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jezero.area_files import AreaFileError
from jezero.mission_files import read_mission
from jezero.mission_files.other_programs import import_file
from jezero.schemas.mission import GoalStep, WaitStep

ORIGIN_DEG = (47.397742, 8.545594, 488.0)
Step = tuple[str, float, float, float]
"""What is done, then metres north, east and up from the origin; for a wait, seconds."""
METRES_PER_DEGREE = 6_371_000.0 * radians(1.0)


class Item(NamedTuple):
    """One item as a person plans it.

    Attributes:
        altitude_m: above home for `mode` 1, above sea level for 2 and 3; for 4 above the terrain.
    """

    command: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    mode: int
    hold_s: float


def flown(items: list[Item], home_known: bool) -> list[Step] | None:
    """What the vehicle does: what, then metres north, east and up from the origin; None for what can't be flown."""
    steps: list[Step] = []
    for item in items:
        if item.command in (20, 93):
            steps.append(("return" if item.command == 20 else "wait", item.hold_s, 0.0, 0.0))
            continue
        if item.mode == 4 and item.command != 21:  # a landing ends on the ground, wherever that is
            return None
        up_m = item.altitude_m - (0.0 if item.mode == 1 else ORIGIN_DEG[2])
        north_m = (item.latitude_deg - ORIGIN_DEG[0]) * METRES_PER_DEGREE
        east_m = (item.longitude_deg - ORIGIN_DEG[1]) * METRES_PER_DEGREE * cos(radians(ORIGIN_DEG[0]))
        if item.command == 22:
            steps.append(("takeoff", 0.0, 0.0, up_m))
        elif item.command == 21:
            steps.append(("land", north_m, east_m, 0.0))
            continue
        if item.command != 22 or hypot(north_m, east_m) > 1.0 or not home_known:
            steps.append(("go", north_m, east_m, up_m))
        if item.command in (16, 19, 82) and item.hold_s:
            steps.append(("wait", item.hold_s, 0.0, 0.0))
    return steps


def frame_of(item: Item, ints: bool) -> int:
    return {1: 3, 2: 0, 3: 0, 4: 10}[item.mode] + (0 if not ints else {1: 3, 2: 5, 3: 5, 4: 1}[item.mode])


def params_of(item: Item) -> list[float | None]:
    if item.command in (20, 93):
        return [item.hold_s, 0, 0, 0, 0, 0, 0]
    return [item.hold_s, 0, 0, None, item.latitude_deg, item.longitude_deg, item.altitude_m]


def new_item(item: Item, ints: bool) -> dict[str, Any]:
    """As QGroundControl 4 saves it."""
    placeless = item.command in (20, 93)
    shown = {
        "AltitudeMode": item.mode, "Altitude": 7.0 if item.mode == 3 else item.altitude_m,
        "AMSLAltAboveTerrain": item.altitude_m if item.mode == 3 else None,
    }  # fmt: skip
    common = {"type": "SimpleItem", "command": item.command, "autoContinue": True, "params": params_of(item)}
    return common | ({"frame": 2} if placeless else {"frame": frame_of(item, ints)} | shown)


def old_item(item: Item, ints: bool) -> dict[str, Any]:
    """As QGroundControl of 2017 saves it."""
    made = new_item(item, ints)
    params = made.pop("params")
    for name in ("AltitudeMode", "Altitude", "AMSLAltAboveTerrain"):
        made.pop(name, None)
    return made | {"params": [value or 0 for value in params[:4]], "coordinate": params[4:]}


def oldest_item(item: Item, ints: bool) -> dict[str, Any]:
    """As QGroundControl of 2016 saves it."""
    made = old_item(item, ints)
    params = made.pop("params")
    return made | {"type": "missionItem"} | {f"param{number}": value for number, value in enumerate(params, 1)}


def text_of(version: str, items: list[Item], ints: bool) -> tuple[str, str]:
    """The name and the text of a file."""
    home = [*ORIGIN_DEG[:2], 0]  # its altitude must not matter
    if version.startswith("QGC WPL"):
        rows = [[0, 1, 0, 16, 0, 0, 0, 0, *home, 1]] if version.endswith("110") else []
        for item in items:
            frame = 2 if item.command in (20, 93) else frame_of(item, ints)
            rows.append([len(rows), 0, frame, item.command, *(value or 0 for value in params_of(item)), 1])
        return "a.waypoints", "\n".join([version, *("\t".join(map(str, row)) for row in rows)])
    if version == "mission 1":
        at_home = {"type": "missionItem", "command": 16, "frame": 0, "coordinate": home}
        content: Any = {"version": "1.0", "complexItems": [], "plannedHomePosition": at_home}
        return "a.mission", json.dumps(content | {"items": [oldest_item(item, ints) for item in items]})
    write = new_item if version == "plan" else old_item
    mission = {"version": 2, "plannedHomePosition": home, "globalPlanAltitudeMode": 1}
    mission["items"] = [write(item, ints) for item in items]
    if version == "mission 2":
        return "a.mission", json.dumps(mission)
    return "a.plan", json.dumps({"fileType": "Plan", "version": 1, "mission": mission})


def read(folder: Path, name: str, text: str) -> list[Step] | None:
    """What the importer and the reader of missions make of a file, in the words of `flown`."""
    (folder / name).write_text(text)
    try:
        made = import_file(folder / name, 8.0, 0.7)
    except AreaFileError as error:
        assert "over the terrain" in str(error)
        return None
    assert made.lost == []
    (folder / "mission.yaml").write_text(made.to_yaml())
    steps: list[Step] = []
    for step in read_mission(folder / "mission.yaml", ORIGIN_DEG).mission.steps:
        if isinstance(step, WaitStep):
            steps.append(("wait", step.duration_s, 0.0, 0.0))
            continue
        assert isinstance(step, GoalStep)
        match step.action:
            case "takeoff":
                steps.append(("takeoff", 0.0, 0.0, step.goal["altitude_m"]))
            case "return_home":
                steps.append(("return", 0.0, 0.0, 0.0))
            case "go_to":
                north_m, east_m, z_m = step.goal["target_ned_m"]
                steps.append(("go", north_m, east_m, -z_m))
            case action:
                assert action == "land_on_spot"
                north_m, east_m, _ = step.goal["landing_spot_ned_m"]
                steps.append(("land", north_m, east_m, 0.0))
    return steps


VERSIONS = st.sampled_from(["plan", "plan of 2017", "mission 2", "mission 1", "QGC WPL 110", "QGC WPL 120"])


@st.composite
def plans(draw: st.DrawFn) -> list[Item]:
    """Items of a flight: a takeoff first, then items of any kind."""
    mode = st.sampled_from([1, 1, 2, 2, 3]) | st.sampled_from([1] * 9 + [4])
    near = st.integers(-2000, 2000).map(lambda steps: steps * 1e-6)

    def item(command: int) -> Item:
        kind = draw(mode)
        altitude_m = draw(st.integers(2, 100)) + (ORIGIN_DEG[2] if kind in (2, 3) else 0.0)
        hold_s = float(draw(st.integers(0, 30))) if command in (16, 19, 82, 93) else 0.0
        places = (ORIGIN_DEG[0] + draw(near), ORIGIN_DEG[1] + draw(near))
        return Item(command, round(places[0], 8), round(places[1], 8), altitude_m, kind, hold_s)

    commands = draw(st.lists(st.sampled_from([16, 16, 17, 18, 19, 31, 82, 93, 20, 21]), max_size=6))
    return [item(command) for command in (22, *commands)]


@settings(max_examples=80, suppress_health_check=list(HealthCheck))
@given(items=plans(), version=VERSIONS, ints=st.booleans())
def test_a_plan_of_any_version_is_flown_as_its_own_program_means_it(
    items: list[Item], version: str, ints: bool
) -> None:
    if version != "plan":  # these had no heights that QGroundControl calculated: the frame says what they are
        items = [item._replace(mode=2) if item.mode == 3 else item for item in items]
    with tempfile.TemporaryDirectory() as folder:
        made = read(Path(folder), *text_of(version, items, ints))
    meant = flown(items, home_known=version != "QGC WPL 120")
    assert (made is None) == (meant is None)
    if made is None or meant is None:
        return
    assert [step[0] for step in made] == [step[0] for step in meant]
    for step, expected in zip(made, meant, strict=True):
        assert hypot(*(a - b for a, b in zip(step[1:], expected[1:], strict=True))) < 0.5
        assert abs(step[3] - expected[3]) < 0.01, "heights are exact"
