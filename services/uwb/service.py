"""The UWB driver: ranges of the vehicle's module to the anchors of `vehicle.toml`, as the simulator publishes them."""

from collections.abc import Iterator
from dataclasses import replace

from jezero.base.vehicle_config import UwbLayoutConfig, VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Send, Spec
from jezero.schemas.sensors import Uwb, UwbRange
from jezero.schemas.topics import UWB
from jezero.schemas.units import NS_PER_S
from jezero.services.uwb.config import UwbDriverConfig
from jezero.services.uwb.formats import Round, parser_of

LINK = "module"
SILENCE_NS = 2_000_000_000
"""An anchor, or a module, that has sent nothing for this time is named in health."""
HEALTH_PERIOD_NS = 1_000_000_000
NAMED_MAX = 8
"""So many ids are named at once."""

SPEC = Spec(name="uwb", outputs=(UWB,), links=(LINK,), triggers=(LINK,))


class UwbDriver:
    """Publishes `sensor/uwb` from a UWB module on a line.

    Args:
        config: the line, the format and the delay.
        vehicle: places of the anchors, and the ids of their modules.
    """

    def __init__(self, config: UwbDriverConfig, vehicle: VehicleConfig) -> None:
        links = (LINK,) if config.link else ()
        self.spec = replace(SPEC, links=links, triggers=links, made_with={"config": config, "vehicle": vehicle})
        self._config = config
        self._layout: UwbLayoutConfig = vehicle.uwb
        self._anchors = {module.upper(): i for i, module in enumerate(vehicle.uwb.id_anchors)}
        self._delay_ns = round(config.delay_s * NS_PER_S)
        self._parser = parser_of(config.format)
        self._connections = 0
        self._watch = _Watch(config, list(self._anchors))
        self._health: Health | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Publish the ranges that have arrived."""
        if not self._config.link:
            if self._health is None:
                self._health = Health("ok", "not configured: this vehicle has no UWB module, see link in uwb.toml")
                yield self._health
            return
        if inbox.connections(LINK) != self._connections:  # what the lost connection has begun is not continued
            self._connections = inbox.connections(LINK)
            self._parser = parser_of(self._config.format)
        data = inbox.received(LINK)
        rounds = self._parser.receive(data)
        if inbox.is_up(LINK) and (request := self._parser.due(inbox.wall_ns)):
            yield Send(LINK, request)
        self._watch.update(inbox.wall_ns, len(data), rounds)
        if rounds and t_ns > self._delay_ns:
            yield from self._publish(t_ns - self._delay_ns, rounds)
        health = self._watch.health(inbox.wall_ns, self._parser.bad, up=inbox.is_up(LINK), timed=t_ns > 0)
        if health is not None and health != self._health:
            self._health = health
            yield health

    def _publish(self, t_ns: int, rounds: list[Round]) -> Iterator[Publish]:
        """Publish the newest range of each anchor.

        Several rounds that arrive at once have waited on the line: the time of all but the newest is unknown.
        """
        newest = {module: range_m for each in rounds for module, range_m in each.items()}
        ranges = []
        for module, range_m in newest.items():
            anchor = self._anchors.get(module)
            if anchor is None or not 0.0 < range_m <= self._layout.range_max_m:
                continue
            place = self._layout.pos_anchors_rover_body_m[anchor]
            ranges.append(UwbRange(t_ns=t_ns, anchor=anchor, pos_anchor_rover_body_m=place, range_m=range_m))
        if ranges:
            ranges.sort(key=lambda each: each.anchor)
            yield Publish(UWB, Uwb(t_ns=t_ns, ranges=tuple(ranges)))


class _Watch:
    """What comes from the module, and what does not, for people.

    Args:
        config: the line and the format.
        modules: ids of the anchors' modules.
    """

    def __init__(self, config: UwbDriverConfig, modules: list[str]) -> None:
        self._config = config
        self._modules = modules
        self._heard_ns: dict[str, int] = {}
        """Time of the last range by module, of unknown ones too."""
        self._bytes_ns = self._round_ns = -SILENCE_NS
        self._rounds = 0
        self._judged_ns: int | None = None

    def update(self, wall_ns: int, count: int, rounds: list[Round]) -> None:
        """Take in what has arrived: the number of bytes, and the rounds in them."""
        if count:
            self._bytes_ns = wall_ns
        if rounds:
            self._round_ns = wall_ns
            self._rounds += len(rounds)
        for module in (module for each in rounds for module in each):
            if module in self._heard_ns or len(self._heard_ns) < len(self._modules) + NAMED_MAX:
                self._heard_ns[module] = wall_ns

    def health(self, wall_ns: int, bad: int, *, up: bool, timed: bool) -> Health | None:
        """The driver's health; None while the last is young.

        Args:
            bad: number of damaged lines or frames of this connection.
            up: whether the line is open.
            timed: whether there is vehicle time.
        """
        if self._judged_ns is not None and wall_ns - self._judged_ns < HEALTH_PERIOD_NS:
            return None
        passed_s = (wall_ns - self._judged_ns) / NS_PER_S if self._judged_ns is not None else 0.0
        rate_hz = self._rounds / passed_s if passed_s > 0.0 else 0.0
        self._judged_ns, self._rounds = wall_ns, 0
        self._heard_ns = {each: at for each, at in self._heard_ns.items() if wall_ns - at <= SILENCE_NS}
        damaged = f"; {bad} damaged lines or frames" if bad else ""
        if problem := self._line_problem(wall_ns, up=up):
            return Health("degraded", problem + damaged)
        silent = [each for each in self._modules if each not in self._heard_ns]
        unknown = [each for each in self._heard_ns if each not in self._modules]
        text = f"{rate_hz:.0f} rounds/s from {len(self._modules) - len(silent)} anchors"
        if not timed:
            text = f"no vehicle time yet; {text}"
        if silent:
            text += f"; no range from {_listed(silent)}: switched off, hidden, or another id than in vehicle.toml"
        if unknown:
            text += f"; {_listed(unknown)} is no anchor in vehicle.toml: add it to id_anchors, or switch it off"
        return Health("degraded" if silent or not timed else "ok", text + damaged)

    def _line_problem(self, wall_ns: int, *, up: bool) -> str:
        """Why no ranges come, "" when they do."""
        link, kind = self._config.link, self._config.format
        if not up:
            return f"the line to the UWB module, {link}, is not open: is the module plugged in? The log has the reason"
        if wall_ns - self._bytes_ns > SILENCE_NS:
            return f"nothing comes from the UWB module at {link}: is it switched on, and is its baud rate right?"
        if wall_ns - self._round_ns > SILENCE_NS:
            return f"what comes from {link} has no ranges of the format {kind}: check format and baud rate in uwb.toml"
        return ""


def _listed(modules: list[str]) -> str:
    """Ids for people."""
    return ", ".join(sorted(modules)[:NAMED_MAX])
