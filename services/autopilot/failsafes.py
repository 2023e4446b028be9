"""What the autopilot does when something is lost: one pure function, printed as a table in docs/reliability.md.

Names, numbers and defaults of the settings are PX4's.
"""

from collections.abc import Iterable
from enum import Enum, IntEnum
from math import degrees

from jezero.services.autopilot.config import FailsafeConfig
from jezero.services.autopilot.modes import Mode

BEGIN, END = "<!-- failsafes: python -m jezero.services.autopilot.failsafes -->", "<!-- end of failsafes -->"


class Trigger(Enum):
    """What is wrong; the value says it to people."""

    OFFBOARD_LOST = "offboard setpoints lost"
    LINK_LOST = "ground station lost"
    BATTERY_LOW = "battery low"
    BATTERY_CRITICAL = "battery critical"
    BATTERY_EMERGENCY = "battery almost empty"
    POSITION_LOST = "position lost"
    TILTED = "tilted too far"


class Action(IntEnum):
    """What is done about it, in the order of severity."""

    NONE = 0
    WARN = 1
    HOLD = 2
    RETURN = 3
    LAND = 4
    DESCEND = 5
    DISARM = 6


MODE_OF = {
    Action.HOLD: Mode.HOLD,
    Action.RETURN: Mode.RETURN,
    Action.LAND: Mode.LAND,
    Action.DESCEND: Mode.DESCEND,
}
_DOES_ALREADY = {mode: action for action, mode in MODE_OF.items()}
_OBL_RC = {
    0: Action.LAND,
    1: Action.LAND,
    2: Action.LAND,
    3: Action.RETURN,
    4: Action.LAND,
    5: Action.HOLD,
    6: Action.DISARM,
    7: Action.DISARM,
}
"""COM_OBL_RC_ACT: 0 to 2 hand over to a pilot, and there is none."""
_DLL = {0: Action.NONE, 1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND, 5: Action.DISARM, 6: Action.DISARM}
_LOW_BAT = {
    0: (Action.WARN, Action.WARN),
    2: (Action.LAND, Action.LAND),
    3: (Action.RETURN, Action.LAND),
}
"""COM_LOW_BAT_ACT: at the critical and at the emergency level."""


def asked_for(trigger: Trigger, config: FailsafeConfig) -> Action:
    """What the settings want, whatever the vehicle does at present."""
    critical, emergency = _LOW_BAT[config.com_low_bat_act]
    return {
        Trigger.OFFBOARD_LOST: _OBL_RC[config.com_obl_rc_act],
        Trigger.LINK_LOST: _DLL[config.nav_dll_act],
        Trigger.BATTERY_LOW: Action.WARN,
        Trigger.BATTERY_CRITICAL: critical,
        Trigger.BATTERY_EMERGENCY: emergency,
        Trigger.POSITION_LOST: Action.DESCEND,
        Trigger.TILTED: Action.DISARM,
    }[trigger]


def response(trigger: Trigger, mode: Mode, landed: bool, config: FailsafeConfig) -> Action:
    """What an armed vehicle does about one thing.

    NONE also stands for: it does that already, or something safer.
    """
    if trigger is Trigger.OFFBOARD_LOST and mode is not Mode.OFFBOARD:
        return Action.NONE
    action = asked_for(trigger, config)
    if action not in MODE_OF:
        return action
    if landed and action < Action.LAND:
        action = Action.LAND  # what stands on the ground stays there
    return action if action > _DOES_ALREADY.get(mode, Action.NONE) else Action.NONE


def respond(
    triggers: Iterable[Trigger], mode: Mode, landed: bool, config: FailsafeConfig
) -> tuple[Action, Trigger | None]:
    """The most severe response, and to what; of equals the first one counts."""
    action, because = Action.NONE, None
    for trigger in triggers:
        candidate = response(trigger, mode, landed, config)
        if candidate > action:
            action, because = candidate, trigger
    return action, because


def table(config: FailsafeConfig) -> str:
    """`response` for everything, in Markdown; in the air, and where it differs on the ground."""
    modes = list(Mode)
    lines = ["| " + " | ".join(["wrong is", *(mode.value for mode in modes)]) + " |"]
    lines.append("|---" * (len(modes) + 1) + "|")
    for trigger in Trigger:
        cells = []
        for mode in modes:
            air, ground = (response(trigger, mode, landed, config) for landed in (False, True))
            cells.append(_word(air) if air is ground else f"{_word(air)} ({_word(ground)})")
        lines.append("| " + " | ".join([trigger.value, *cells]) + " |")
    return "\n".join(lines) + "\n"


def section() -> str:
    """What docs/reliability.md tells of the failsafes."""
    acting = FailsafeConfig(com_low_bat_act=3, nav_dll_act=2)
    return f"""{BEGIN}
What an armed vehicle does about each thing that can be wrong, in each mode, by default; in brackets what it does on
the ground where that differs. The most severe counts: warn, hold, return, land, descend, disarm. A dash also stands
for: it does that already, or something safer. Whoever commands another mode overrules what was wrong at that moment.

{table(FailsafeConfig())}
With `COM_LOW_BAT_ACT` 3 (return at the critical level, land when almost empty) and `NAV_DLL_ACT` 2 (return):

{table(acting)}
| wrong is | when | setting |
|---|---|---|
{_whens()}{END}
"""


def _whens() -> str:
    c = FailsafeConfig()
    rows = (
        (Trigger.OFFBOARD_LOST, f"no setpoint for {c.com_of_loss_t_s:g} s in offboard mode", "COM_OF_LOSS_T"),
        (
            Trigger.LINK_LOST,
            f"no ground station for {c.com_dl_loss_t_s:g} s; each of its heartbeats counts for 2.5 s",
            "COM_DL_LOSS_T",
        ),
        (Trigger.BATTERY_LOW, f"less than {c.bat_low_thr:.0%} left", "BAT_LOW_THR"),
        (Trigger.BATTERY_CRITICAL, f"less than {c.bat_crit_thr:.0%} left", "BAT_CRIT_THR"),
        (Trigger.BATTERY_EMERGENCY, f"less than {c.bat_emergen_thr:.0%} left", "BAT_EMERGEN_THR"),
        (
            Trigger.POSITION_LOST,
            f"no GNSS fix for {c.ekf2_noaid_tout_s:g} s, or a standard deviation above {c.com_pos_fs_eph_m:g} m",
            "EKF2_NOAID_TOUT, COM_POS_FS_EPH",
        ),
        (
            Trigger.TILTED,
            f"by more than {degrees(c.fd_fail_tilt_rad):.0f}° for {c.fd_fail_s:g} s",
            "FD_FAIL_R, FD_FAIL_P, FD_FAIL_R_TTRI",
        ),
    )
    return "".join(f"| {trigger.value} | {when} | {setting} |\n" for trigger, when, setting in rows)


def _word(action: Action) -> str:
    return "–" if action is Action.NONE else action.name.lower()


if __name__ == "__main__":
    print(section(), end="")
