"""Estimator service: turns messages into measurements, serves parameter requests and publishes the estimate."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import hypot
from typing import NamedTuple

import numpy as np

from jezero.base.arrays import Array
from jezero.base.detectors import FrozenSensorDetector
from jezero.base.frames import Quat, Vec3, add, quat_rotate, scale, subtract, wrap_pi, yaw_from_quat
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Reply, Spec
from jezero.schemas import sensors, topics
from jezero.schemas.estimate import Relative, RoverEstimate, TagEstimate
from jezero.schemas.state import Odometry
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.arrivals import Arrivals
from jezero.services.estimator.attitude_history import AttitudeHistory
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.innovations import Observer
from jezero.services.estimator.measurements import (
    AltimeterMeasurement,
    Kind,
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
)
from jezero.services.estimator.range_outliers import RangeOutlierFilter
from jezero.services.estimator.relative_filter import FilterEstimate, RelativeFilter
from jezero.services.estimator.rover_plausibility import RoverPlausibilityCheck
from jezero.services.estimator.rover_tilt import LEVEL, level_from_rover_body
from jezero.services.estimator.selection import InputSelection

UPPER_6 = np.triu_indices(6)
ATTITUDE_AGE_MAX_S = 0.06
RANGE_STD_FACTOR = 1.5
"""Factor on the ranges' estimated noise, as each anchor also has a constant error."""
RANGE_MARGIN = 1.1
"""Ranges greater than this times the sensor's greatest range are none that it has measured."""
STD_MAX_M = 1e5
COV_UNKNOWN = tuple((STD_MAX_M**2 * np.eye(6))[UPPER_6].tolist())
EARLY_NS = 5_000_000
"""Odometry, after which the estimate is published, may come earlier than it is due by a quarter of its period."""
INVALID_PERIOD_NS = 100_000_000
"""Without odometry, the estimate is published as invalid with this period."""
ROVER_PERIOD_NS = NS_PER_S // 10
ZERO: Vec3 = (0.0, 0.0, 0.0)
UWB, TAG = "UWB", "the tag"
INPUT_NAMES: dict[Kind, str] = {"rover": "the rover's odometry", "uwb": UWB, "tag": TAG}
"""Names for people."""

SPEC = Spec(
    name="estimator",
    inputs=(
        topics.CLOCK,
        topics.ODOMETRY,
        topics.UWB,
        topics.ALTIMETER,
        topics.ROVER_ODOMETRY,
        topics.ESTIMATE_TAG,
    ),
    outputs=(topics.RELATIVE, topics.ROVER_ESTIMATE),
    serves=(topics.GET_PARAMETERS, topics.SET_PARAMETERS, topics.LEASE),
    triggers=(
        topics.ODOMETRY.name,
        topics.GET_PARAMETERS.name,
        topics.SET_PARAMETERS.name,
        topics.LEASE.name,
    ),
    rate_hz=10.0,
)


class _ActiveSelection(NamedTuple):
    """Selected inputs; the filter restarts when one is deselected or the prior position changes."""

    use_uwb: bool
    use_tag: bool
    prior_pos_rover_ned_m: Vec3 | None


class Estimator:
    """Fuses sensor measurements and publishes the relative position whenever odometry arrives."""

    def __init__(self, config: EstimatorConfig, vehicle: VehicleConfig) -> None:
        self.spec = replace(SPEC, made_with={"config": config, "vehicle": vehicle})
        self._config = config
        self._vehicle = vehicle
        self._selection = InputSelection(config.tuning)
        self._filter = RelativeFilter(config.tuning, config.validity, vehicle.platform, deck_moves=config.deck_moves)
        self._attitude = AttitudeHistory(ATTITUDE_AGE_MAX_S)
        self._outlier_filter = RangeOutlierFilter()
        self._rover_check = RoverPlausibilityCheck()
        self._tag_freeze = FrozenSensorDetector()
        self._epoch_id: int | None = None
        self._arrivals = Arrivals(config.validity)
        self._odometry: Odometry | None = None
        self._rover_odometry_ns: int | None = None
        self._R_level_from_rover_body = LEVEL
        self._active_selection = self._current_selection()
        self._goal_id = ""
        """Goal of the selection in force, for which inputs may have been left out."""
        self._restart_due = True
        self._published_ns = 0
        self._rover_published_ns = 0
        self._health = ""

    def observe_innovations(self, observer: Observer) -> None:
        """Call `observer` with each innovation of the filter from now on."""
        self._filter.observe_innovations(observer)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Serve requests, fuse new measurements and publish the estimate."""
        self._handle_epoch(t_ns, inbox)
        yield from self._serve(t_ns, inbox)
        self._selection.expire(t_ns)
        self._apply_selection()
        fresh = self._odometry_measurements(t_ns, inbox)
        self._restart_if_due()
        measurements = [*fresh, *self._measurements(t_ns, inbox)]
        if measurements:
            self._filter.add(measurements)
        reason = self._invalid_reason(t_ns)
        yield from self._publish(t_ns, bool(fresh), reason)
        yield from self._publish_health(reason)

    # -- epochs, requests, selection -----------------------------------------------------------------------

    def _handle_epoch(self, t_ns: int, inbox: Inbox) -> None:
        clock = inbox.latest(topics.CLOCK)
        if clock is None or clock.epoch_id == self._epoch_id:
            return
        if self._epoch_id is not None:
            self._selection.end_lease()
            self._reset(clock.t_ns)
        self._epoch_id = clock.epoch_id

    def _reset(self, t_ns: int) -> None:
        self._arrivals.since_ns = t_ns
        self._odometry = None
        self._rover_odometry_ns = None
        self._R_level_from_rover_body = LEVEL
        self._outlier_filter.clear()
        self._rover_check.clear()
        self._filter.deck.restart()
        self._restart_due = True

    def _serve(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for request in inbox.requests(topics.GET_PARAMETERS):
            yield Reply(request.request_id, self._selection.get())
        for request in inbox.requests(topics.SET_PARAMETERS):
            reply = self._selection.set(request.payload)
            if reply.accepted:
                self._filter.set_tuning(self._selection.tuning)
                self._restart_due |= request.payload.pos_rover_ned_m is not None
            yield Reply(request.request_id, reply)
        for request in inbox.requests(topics.LEASE):
            yield Reply(request.request_id, self._selection.lease(t_ns, request.payload))

    def _current_selection(self) -> _ActiveSelection:
        selection = self._selection
        return _ActiveSelection(selection.use_uwb, selection.use_tag, selection.prior_pos_rover_ned_m)

    def _apply_selection(self) -> None:
        """Schedule a restart when an input was deselected or the prior position changed."""
        current, before = self._current_selection(), self._active_selection
        self._active_selection = current
        deselected = (before.use_uwb and not current.use_uwb) or (before.use_tag and not current.use_tag)
        if self._selection.goal_id != self._goal_id:
            self._goal_id = self._selection.goal_id
            self._restart_due |= bool(self._filter.consistency.left_out)
            self._filter.consistency.readmit()
        self._restart_due |= deselected or current.prior_pos_rover_ned_m != before.prior_pos_rover_ned_m

    def _restart_if_due(self) -> None:
        """Restart the filter; a prior position needs the odometry's reset offset, so this waits for odometry."""
        if not self._restart_due or self._odometry is None:
            return
        self._restart_due = False
        prior_pos_rover_ned_m = self._selection.prior_pos_rover_ned_m
        if prior_pos_rover_ned_m is None:
            self._filter.restart()
        else:
            prior_pos_m = np.array(subtract(prior_pos_rover_ned_m, self._odometry.reset_offset_ned_m))
            self._filter.restart((prior_pos_m, self._selection.tuning.std_rover_m))

    # -- messages to measurements --------------------------------------------------------------------------

    def _odometry_measurements(self, t_ns: int, inbox: Inbox) -> list[Measurement]:
        measurements: list[Measurement] = []
        for odometry in inbox.new(topics.ODOMETRY):
            if odometry.epoch_id != self._epoch_id or not self._arrivals.is_timely(t_ns, odometry.t_ns, "the odometry"):
                continue
            if self._odometry is not None and odometry.t_ns <= self._odometry.t_ns:
                continue
            reset = self._odometry is not None and odometry.reset_counter != self._odometry.reset_counter
            self._odometry = odometry
            self._attitude.add(odometry)
            pos_m = subtract(odometry.pos_uav_ned_m, odometry.reset_offset_ned_m)
            measurements.append(OdometryMeasurement(odometry.t_ns, np.array(pos_m + odometry.vel_uav_ned_mps), reset))
        return measurements

    def _measurements(self, t_ns: int, inbox: Inbox) -> Iterator[Measurement]:
        for rover in inbox.new(topics.ROVER_ODOMETRY):
            if self._arrivals.is_timely(t_ns, rover.t_ns, "the rover's odometry") and self._is_plausible(rover):
                self._rover_odometry_ns = rover.t_ns
                self._R_level_from_rover_body = level_from_rover_body(rover)
                self._filter.deck.add_tilt(rover.t_ns, rover.roll_rover_rad, rover.pitch_rover_rad)
                yield self._rover_measurement(rover)
        for altimeter in inbox.new(topics.ALTIMETER):
            range_m = altimeter.range_m
            if range_m is None or not self._arrivals.is_timely(t_ns, altimeter.t_ns, "the altimeter"):
                continue
            if self._is_possible(range_m, self._vehicle.altimeter.range_max_m):
                yield from self._altimeter_measurement(altimeter, range_m)
        if self._selection.use_uwb:
            for uwb in inbox.new(topics.UWB):
                if uwb.ranges and self._arrivals.is_timely(t_ns, uwb.t_ns, UWB):
                    yield from self._uwb_measurement(uwb)
        if self._selection.use_tag:
            for tag in inbox.new(topics.ESTIMATE_TAG):
                if self._arrivals.is_timely(t_ns, tag.t_ns, TAG):
                    yield from self._tag_measurement(tag)

    def _is_plausible(self, rover: sensors.RoverOdometry) -> bool:
        plausible = self._rover_check.is_plausible(rover)
        self._arrivals.dropped += not plausible
        return plausible

    def _is_possible(self, range_m: float, range_max_m: float) -> bool:
        """Whether a sensor can have measured this range; a filter that began with another would be lost far away."""
        possible = range_m <= RANGE_MARGIN * range_max_m
        self._arrivals.dropped += not possible
        return possible

    def _rover_measurement(self, rover: sensors.RoverOdometry) -> RoverOdometryMeasurement:
        tuning = self._selection.tuning
        return RoverOdometryMeasurement(
            rover.t_ns,
            rover.speed_rover_body_mps,
            rover.yaw_rover_rad,
            rover.yaw_rate_rover_rps,
            tuning.std_speed_rover_mps,
            hypot(tuning.std_yaw_rover_rad, self._config.std_time_s * rover.yaw_rate_rover_rps),
            tuning.std_yaw_rate_rover_rps,
            heaves=self._filter.deck.moves,
        )

    def _lever(self, t_ns: int, mount_frd_m: Vec3) -> Array | None:
        """(3,) lever arm in NED from the vehicle's position to a sensor; None without an attitude for that time."""
        q_ned_from_frd = self._attitude.at(t_ns)
        if q_ned_from_frd is None:
            return None
        x, y, z = quat_rotate(q_ned_from_frd, mount_frd_m)
        return np.array((x, y, z - self._vehicle.airframe.height_stand_m))

    def _altimeter_measurement(self, altimeter: sensors.Altimeter, range_m: float) -> Iterator[Measurement]:
        lever_m = self._lever(altimeter.t_ns, self._vehicle.altimeter.pos_altimeter_frd_m)
        q_ned_from_frd = self._attitude.at(altimeter.t_ns)
        if lever_m is not None and q_ned_from_frd is not None:
            beam_ned = np.array(quat_rotate(q_ned_from_frd, (0.0, 0.0, 1.0)))
            half_m = 0.5 * self._vehicle.platform.side_m
            std_m = self._selection.tuning.std_altimeter_m
            normal_level = self._R_level_from_rover_body[:, 2]
            yield AltimeterMeasurement(altimeter.t_ns, range_m, lever_m, beam_ned, half_m, std_m, normal_level)

    def _uwb_measurement(self, uwb: sensors.Uwb) -> Iterator[Measurement]:
        """Ranges with line of sight; their noise is the parameter's or the estimated one, whichever is greater."""
        std_m = max(self._selection.tuning.std_uwb_m, RANGE_STD_FACTOR * self._outlier_filter.std_m)
        possible = tuple(r for r in uwb.ranges if self._is_possible(r.range_m, self._vehicle.uwb.range_max_m))
        ranges = self._outlier_filter.filter(possible, std_m)
        if not ranges:
            return
        t_ns = sum(r.t_ns for r in ranges) // len(ranges)
        lever_m = self._lever(t_ns, self._vehicle.uwb.pos_tag_frd_m)
        if lever_m is not None:
            yield UwbMeasurement(
                t_ns,
                lever_m,
                np.array([r.pos_anchor_rover_body_m for r in ranges]),
                np.array([r.range_m for r in ranges]),
                np.array([(r.t_ns - t_ns) * 1e-9 for r in ranges]),
                std_m,
                self._R_level_from_rover_body,
                self._config.std_time_s,
            )

    def _tag_measurement(self, tag: TagEstimate) -> Iterator[Measurement]:
        q_ned_from_frd = self._attitude.at(tag.t_ns)
        if q_ned_from_frd is None:
            return
        if self._tag_freeze.is_frozen(tag.pos_uav_rel_rover_ned_m):  # the camera shows the same picture all the time
            self._arrivals.dropped += 1
            return
        lever_arm_m = np.array(tag.pos_uav_rel_rover_ned_m)
        xx, xy, xz, yy, yz, zz = tag.cov_pos_ned_m2
        cov_m2 = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        if float(np.linalg.eigvalsh(cov_m2)[0]) < -1e-9:
            self._arrivals.dropped += 1
            return
        knows_yaw = tag.yaw_rover_rad is not None and bool(tag.std_yaw_rover_rad)
        yield TagMeasurement(
            tag.t_ns,
            lever_arm_m + np.array((0.0, 0.0, self._vehicle.airframe.height_stand_m)),
            lever_arm_m,
            cov_m2,
            yaw_from_quat(q_ned_from_frd),
            tag.yaw_rover_rad if knows_yaw else None,
            tag.std_yaw_rover_rad or 1.0,
            self._selection.tuning.scale_std_tag,
            self._config.std_time_s,
            self._swing_mps(lever_arm_m, q_ned_from_frd),
        )

    def _swing_mps(self, arm_m: Array, q_ned_from_frd: Quat) -> Array:
        """(3,) speed in NED at which the vehicle's rotation moves what a lever arm points at."""
        if self._odometry is None:
            return np.zeros(3)
        return np.cross(quat_rotate(q_ned_from_frd, self._odometry.rates_uav_frd_rps), arm_m)

    # -- why the estimate is invalid, in words that say what to check --------------------------------------

    def _invalid_reason(self, t_ns: int) -> str:
        """Why the filter's estimate is invalid, its causes first; "" for a valid estimate."""
        odometry_ns = None if self._odometry is None else self._odometry.t_ns
        if odometry_ns is None or t_ns - odometry_ns > self._config.validity.odometry_timeout_s * NS_PER_S:
            reason = "no odometry of the vehicle"
        else:
            reason = next(self._invalid_reasons(t_ns), "")
        if not reason:
            return ""
        causes = (
            self._filter.consistency.left_out,
            self._arrivals.late_reason(t_ns, UWB) if self._selection.use_uwb else "",
            self._arrivals.late_reason(t_ns, TAG) if self._selection.use_tag else "",
        )
        return "; ".join(text for text in (*causes, reason) if text)

    def _invalid_reasons(self, t_ns: int) -> Iterator[str]:
        """What makes the filter's estimate invalid, the most important reason first."""
        validity, selection, relative = self._config.validity, self._selection, self._filter
        selected = " and ".join(n for n, use in ((UWB, selection.use_uwb), ("tag", selection.use_tag)) if use)
        if not selected:
            yield "neither UWB nor tag is selected"
        if not relative.located:
            missing = "; the rover's odometry is missing" if self._rover_odometry_ns is None else ""
            yield f"the rover has not been found yet by {selected}{missing}"
        if relative.fused_ns == 0:
            yield f"nothing measured by {selected} yet"
        silent_s = (t_ns - relative.fused_ns) / NS_PER_S
        if silent_s > validity.aiding_timeout_s:
            yield f"nothing measured by {selected} for {silent_s:.0f} s: {_advice(selection)}"
        if relative.std_pos_m > validity.std_pos_max_m:
            known = f"the rover's position is known to {relative.std_pos_m:.1f} m by {selected}"
            used = f"the last measurement is {silent_s:.1f} s old"
            yield f"{known}, {validity.std_pos_max_m:g} m are needed (std_pos_max_m), {used}: {_advice(selection)}"
        if relative.consistency.height:
            yield relative.consistency.height
        if relative.has_input_conflict:
            yield "UWB and tag contradict each other"
        if relative.rejected_inputs:
            names = [INPUT_NAMES[kind] for kind in relative.rejected_inputs]
            yield f"the estimate is contradicted by {' and '.join(names)}"

    def _is_contradicted(self) -> bool:
        """Whether inputs contradict each other or the altimeter; to be called for an invalid estimate."""
        relative = self._filter
        monitor, selection = relative.consistency, self._selection
        left_out = (monitor.uwb_left_out and selection.use_uwb) or (monitor.tag_left_out and selection.use_tag)
        return bool(left_out) or bool(monitor.height) or relative.has_input_conflict

    # -- outputs ------------------------------------------------------------------------------------------

    def _publish(self, t_ns: int, fresh: bool, reason: str) -> Iterator[Output]:
        period_ns = int(NS_PER_S / self._selection.tuning.rate_relative_hz)
        since_ns = t_ns - self._published_ns
        if self._epoch_id is None or 0 <= since_ns < (period_ns - EARLY_NS if fresh else INVALID_PERIOD_NS):
            return
        self._published_ns = t_ns
        estimate = self._filter.estimate
        yield Publish(topics.RELATIVE, self._relative(t_ns, estimate, reason))
        odometry = self._odometry
        if estimate is not None and odometry is not None and t_ns - self._rover_published_ns >= 0.9 * ROVER_PERIOD_NS:
            self._rover_published_ns = t_ns
            yield Publish(topics.ROVER_ESTIMATE, self._rover_estimate(estimate, odometry, reason))

    def _relative(self, t_ns: int, estimate: FilterEstimate | None, reason: str) -> Relative:
        selection, located = self._selection, self._filter.located
        known = estimate if located else None
        return Relative(
            t_ns=t_ns if estimate is None else estimate.t_ns,
            epoch_id=self._epoch_id or 0,
            valid=not reason,
            reason=reason,
            contradicted=bool(reason) and self._is_contradicted(),
            pos_uav_rel_rover_ned_m=ZERO if known is None else _vec3(known.pos_rel_m),
            vel_uav_rel_rover_ned_mps=ZERO if known is None else _vec3(known.vel_rel_mps),
            cov=COV_UNKNOWN if known is None else tuple(known.cov[UPPER_6].tolist()),
            vel_rover_ned_mps=ZERO if estimate is None else _vec3(estimate.vel_rover_mps),
            yaw_rover_rad=0.0 if estimate is None else wrap_pi(estimate.yaw_rover_rad),
            yaw_rate_rover_rps=0.0 if estimate is None else estimate.yaw_rate_rover_rps,
            deck=None if known is None else self._filter.deck.motion(known.acc_down_rover_mps2),
            use_uwb=selection.use_uwb,
            use_tag=selection.use_tag,
            inputs=self._filter.inputs,
            fused_t_ns=self._filter.fused_ns,
            goal_id=selection.goal_id,
            parameters_version=selection.version,
        )

    def _rover_estimate(self, estimate: FilterEstimate, odometry: Odometry, reason: str) -> RoverEstimate:
        """Position of the rover in the frame of the odometry, so that both can be used together."""
        age_s = (estimate.t_ns - odometry.t_ns) / NS_PER_S
        pos_uav_m = add(odometry.pos_uav_ned_m, scale(odometry.vel_uav_ned_mps, age_s))
        located = self._filter.located
        return RoverEstimate(
            t_ns=estimate.t_ns,
            epoch_id=odometry.epoch_id,
            valid=not reason,
            reason=reason,
            pos_rover_ned_m=subtract(pos_uav_m, _vec3(estimate.pos_rel_m)) if located else ZERO,
            vel_rover_ned_mps=_vec3(estimate.vel_rover_mps),
            yaw_rover_rad=wrap_pi(estimate.yaw_rover_rad),
            std_pos_m=min(self._filter.std_pos_m, STD_MAX_M),
            reset_offset_ned_m=odometry.reset_offset_ned_m,
        )

    def _publish_health(self, reason: str) -> Iterable[Output]:
        missing = "the vehicle's clock" if self._epoch_id is None else "odometry" if self._odometry is None else ""
        left_out = self._filter.consistency.left_out
        text = f"waiting for {missing}" if missing else reason or left_out or "the rover is found"
        if self._arrivals.dropped:
            text += f"; {self._arrivals.dropped} measurements dropped: too late, too early or impossible"
        if text != self._health:
            self._health = text
            worse = missing or self._filter.rejected_inputs or left_out
            yield Health("degraded" if worse else "ok", text)


def _vec3(v: Array) -> Vec3:
    x, y, z = v.tolist()
    return (x, y, z)


def _advice(selection: InputSelection) -> str:
    """What to check about the inputs in use."""
    tag, uwb = "the tags are in view and lit", "three or more anchors are powered and within their range"
    wanted = [text for text, use in ((uwb, selection.use_uwb), (tag, selection.use_tag)) if use]
    return f"check that {' and that '.join(wanted)}"
