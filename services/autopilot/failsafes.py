"""Failsafe actions of the autopilot: one pure function, which docs/reliability.md shows as a table.

The settings have the names, numbers and defaults of PX4.
"""

from collections.abc import Iterable
from enum import Enum, IntEnum
from math import degrees

from jezero.services.autopilot.config import FailsafeConfig
from jezero.services.autopilot.modes import Mode

BEGIN, END = "<!-- failsafes: python -m jezero.services.autopilot.failsafes -->", "<!-- end of failsafes -->"


class Trigger(Enum):
    """Condition that starts a failsafe; the value is its text for people."""

    OFFBOARD_LOST = "offboard setpoints lost"
    LINK_LOST = "ground station lost"
    BATTERY_LOW = "battery low"
    BATTERY_CRITICAL = "battery critical"
    BATTERY_EMERGENCY = "battery almost empty"
    POSITION_LOST = "position lost"
    TILTED = "tilted too far"


class FailsafeAction(IntEnum):
    """Action of a failsafe, in the order of severity."""

    NONE = 0
    WARN = 1
    HOLD = 2
    RETURN = 3
    LAND = 4
    DESCEND = 5
    DISARM = 6


MODE_OF_ACTION = {
    FailsafeAction.HOLD: Mode.HOLD,
    FailsafeAction.RETURN: Mode.RETURN,
    FailsafeAction.LAND: Mode.LAND,
    FailsafeAction.DESCEND: Mode.DESCEND,
}
_ACTION_OF_MODE = {mode: action for action, mode in MODE_OF_ACTION.items()}
_ACTION_OF_COM_OBL_RC_ACT = {
    0: FailsafeAction.LAND,
    1: FailsafeAction.LAND,
    2: FailsafeAction.LAND,
    3: FailsafeAction.RETURN,
    4: FailsafeAction.LAND,
    5: FailsafeAction.HOLD,
    6: FailsafeAction.DISARM,
    7: FailsafeAction.DISARM,
}
"""Values 0 to 2 hand over to a pilot with a remote control, which this autopilot does not have: it lands."""
_ACTION_OF_NAV_DLL_ACT = {
    0: FailsafeAction.NONE,
    1: FailsafeAction.HOLD,
    2: FailsafeAction.RETURN,
    3: FailsafeAction.LAND,
    5: FailsafeAction.DISARM,
    6: FailsafeAction.DISARM,
}
_ACTIONS_OF_COM_LOW_BAT_ACT = {
    0: (FailsafeAction.WARN, FailsafeAction.WARN),
    2: (FailsafeAction.LAND, FailsafeAction.LAND),
    3: (FailsafeAction.RETURN, FailsafeAction.LAND),
}
"""Actions at the critical and at the emergency level."""


def configured_action(trigger: Trigger, config: FailsafeConfig) -> FailsafeAction:
    """Action of a trigger by the settings, independent of the state of the vehicle."""
    critical, emergency = _ACTIONS_OF_COM_LOW_BAT_ACT[config.com_low_bat_act]
    return {
        Trigger.OFFBOARD_LOST: _ACTION_OF_COM_OBL_RC_ACT[config.com_obl_rc_act],
        Trigger.LINK_LOST: _ACTION_OF_NAV_DLL_ACT[config.nav_dll_act],
        Trigger.BATTERY_LOW: FailsafeAction.WARN,
        Trigger.BATTERY_CRITICAL: critical,
        Trigger.BATTERY_EMERGENCY: emergency,
        Trigger.POSITION_LOST: FailsafeAction.DESCEND,
        Trigger.TILTED: FailsafeAction.DISARM,
    }[trigger]


def failsafe_action(trigger: Trigger, mode: Mode, landed: bool, config: FailsafeConfig) -> FailsafeAction:
    """Action of an armed vehicle on one trigger; NONE if its mode already is that action or a safer one."""
    if trigger is Trigger.OFFBOARD_LOST and mode is not Mode.OFFBOARD:
        return FailsafeAction.NONE
    action = configured_action(trigger, config)
    if action not in MODE_OF_ACTION:
        return action
    if landed and action < FailsafeAction.LAND:
        action = FailsafeAction.LAND  # a landed vehicle must not take off by a failsafe
    return action if action > _ACTION_OF_MODE.get(mode, FailsafeAction.NONE) else FailsafeAction.NONE


def most_severe_action(
    triggers: Iterable[Trigger], mode: Mode, landed: bool, config: FailsafeConfig
) -> tuple[FailsafeAction, Trigger | None]:
    """The most severe action and its trigger; the first trigger if several have equal actions."""
    action, cause = FailsafeAction.NONE, None
    for trigger in triggers:
        candidate = failsafe_action(trigger, mode, landed, config)
        if candidate > action:
            action, cause = candidate, trigger
    return action, cause


def table(config: FailsafeConfig) -> str:
    """Markdown table of `failsafe_action` in the air, with the action on the ground in brackets where it differs."""
    modes = list(Mode)
    lines = ["| " + " | ".join(["trigger", *(mode.value for mode in modes)]) + " |"]
    lines.append("|---" * (len(modes) + 1) + "|")
    for trigger in Trigger:
        cells = []
        for mode in modes:
            air, ground = (failsafe_action(trigger, mode, landed, config) for landed in (False, True))
            cells.append(_word(air) if air is ground else f"{_word(air)} ({_word(ground)})")
        lines.append("| " + " | ".join([trigger.value, *cells]) + " |")
    return "\n".join(lines) + "\n"


def docs_section() -> str:
    """The section of docs/reliability.md about failsafes."""
    acting = FailsafeConfig(com_low_bat_act=3, nav_dll_act=2)
    return f"""{BEGIN}
Default action of an armed vehicle on each failsafe trigger, by mode; in brackets the action on the ground where it
differs. If several triggers are active, the most severe action counts: warn, hold, return, land, descend, disarm. A
dash means no action, or that the mode already is this action or a safer one. A mode command overrides the triggers that
are active at that time, except lost offboard setpoints.

{table(FailsafeConfig())}
With `COM_LOW_BAT_ACT` 3 (return at the critical level, land when almost empty) and `NAV_DLL_ACT` 2 (return):

{table(acting)}
| trigger | condition | setting |
|---|---|---|
{_condition_rows()}{END}
"""


def _condition_rows() -> str:
    c = FailsafeConfig()
    rows = (
        (Trigger.OFFBOARD_LOST, f"no setpoint for {c.com_of_loss_t_s:g} s in offboard mode", "COM_OF_LOSS_T"),
        (
            Trigger.LINK_LOST,
            f"no ground station for {c.com_dl_loss_t_s:g} s; its connection times out 2.5 s after a heartbeat",
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


def _word(action: FailsafeAction) -> str:
    return "–" if action is FailsafeAction.NONE else action.name.lower()


if __name__ == "__main__":
    print(docs_section(), end="")
