"""A vehicle bridge with a point mass behind it, for tests of the action servers."""

from collections.abc import Iterator

from jezero.base.frames import Vec3, add, norm, rotate_yaw, scale, subtract
from jezero.runtime.service import Inbox, Output, Publish, Reply, Spec
from jezero.schemas import topics
from jezero.schemas.commands import AcquireReply, Release, ReleaseReply, Setpoint
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Battery, Clock, Odometry, Status, StatusCode

PERIOD_S = 0.02
LAG_S = 0.25
SPEED_MAX_MPS = 12.0


def follow(
    pos: Vec3,
    vel: Vec3,
    setpoint_pos: Vec3 | None,
    setpoint_vel: Vec3 | None,
    dt_s: float,
    error_heading_rad: float = 0.0,
) -> tuple[Vec3, Vec3]:
    """One step of a point mass that obeys setpoints with a lag; the ground is z = 0.

    Args:
        error_heading_rad: error of the heading, by which all horizontal accelerations are turned.
    """
    wanted = setpoint_vel or (0.0, 0.0, 0.0)
    if setpoint_pos is not None:
        wanted = add(wanted, subtract(setpoint_pos, pos))
    wanted = scale(wanted, min(1.0, SPEED_MAX_MPS / max(norm(wanted), 1e-9)))
    vel = add(vel, rotate_yaw(scale(subtract(wanted, vel), dt_s / LAG_S), error_heading_rad))
    pos = add(pos, scale(vel, dt_s))
    if pos[2] >= 0.0:
        return (pos[0], pos[1], 0.0), (0.0, 0.0, min(vel[2], 0.0))
    return pos, vel


class FakeBridge:
    """Grants and releases control as the real bridge does, as far as it matters to goals.

    Attributes:
        refuse: reason with which every request for control is refused, when not empty.
        lost_releases: number of releases that will be lost on their way to the bridge.
        lost_replies: number of releases that will be carried out while their reply is lost.
        mute_odometry: publish no odometry.
        mute_status: publish no status.
        lost: publish the status without the vehicle's position.
        battery: published with the status.
        error_heading_rad: error of the heading, by which the point mass accelerates in a wrong direction.
        wind_ned_mps: estimated wind, published with the status.
        origin_deg: of the world, published with the odometry.
        offset_ned_m: sum of the autopilot's position steps so far; positions contain it.
    """

    def __init__(self, pos_ned_m: Vec3 = (0.0, 0.0, 0.0), boot_id: int = 7) -> None:
        self.spec = Spec(
            name="vehicle_bridge",
            inputs=(topics.SETPOINT,),
            outputs=(topics.STATUS, topics.ODOMETRY, topics.CLOCK, topics.ALTIMETER),
            serves=(topics.ACQUIRE, topics.RELEASE),
            triggers=(topics.ACQUIRE.name, topics.RELEASE.name),
            rate_hz=1.0 / PERIOD_S,
        )
        self.pos_ned_m = pos_ned_m
        self.vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self.code = StatusCode.IDLE if pos_ned_m[2] == 0.0 else StatusCode.HOVER
        self.boot_id = boot_id
        self.epoch_id = 1
        self.control_id = ""
        self.text = ""
        self.refuse = ""
        self.lost_releases = 0
        self.lost_replies = 0
        self.mute_odometry = False
        self.mute_status = False
        self.lost = False
        self.battery: Battery | None = None
        self.error_heading_rad = 0.0
        self.wind_ned_mps: Vec3 | None = None
        self.origin_deg: Vec3 | None = None
        self.offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self.releases: list[Release] = []
        self.setpoints: list[Setpoint] = []
        self.grants = 0
        self._setpoint: Setpoint | None = None
        self._t_ns = 0
        self._shown: tuple[object, ...] = ()
        self._status_ns = -1_000_000_000
        self._still_s = 1.0
        self._resets = 0

    @property
    def landed(self) -> bool:
        return self._still_s > 0.4

    def step_position(self, step_ned_m: Vec3) -> None:
        """The autopilot moves its position in one step."""
        self.offset_ned_m = add(self.offset_ned_m, step_ned_m)
        self.pos_ned_m = add(self.pos_ned_m, step_ned_m)
        self._resets += 1

    def revoke(self, code: StatusCode, text: str) -> None:
        """Take control away, as abort, a pilot or a failsafe does."""
        self.control_id, self.code, self.text, self._setpoint = "", code, text, None

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        self._move((t_ns - self._t_ns) / 1e9)
        self._t_ns = t_ns
        for setpoint in inbox.new(topics.SETPOINT):
            if setpoint.control_id == self.control_id:
                self.setpoints.append(setpoint)
                self._setpoint = setpoint
                self.code = topics_code(setpoint)
        for request in inbox.requests(topics.ACQUIRE):
            yield Reply(request.request_id, self._acquire(check_only=request.payload.check_only))
        for request in inbox.requests(topics.RELEASE):
            yield from self._release(request.request_id, request.payload)
        yield from self._publish(t_ns)

    def _acquire(self, *, check_only: bool) -> AcquireReply:
        if self.refuse or self.control_id:
            return AcquireReply(granted=False, reason=self.refuse or "another goal is in charge")
        if check_only:
            return AcquireReply(granted=True, bridge_boot_id=self.boot_id)
        self.grants += 1
        self.control_id = f"c{self.grants}"
        return AcquireReply(granted=True, control_id=self.control_id, bridge_boot_id=self.boot_id, grants=self.grants)

    def _release(self, request_id: int, release: Release) -> Iterator[Output]:
        if self.lost_releases:
            self.lost_releases -= 1
            yield Reply(request_id, None)
            return
        self.releases.append(release)
        if release.control_id == self.control_id:
            self.control_id, self._setpoint = "", None
            idle = release.then != "hover" or self.landed
            self.code = StatusCode.IDLE if idle else StatusCode.HOVER
            reply = ReleaseReply(released=True, code=int(self.code))
        else:
            reply = ReleaseReply(released=False, code=int(self.code), reason="this control is not in charge")
        if self.lost_replies:
            self.lost_replies -= 1
            yield Reply(request_id, None)
            return
        yield Reply(request_id, reply)

    def _move(self, dt_s: float) -> None:
        setpoint = self._setpoint
        if setpoint is None:
            self.vel_ned_mps = (0.0, 0.0, 0.0)
            return
        pos = None if setpoint.pos_ned_m is None else setpoint.pos_ned_m
        self.pos_ned_m, self.vel_ned_mps = follow(
            self.pos_ned_m, self.vel_ned_mps, pos, setpoint.vel_ned_mps, dt_s, self.error_heading_rad
        )
        on_ground = self.pos_ned_m[2] == 0.0 and self.vel_ned_mps[2] == 0.0
        self._still_s = self._still_s + dt_s if on_ground else 0.0

    def _publish(self, t_ns: int) -> Iterator[Output]:
        odometry = Odometry(
            t_ns=t_ns,
            epoch_id=self.epoch_id,
            pos_uav_ned_m=self.pos_ned_m,
            vel_uav_ned_mps=self.vel_ned_mps,
            q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
            rates_uav_frd_rps=(0.0, 0.0, 0.0),
            origin_deg=self.origin_deg,
            reset_counter=self._resets,
            reset_offset_ned_m=self.offset_ned_m,
        )
        if not self.mute_odometry:
            yield Publish(topics.ODOMETRY, odometry)
            height_m = -self.pos_ned_m[2]
            yield Publish(topics.ALTIMETER, Altimeter(t_ns=t_ns, range_m=height_m if 0.15 < height_m < 10.0 else None))
        shown = (self.code, self.control_id, self.boot_id, self.epoch_id, self.landed)
        due = t_ns - self._status_ns >= 100_000_000
        if self.mute_status or not (due or shown != self._shown):
            return
        self._status_ns, self._shown = t_ns, shown
        yield Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=self.epoch_id, wall_ns=t_ns))
        yield Publish(
            topics.STATUS,
            Status(
                t_ns=t_ns,
                code=int(self.code),
                name=self.code.name,
                odometry=None if self.lost else odometry,
                armed=self.code != StatusCode.IDLE,
                landed=self.landed,
                in_charge="goal" if self.control_id else "none",
                grant=self.grants if self.control_id else 0,
                bridge_boot_id=self.boot_id,
                grants=self.grants,
                epoch_id=self.epoch_id,
                ready=True,
                text=self.text,
                battery=self.battery,
                wind_ned_mps=self.wind_ned_mps,
            ),
        )


def topics_code(setpoint: Setpoint) -> StatusCode:
    """The status code of a setpoint's phase."""
    codes = {
        "takeoff": StatusCode.TAKEOFF,
        "go_to": StatusCode.GO_TO,
        "get_images": StatusCode.GET_IMAGES,
        "landing": StatusCode.LANDING,
        "coverage": StatusCode.COVERAGE,
        "action": StatusCode.ACTION,
    }
    return codes[setpoint.phase]
