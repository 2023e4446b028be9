"""Settings of the embedded autopilot. Settings that PX4 has too keep PX4's names, with the unit appended."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config
from jezero.schemas.struct import END

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]


class StateEstimatorConfig(Config, frozen=True, kw_only=True):
    """The error-state Kalman filter.

    Attributes:
        declination_rad: declination of the magnetic field at the place of flight, positive east.
        field_horizontal_gauss: strength of the horizontal part of the magnetic field at the place of flight.
        acc_bias_walk: random walk of the accelerometer bias, m/s²/√s.
        ekf2_gps_delay_s: age of a GNSS fix at its arrival, if it has no time stamp.
        ekf2_gps_p_noise_m: standard deviation of a fix's horizontal position for the update. It is larger than the
            position's scatter, because most of the error varies slowly.
        ekf2_gps_v_noise_mps: standard deviation of a fix's velocity for the update.
        ekf2_gps_p_gate_m: gate of a fix's horizontal innovation; a fix with a larger one is rejected.
        ekf2_gps_v_gate_mps: gate of a fix's velocity innovation; a fix with a larger one is rejected.
        ekf2_baro_noise_m: standard deviation of the pressure altitude for the update.
        ekf2_baro_gate_m: gate of the pressure altitude's innovation; a reading with a larger one is rejected.
        ekf2_head_noise_rad: standard deviation of the magnetic heading for the update.
        ekf2_head_gate_rad: gate of the magnetic heading's innovation; a reading with a larger one is rejected.
    """

    declination_rad: Annotated[float, Meta(ge=-3.15, le=3.15)] = 0.0555
    field_horizontal_gauss: Positive = 0.216
    acc_bias_walk: Positive = 0.003
    ekf2_gps_delay_s: Annotated[float, Meta(ge=0.0, le=0.35)] = 0.1
    ekf2_gps_p_noise_m: Positive = 0.5
    ekf2_gps_v_noise_mps: Positive = 0.15
    ekf2_gps_p_gate_m: Positive = 1.2
    ekf2_gps_v_gate_mps: Positive = 1.0
    ekf2_baro_noise_m: Positive = 0.4
    ekf2_baro_gate_m: Positive = 3.0
    ekf2_head_noise_rad: Positive = 0.1
    ekf2_head_gate_rad: Positive = 0.3


class ControlConfig(Config, frozen=True, kw_only=True):
    """Gains and limits of the cascaded controllers of position, velocity, attitude and rate.

    Attributes:
        mpc_xy_p: horizontal velocity per position error, 1/s.
        mpc_z_p: vertical velocity per position error, 1/s.
        mpc_acc_hor_mps2: deceleration assumed on the way to a distant position setpoint.
        mpc_xy_vel_max_mps: maximum horizontal speed.
        mpc_z_vel_max_up_mps: maximum speed upwards.
        mpc_z_vel_max_dn_mps: maximum speed downwards.
        mpc_xy_vel_p_acc: horizontal acceleration per velocity error, 1/s.
        mpc_xy_vel_i_acc: horizontal acceleration per integrated velocity error, 1/s².
        mpc_xy_vel_d_acc: factor of the measured horizontal acceleration that is subtracted for damping.
        mpc_z_vel_p_acc: vertical acceleration per velocity error, 1/s.
        mpc_z_vel_i_acc: vertical acceleration per integrated velocity error, 1/s².
        mpc_z_vel_d_acc: factor of the measured vertical acceleration that is subtracted for damping.
        mpc_tiltmax_air_rad: maximum tilt in the air.
        mpc_thr_hover: hover thrust as a fraction of full thrust; with the mass it gives each rotor's full thrust.
        mpc_thr_min: minimum thrust in flight as a fraction of full thrust.
        mc_rollpitch_p: roll and pitch rate per attitude error, 1/s.
        mc_yaw_p: yaw rate per attitude error, 1/s.
        mc_rollpitchrate_max_rps: maximum rate about the roll axis and about the pitch axis.
        mc_yawrate_max_rps: maximum yaw rate.
        rollpitchrate_p_1ps: angular acceleration about the roll and the pitch axis per error of the rate.
        rollpitchrate_i_1ps2: the same per integrated error.
        yawrate_p_1ps: angular acceleration about the yaw axis per error of the rate.
        yawrate_i_1ps2: the same per integrated error.
        mpc_tko_ramp_t_s: time in which the thrust limit rises from zero to full at takeoff.
        mpc_tko_speed_mps: climb speed of the takeoff mode.
        mpc_land_speed_mps: descent speed of the land mode below `mpc_land_alt2_m`.
        mpc_land_alt2_m: height above home below which the land mode descends at `mpc_land_speed_mps`.
    """

    mpc_xy_p: Positive = 1.0
    mpc_z_p: Positive = 1.0
    mpc_acc_hor_mps2: Positive = 3.0
    mpc_xy_vel_max_mps: Positive = 5.0
    mpc_z_vel_max_up_mps: Positive = 3.0
    mpc_z_vel_max_dn_mps: Positive = 1.5
    mpc_xy_vel_p_acc: Positive = 4.0
    mpc_xy_vel_i_acc: NonNegative = 1.5
    mpc_xy_vel_d_acc: NonNegative = 0.2
    mpc_z_vel_p_acc: Positive = 4.0
    mpc_z_vel_i_acc: NonNegative = 2.0
    mpc_z_vel_d_acc: NonNegative = 0.0
    mpc_tiltmax_air_rad: Annotated[float, Meta(gt=0.0, le=1.2)] = 0.611
    mpc_thr_hover: Annotated[float, Meta(ge=0.1, le=0.8)] = 0.5
    mpc_thr_min: Annotated[float, Meta(ge=0.0, le=0.4)] = 0.12
    mc_rollpitch_p: Positive = 6.5
    mc_yaw_p: Positive = 2.8
    mc_rollpitchrate_max_rps: Positive = 3.8
    mc_yawrate_max_rps: Positive = 1.0
    rollpitchrate_p_1ps: Positive = 20.0
    rollpitchrate_i_1ps2: NonNegative = 8.0
    yawrate_p_1ps: Positive = 6.0
    yawrate_i_1ps2: NonNegative = 2.0
    mpc_tko_ramp_t_s: Positive = 1.0
    mpc_tko_speed_mps: Positive = 1.5
    mpc_land_speed_mps: Positive = 0.7
    mpc_land_alt2_m: NonNegative = 5.0


class LandDetectorConfig(Config, frozen=True, kw_only=True):
    """Thresholds of the land detector. Source: PX4's `MulticopterLandDetector`.

    Attributes:
        lndmc_z_vel_max_mps: vertical speed above which the vehicle is not landed.
        lndmc_xy_vel_max_mps: horizontal speed above which the vehicle is not landed.
        lndmc_rot_max_rps: angular rate above which the vehicle is not landed.
        landed_s: time in the stage `maybe landed` (low thrust, no motion) after which the vehicle counts as landed.
    """

    lndmc_z_vel_max_mps: Positive = 0.25
    lndmc_xy_vel_max_mps: Positive = 1.5
    lndmc_rot_max_rps: Positive = 0.349
    landed_s: Positive = 0.25


class CommanderConfig(Config, frozen=True, kw_only=True):
    """Automatic disarming.

    Attributes:
        com_disarm_land_s: time from landing to automatic disarming.
        com_disarm_prflt_s: time from arming to automatic disarming if the vehicle does not take off.
    """

    com_disarm_land_s: Positive = 2.0
    com_disarm_prflt_s: Positive = 10.0


class FailsafeConfig(Config, frozen=True, kw_only=True):
    """Triggers and actions of the failsafes; docs/reliability.md has a table of both.

    Attributes:
        com_of_loss_t_s: time-out of offboard setpoints.
        com_obl_rc_act: action on lost setpoints: 0 to 2 land instead of a pilot, 3 return, 4 land, 5 hold, 6 and 7
            disarm.
        com_dl_loss_t_s: time without a connection to a ground station that counts as a lost one.
        nav_dll_act: action on a lost ground station: 0 none, 1 hold, 2 return, 3 land, 5 and 6 disarm.
        com_low_bat_act: action at the critical and the emergency level of the battery: 0 warn, 2 land, 3 return at the
            critical level and land at the emergency level.
        bat_low_thr: remaining fraction of the battery at the low level, which gives a warning.
        bat_crit_thr: remaining fraction of the battery at the critical level, below which arming is refused too.
        bat_emergen_thr: remaining fraction of the battery at the emergency level.
        com_pos_fs_eph_m: maximum standard deviation of the horizontal position.
        ekf2_noaid_tout_s: time-out of GNSS fixes.
        fd_fail_tilt_rad: maximum tilt; a vehicle with a larger one for `fd_fail_s` is disarmed by the failure detector.
        fd_fail_s: time with a larger tilt than `fd_fail_tilt_rad` after which the failure detector disarms the vehicle.
    """

    com_of_loss_t_s: Positive = 1.0
    com_obl_rc_act: Literal[0, 1, 2, 3, 4, 5, 6, 7] = 0
    com_dl_loss_t_s: Positive = 10.0
    nav_dll_act: Literal[0, 1, 2, 3, 5, 6] = 0
    com_low_bat_act: Literal[0, 2, 3] = 0
    bat_low_thr: Annotated[float, Meta(ge=0.12, le=0.5)] = 0.15
    bat_crit_thr: Annotated[float, Meta(ge=0.05, le=0.25)] = 0.07
    bat_emergen_thr: Annotated[float, Meta(ge=0.03, le=0.1)] = 0.05
    com_pos_fs_eph_m: Positive = 5.0
    ekf2_noaid_tout_s: Positive = 5.0
    fd_fail_tilt_rad: Positive = 1.047
    fd_fail_s: Positive = 0.5


class NavigatorConfig(Config, frozen=True, kw_only=True):
    """Takeoff and return.

    Attributes:
        mis_takeoff_alt_m: height above the vehicle of a takeoff whose command gives no height.
        rtl_return_alt_m: height of the return above home, unless the vehicle is higher.
        rtl_min_dist_m: distance from home within which the height of the return is limited by a cone above home.
        rtl_cone_ang_rad: half angle of the cone that limits the height of the return near home; its tip is at home.
    """

    mis_takeoff_alt_m: Positive = 2.5
    rtl_return_alt_m: NonNegative = 60.0
    rtl_min_dist_m: Positive = 10.0
    rtl_cone_ang_rad: Annotated[float, Meta(gt=0.0, lt=1.57)] = 0.7854


class TelemetryConfig(Config, frozen=True, kw_only=True):
    """MAVLink links: telemetry streams, and who may send.

    Attributes:
        interval_min_s: minimum interval of a stream, whatever SET_MESSAGE_INTERVAL requests; PX4 also limits the rates.
        ground_systems: MAVLink system ids of the ground stations whose messages are taken, besides those of the
            vehicle's own system, which the bridge belongs to. QGroundControl, MAVProxy and pymavlink have 255, MAVSDK
            has 245.
        force_disarm_systems: MAVLink system ids that may stop the motors in the air over the link of ground stations,
            by a forced disarm. Without any, these are the systems that sent something before the takeoff.
    """

    interval_min_s: Annotated[float, Meta(ge=0.004, le=1.0)] = 0.004
    ground_systems: tuple[Annotated[int, Meta(ge=1, le=255)], ...] = (245, 250, 251, 252, 253, 254, 255)
    force_disarm_systems: tuple[Annotated[int, Meta(ge=1, le=255)], ...] = ()


class SigningConfig(Config, frozen=True, kw_only=True):
    """MAVLink 2 signing.

    Attributes:
        key: 64 hexadecimal digits; "" switches signing off.
        links: links that require signatures. The offboard link stays within the vehicle.
    """

    key: Annotated[str, Meta(pattern=rf"^([0-9a-fA-F]{{64}})?{END}")] = ""
    links: tuple[Literal["gcs", "offboard"], ...] = ("gcs",)


class AutopilotConfig(Config, frozen=True, kw_only=True):
    """Settings of the service, `deploy/config/autopilot.toml`.

    Attributes:
        autopilot: the autopilot to run; PX4 has settings of its own. The environment variable `JEZERO_AUTOPILOT`
            overrides this setting.
        estimator: the error-state Kalman filter.
        control: gains and limits of the controllers.
        land_detector: thresholds of the land detector.
        commander: automatic disarming.
        failsafe: triggers and actions of the failsafes.
        navigator: takeoff and return.
        charge_at_start: remaining fraction of the battery's capacity at the start.
        battery_swap_s: a person puts in a full battery when the vehicle has landed with less than half of its charge
            and has been disarmed for this long; 0: nobody does.
        telemetry: telemetry streams.
        signing: MAVLink 2 signing.
    """

    autopilot: Literal["embedded", "px4"] = "embedded"
    estimator: StateEstimatorConfig = StateEstimatorConfig()
    control: ControlConfig = ControlConfig()
    land_detector: LandDetectorConfig = LandDetectorConfig()
    commander: CommanderConfig = CommanderConfig()
    failsafe: FailsafeConfig = FailsafeConfig()
    navigator: NavigatorConfig = NavigatorConfig()
    charge_at_start: Annotated[float, Meta(ge=0.0, le=1.0)] = 1.0
    battery_swap_s: Annotated[float, Meta(ge=0.0, le=3600.0)] = 0.0
    telemetry: TelemetryConfig = TelemetryConfig()
    signing: SigningConfig = SigningConfig()
