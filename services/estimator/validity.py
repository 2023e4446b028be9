"""Why an estimate is invalid, in words that say what to check."""

from collections.abc import Iterator

from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.arrivals import Arrivals
from jezero.services.estimator.config import ValidityConfig
from jezero.services.estimator.measurements import Kind
from jezero.services.estimator.relative_filter import RelativeFilter
from jezero.services.estimator.selection import InputSelection

UWB, TAG = "UWB", "the tag"
INPUT_NAMES: dict[Kind, str] = {"rover": "the rover's odometry", "uwb": UWB, "tag": TAG}


def invalid_reason(
    t_ns: int,
    validity: ValidityConfig,
    selection: InputSelection,
    relative: RelativeFilter,
    arrivals: Arrivals,
    *,
    odometry_ns: int | None,
    rover_odometry_received: bool,
) -> str:
    """Why the filter's estimate is invalid, its causes first; "" for a valid estimate.

    Args:
        t_ns: the present vehicle time.
        odometry_ns: time of the vehicle's newest odometry; None before the first.
        rover_odometry_received: whether the rover has sent odometry.
    """
    if odometry_ns is None or t_ns - odometry_ns > validity.odometry_timeout_s * NS_PER_S:
        reason = "no odometry of the vehicle"
    else:
        reason = next(_reasons(t_ns, validity, selection, relative, rover_odometry_received), "")
    if not reason:
        return ""
    causes = (
        relative.consistency.left_out,
        arrivals.late_reason(t_ns, UWB) if selection.use_uwb else "",
        arrivals.late_reason(t_ns, TAG) if selection.use_tag else "",
    )
    return "; ".join(text for text in (*causes, reason) if text)


def _reasons(
    t_ns: int,
    validity: ValidityConfig,
    selection: InputSelection,
    relative: RelativeFilter,
    rover_odometry_received: bool,
) -> Iterator[str]:
    selected = " and ".join(n for n, use in ((UWB, selection.use_uwb), ("tag", selection.use_tag)) if use)
    if not selected:
        yield "neither UWB nor tag is selected"
    if not relative.located:
        missing = "" if rover_odometry_received else "; the rover's odometry is missing"
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


def _advice(selection: InputSelection) -> str:
    """What to check about the inputs in use."""
    tag, uwb = "the tags are in view and lit", "three or more anchors are powered and within their range"
    wanted = [text for text, use in ((uwb, selection.use_uwb), (tag, selection.use_tag)) if use]
    return f"check that {' and that '.join(wanted)}"
