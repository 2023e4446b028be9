"""MAVLink parameters: settings of the autopilot with the names, units and limits of PX4."""

from dataclasses import dataclass
from math import degrees, isfinite
from typing import Any

import msgspec

from jezero.base.vehicle_config import BatteryConfig
from jezero.services.autopilot.config import AutopilotConfig

Value = int | float

DEG = degrees(1.0)
BATTERY = "battery"
"""Section of the vehicle's battery, which isn't among the autopilot's own settings."""
SQRT_STEPS_PER_S = 10.0
"""PX4's filter adds bias noise times the time step in each of its 100 steps per second; this factor converts to it."""


@dataclass(frozen=True)
class Row:
    """One parameter: the field of its setting, and the values that are accepted.

    Attributes:
        section: section of the settings, or `BATTERY`.
        field: field of the section.
        low: lowest accepted value.
        high: highest accepted value.
        kind: type of the parameter.
        factor: PX4's unit per unit of the setting.
        choices: the accepted values, if only some are.
    """

    name: str
    section: str
    field: str
    low: float
    high: float
    kind: type[int] | type[float] = float
    factor: float = 1.0
    choices: tuple[int, ...] = ()


ROWS = tuple(
    sorted(
        (
            Row("BAT1_CAPACITY", BATTERY, "capacity_mah", 100.0, 100_000.0),
            Row("BAT1_N_CELLS", BATTERY, "cells", 1, 16, int),
            Row("BAT1_R_INTERNAL", BATTERY, "internal_ohm", 0.0, 0.2),
            Row("BAT1_V_CHARGED", BATTERY, "full_v", 1.0, 5.0),
            Row("BAT1_V_EMPTY", BATTERY, "empty_v", 1.0, 5.0),
            Row("BAT_CRIT_THR", "failsafe", "bat_crit_thr", 0.05, 0.25),
            Row("BAT_EMERGEN_THR", "failsafe", "bat_emergen_thr", 0.03, 0.1),
            Row("BAT_LOW_THR", "failsafe", "bat_low_thr", 0.12, 0.5),
            Row("COM_DISARM_LAND", "commander", "com_disarm_land_s", 0.1, 60.0),
            Row("COM_DISARM_PRFLT", "commander", "com_disarm_prflt_s", 1.0, 600.0),
            Row("COM_DL_LOSS_T", "failsafe", "com_dl_loss_t_s", 5, 300, int),
            Row("COM_LOW_BAT_ACT", "failsafe", "com_low_bat_act", 0, 3, int, choices=(0, 2, 3)),
            Row("COM_OBL_RC_ACT", "failsafe", "com_obl_rc_act", 0, 7, int, choices=tuple(range(8))),
            Row("COM_OF_LOSS_T", "failsafe", "com_of_loss_t_s", 0.1, 60.0),
            Row("COM_POS_FS_EPH", "failsafe", "com_pos_fs_eph_m", 0.5, 400.0),
            Row("EKF2_ACC_B_NOISE", "estimator", "acc_bias_walk", 1e-4, 1.0, float, SQRT_STEPS_PER_S),
            Row("EKF2_GPS_DELAY", "estimator", "ekf2_gps_delay_s", 0.0, 300.0, float, 1e3),
            Row("EKF2_NOAID_TOUT", "failsafe", "ekf2_noaid_tout_s", 500_000, 10_000_000, int, 1e6),
            Row("FD_FAIL_P", "failsafe", "fd_fail_tilt_rad", 30, 170, int, DEG),
            Row("FD_FAIL_R", "failsafe", "fd_fail_tilt_rad", 30, 170, int, DEG),
            Row("FD_FAIL_R_TTRI", "failsafe", "fd_fail_s", 0.02, 5.0),
            Row("LNDMC_ROT_MAX", "land_detector", "lndmc_rot_max_rps", 1.0, 180.0, float, DEG),
            Row("LNDMC_XY_VEL_MAX", "land_detector", "lndmc_xy_vel_max_mps", 0.1, 10.0),
            Row("LNDMC_Z_VEL_MAX", "land_detector", "lndmc_z_vel_max_mps", 0.05, 2.0),
            Row("MC_YAWRATE_MAX", "control", "mc_yawrate_max_rps", 1.0, 200.0, float, DEG),
            Row("MC_YAW_P", "control", "mc_yaw_p", 0.1, 5.0),
            Row("MIS_TAKEOFF_ALT", "navigator", "mis_takeoff_alt_m", 0.5, 120.0),
            Row("MPC_ACC_HOR", "control", "mpc_acc_hor_mps2", 2.0, 15.0),
            Row("MPC_LAND_ALT2", "control", "mpc_land_alt2_m", 0.0, 122.0),
            Row("MPC_LAND_SPEED", "control", "mpc_land_speed_mps", 0.6, 4.0),
            Row("MPC_THR_MIN", "control", "mpc_thr_min", 0.05, 0.4),
            Row("MPC_TILTMAX_AIR", "control", "mpc_tiltmax_air_rad", 20.0, 68.0, float, DEG),
            Row("MPC_TKO_RAMP_T", "control", "mpc_tko_ramp_t_s", 0.1, 5.0),
            Row("MPC_TKO_SPEED", "control", "mpc_tko_speed_mps", 1.0, 5.0),
            Row("MPC_XY_P", "control", "mpc_xy_p", 0.1, 2.0),
            Row("MPC_XY_VEL_D_ACC", "control", "mpc_xy_vel_d_acc", 0.1, 2.0),
            Row("MPC_XY_VEL_I_ACC", "control", "mpc_xy_vel_i_acc", 0.0, 60.0),
            Row("MPC_XY_VEL_MAX", "control", "mpc_xy_vel_max_mps", 0.5, 20.0),
            Row("MPC_XY_VEL_P_ACC", "control", "mpc_xy_vel_p_acc", 1.2, 5.0),
            Row("MPC_Z_P", "control", "mpc_z_p", 0.1, 1.5),
            Row("MPC_Z_VEL_D_ACC", "control", "mpc_z_vel_d_acc", 0.0, 2.0),
            Row("MPC_Z_VEL_I_ACC", "control", "mpc_z_vel_i_acc", 0.2, 3.0),
            Row("MPC_Z_VEL_MAX_DN", "control", "mpc_z_vel_max_dn_mps", 0.5, 4.0),
            Row("MPC_Z_VEL_MAX_UP", "control", "mpc_z_vel_max_up_mps", 0.5, 8.0),
            Row("MPC_Z_VEL_P_ACC", "control", "mpc_z_vel_p_acc", 2.0, 15.0),
            Row("NAV_DLL_ACT", "failsafe", "nav_dll_act", 0, 6, int, choices=(0, 1, 2, 3, 5, 6)),
            Row("RTL_CONE_ANG", "navigator", "rtl_cone_ang_rad", 1, 89, int, DEG),
            Row("RTL_MIN_DIST", "navigator", "rtl_min_dist_m", 0.5, 500.0),
            Row("RTL_RETURN_ALT", "navigator", "rtl_return_alt_m", 0.0, 120.0),
        ),
        key=lambda row: row.name,
    )
)
_ROW = {row.name: row for row in ROWS}


class Parameters:
    """Reads and sets the settings as parameters.

    Attributes:
        config: the present settings.
        battery: the present settings of the battery.
        names: names of all parameters, in the order of their index.
    """

    def __init__(self, config: AutopilotConfig, battery: BatteryConfig, system_id: int) -> None:
        self.config = config
        self.battery = battery
        self._fixed: dict[str, Value] = {
            "CAL_ACC0_ID": 1,
            "CAL_GYRO0_ID": 2,
            "CAL_MAG0_ID": 3,
            "MAV_COMP_ID": 1,
            "MAV_SYS_ID": system_id,
            "MAV_TYPE": 2,
            "MPC_THR_HOVER": config.control.mpc_thr_hover,
            "SYS_AUTOSTART": 10016,
        }
        self.names = tuple(sorted([*_ROW, *self._fixed]))

    def get(self, name: str) -> Value | None:
        """Value in PX4's unit and with the parameter's type; None if there is no such parameter."""
        row = _ROW.get(name)
        if row is None:
            return self._fixed.get(name)
        value = getattr(self._section(row), row.field) * row.factor
        return round(value) if row.kind is int else float(value)

    def set(self, name: str, value: Value) -> bool:
        """Set a parameter; returns False if it is unknown, fixed, of another type or out of range."""
        row = _ROW.get(name)
        if row is None or type(value) is not row.kind or not isfinite(value):
            return False
        if not row.low <= value <= row.high or (row.choices and value not in row.choices):
            return False
        if value != self.get(name):
            stored = value if row.factor == 1.0 else value / row.factor
            changed = msgspec.structs.replace(self._section(row), **{row.field: stored})
            if row.section == BATTERY:
                self.battery = changed
            else:
                self.config = msgspec.structs.replace(self.config, **{row.section: changed})
        return True

    def _section(self, row: Row) -> Any:
        return self.battery if row.section == BATTERY else getattr(self.config, row.section)
