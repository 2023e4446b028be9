"""Settings of the embedded autopilot. Names that PX4 has keep its names, with the unit appended."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]


class Rotor(Config, frozen=True, kw_only=True):
    """Where a rotor is in body FRD, and its yaw torque per newton of thrust.

    Attributes:
        km_m: positive when the rotor turns counter-clockwise seen from above, so that it yaws the body right.
    """

    x_frd_m: Annotated[float, Meta(ge=-10.0, le=10.0)]
    y_frd_m: Annotated[float, Meta(ge=-10.0, le=10.0)]
    km_m: Annotated[float, Meta(ge=-1.0, le=1.0)]


IRIS_ROTORS = (
    Rotor(x_frd_m=0.1515, y_frd_m=0.245, km_m=0.05),
    Rotor(x_frd_m=-0.1515, y_frd_m=-0.1875, km_m=0.05),
    Rotor(x_frd_m=0.1515, y_frd_m=-0.245, km_m=-0.05),
    Rotor(x_frd_m=-0.1515, y_frd_m=0.1875, km_m=-0.05),
)
"""PX4's airframe 10016."""


class Airframe(Config, frozen=True, kw_only=True):
    """What the controller believes about the vehicle.

    Attributes:
        inertia_frd_kgm2: (3,) diagonal.
        mpc_thr_hover: share of full thrust that hovers; with the mass it gives each rotor's full thrust.
        idle: command of the rotors while armed on the ground.
    """

    mass_kg: Positive = 1.5
    gravity_mps2: Positive = 9.81
    inertia_frd_kgm2: tuple[Positive, Positive, Positive] = (0.029, 0.029, 0.055)
    mpc_thr_hover: Annotated[float, Meta(ge=0.1, le=0.8)] = 0.5
    idle: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.05
    rotors: tuple[Rotor, Rotor, Rotor, Rotor] = IRIS_ROTORS


class EstimatorConfig(Config, frozen=True, kw_only=True):
    """The error-state Kalman filter.

    Attributes:
        declination_rad: of the magnetic field at the place of flight, positive east.
        field_horizontal_gauss: its horizontal part there.
        acc_density, gyro_density: white noise of the IMU, m/s²/√Hz and rad/s/√Hz.
        acc_bias_walk, gyro_bias_walk: random walk of the biases, m/s²/√s and rad/s/√s.
        acc_bias_std_mps2, gyro_bias_std_rps: of the biases at the start; the gyroscope's after averaging at rest.
        ekf2_gps_delay_s: how old a fix is when it arrives, if it doesn't tell when it was true.
        ekf2_gps_p_noise_m, gps_z_noise_m, ekf2_gps_v_noise_mps: standard deviation of one fix for the update. The
            position's is larger than its scatter because most of its error is slow.
        ekf2_gps_p_gate_m: a fix that is horizontally further than this from the estimate is rejected.
        ekf2_gps_v_gate_mps: the same for its velocity.
        gps_reset_s: after so long a rejection the position is reset to the fixes.
        ekf2_baro_noise_m, ekf2_baro_gate_m: the same for the pressure altitude.
        ekf2_head_noise_rad, ekf2_head_gate_rad: the same for the heading from the magnetometer.
        mag_check_gauss: a field whose horizontal part differs by more from that of the place is disturbed.
        align_s: the vehicle must stand still for so long before the filter starts.
        settle_s: and so long must it have run before it counts as settled.
    """

    declination_rad: Annotated[float, Meta(ge=-3.15, le=3.15)] = 0.0555
    field_horizontal_gauss: Positive = 0.216
    acc_density: Positive = 0.02
    gyro_density: Positive = 0.002
    acc_bias_walk: Positive = 0.003
    gyro_bias_walk: Positive = 0.0003
    acc_bias_std_mps2: Positive = 0.1
    gyro_bias_std_rps: Positive = 0.005
    ekf2_gps_delay_s: Annotated[float, Meta(ge=0.0, le=0.35)] = 0.1
    ekf2_gps_p_noise_m: Positive = 0.5
    gps_z_noise_m: Positive = 1.5
    ekf2_gps_v_noise_mps: Positive = 0.15
    ekf2_gps_p_gate_m: Positive = 1.2
    ekf2_gps_v_gate_mps: Positive = 1.0
    gps_reset_s: Positive = 3.0
    ekf2_baro_noise_m: Positive = 0.4
    ekf2_baro_gate_m: Positive = 3.0
    ekf2_head_noise_rad: Positive = 0.1
    ekf2_head_gate_rad: Positive = 0.6
    mag_check_gauss: Positive = 0.06
    align_s: Positive = 1.0
    settle_s: Positive = 2.0


class ControlConfig(Config, frozen=True, kw_only=True):
    """Gains and limits of the cascade position, velocity, attitude, rate.

    Attributes:
        mpc_xy_p, mpc_z_p: velocity per metre of position error, 1/s.
        mpc_acc_hor_mps2: deceleration that a position setpoint counts on when it is far away.
        mpc_xy_vel_p_acc, mpc_z_vel_p_acc: acceleration per velocity error, 1/s; `_i_` 1/s², `_d_` on acceleration.
        mpc_thr_min: least share of full thrust in flight.
        mc_rollpitch_p, mc_yaw_p: body rate per attitude error, 1/s.
        rate_p, yawrate_p: angular acceleration per rate error, 1/s; `_i` 1/s².
        mpc_tko_ramp_t_s: at takeoff the thrust limit rises from zero to full in this time.
        mpc_tko_speed_mps: climb of the takeoff mode.
        mpc_land_speed_mps: descent of the land mode below `mpc_land_alt2_m` above home.
        acc_filter_hz: low pass of the acceleration that the D term sees.
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
    mpc_thr_min: Annotated[float, Meta(ge=0.0, le=0.4)] = 0.12
    mc_rollpitch_p: Positive = 6.5
    mc_yaw_p: Positive = 2.8
    mc_rollpitchrate_max_rps: Positive = 3.8
    mc_yawrate_max_rps: Positive = 1.0
    rate_p: Positive = 20.0
    rate_i: NonNegative = 8.0
    yawrate_p: Positive = 6.0
    yawrate_i: NonNegative = 2.0
    mpc_tko_ramp_t_s: Positive = 1.0
    mpc_tko_speed_mps: Positive = 1.5
    mpc_land_speed_mps: Positive = 0.7
    mpc_land_alt2_m: NonNegative = 5.0
    acc_filter_hz: Positive = 5.0


class LandDetectorConfig(Config, frozen=True, kw_only=True):
    """When the vehicle counts as standing on something; see `land_detector`.

    Attributes:
        contact_s, maybe_landed_s, landed_s: how long each of the three stages must hold.
    """

    lndmc_z_vel_max_mps: Positive = 0.25
    lndmc_xy_vel_max_mps: Positive = 1.5
    lndmc_rot_max_rps: Positive = 0.349
    contact_s: Positive = 0.5
    maybe_landed_s: Positive = 0.25
    landed_s: Positive = 0.25


class CommanderConfig(Config, frozen=True, kw_only=True):
    """Arming.

    Attributes:
        offboard_stream_s: offboard is entered only with a setpoint younger than this.
        com_disarm_land_s, com_disarm_prflt_s: automatic disarm after landing, and after arming without taking off.
        sensor_timeout_s: a sensor that was silent for so long forbids arming.
        arm_tilt_rad: the vehicle must stand straighter than this to arm.
    """

    offboard_stream_s: Positive = 0.5
    com_disarm_land_s: Positive = 2.0
    com_disarm_prflt_s: Positive = 10.0
    sensor_timeout_s: Positive = 1.0
    arm_tilt_rad: Positive = 0.52


class FailsafeConfig(Config, frozen=True, kw_only=True):
    """When something counts as lost, and what is done about it; see `failsafes`.

    Attributes:
        com_of_loss_t_s: without offboard setpoints.
        com_obl_rc_act: 0 to 2 a pilot (there is none: land), 3 return, 4 land, 5 hold, 6 and 7 motors off.
        com_dl_loss_t_s: without the heartbeat of a ground station.
        nav_dll_act: 0 nothing, 1 hold, 2 return, 3 land, 5 and 6 motors off.
        com_low_bat_act: 0 warn, 2 land, 3 return at the critical and land at the emergency level.
        bat_low_thr, bat_crit_thr, bat_emergen_thr: share of the battery that remains.
        com_pos_fs_eph_m: horizontal standard deviation of the position.
        ekf2_noaid_tout_s: without a GNSS fix.
        fd_fail_tilt_rad, fd_fail_s: tilted further for so long.
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
        mis_takeoff_alt_m: height of a takeoff that names none, and the least of one that does.
        rtl_return_alt_m: height above home to fly home at, unless the vehicle is higher.
        rtl_min_dist_m: nearer to home than this it needs no more height than a cone of `rtl_cone_ang_rad` about home.
    """

    mis_takeoff_alt_m: Positive = 2.5
    rtl_return_alt_m: NonNegative = 60.0
    rtl_min_dist_m: Positive = 10.0
    rtl_cone_ang_rad: Annotated[float, Meta(gt=0.0, lt=1.57)] = 0.7854


class BatteryConfig(Config, frozen=True, kw_only=True):
    """The battery: a voltage that falls with the charge, and an inner resistance.

    Attributes:
        bat1_v_charged_v, bat1_v_empty_v, bat1_r_internal_ohm: per cell.
        charge_at_start: share of the capacity.
        electronics_a: drawn by everything but the rotors.
        hover_a: drawn by the rotors in hover.
    """

    bat1_capacity_mah: Positive = 5000.0
    bat1_n_cells: Annotated[int, Meta(ge=1, le=16)] = 4
    bat1_v_charged_v: Positive = 4.05
    bat1_v_empty_v: Positive = 3.6
    bat1_r_internal_ohm: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.005
    charge_at_start: Annotated[float, Meta(ge=0.0, le=1.0)] = 1.0
    electronics_a: NonNegative = 0.5
    hover_a: Positive = 15.0


class TelemetryConfig(Config, frozen=True, kw_only=True):
    """Attributes: interval_min_s: no message is streamed more often, whoever asks: PX4 too spares a slow link."""

    interval_min_s: Annotated[float, Meta(ge=0.004, le=1.0)] = 0.004


class SigningConfig(Config, frozen=True, kw_only=True):
    """MAVLink 2 signing.

    Attributes:
        key: 64 hexadecimal digits; "" is off.
        links: where it is demanded. The offboard link stays within the vehicle.
    """

    key: Annotated[str, Meta(pattern=r"^([0-9a-fA-F]{64})?$")] = ""
    links: tuple[Literal["gcs", "offboard"], ...] = ("gcs",)


class AutopilotConfig(Config, frozen=True, kw_only=True):
    """All of it; `deploy/config/autopilot.toml`.

    Attributes:
        autopilot: who flies; PX4 has settings of its own. JEZERO_AUTOPILOT goes before this one.
    """

    autopilot: Literal["embedded", "px4"] = "embedded"
    airframe: Airframe = Airframe()
    estimator: EstimatorConfig = EstimatorConfig()
    control: ControlConfig = ControlConfig()
    land_detector: LandDetectorConfig = LandDetectorConfig()
    commander: CommanderConfig = CommanderConfig()
    failsafe: FailsafeConfig = FailsafeConfig()
    navigator: NavigatorConfig = NavigatorConfig()
    battery: BatteryConfig = BatteryConfig()
    telemetry: TelemetryConfig = TelemetryConfig()
    signing: SigningConfig = SigningConfig()
