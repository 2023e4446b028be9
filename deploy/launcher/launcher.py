"""The launcher: starts services in order, restarts them, and stops them in reverse order, in one loop."""

import contextlib
import os
import selectors
import signal
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import FrameType
from typing import TextIO

from msgspec.structs import replace

from jezero.base.router_address import shown_router
from jezero.deploy.launcher.compose import ComposeService, in_levels
from jezero.deploy.launcher.freezes import SAMPLE_PERIOD_S, FreezeDetector, sample_process
from jezero.deploy.launcher.gate_watch import GateWatch
from jezero.deploy.launcher.health import HealthWatcher
from jezero.deploy.launcher.output import Output
from jezero.deploy.launcher.processes import Child, RestartPolicy, SpawnError, describe_exit, spawn
from jezero.deploy.launcher.state import LaunchedService, RunFolder, RunState, ServiceState, start_ticks
from jezero.deploy.launcher.systemd import SystemdNotifier
from jezero.runtime.instance import Instance
from jezero.schemas.health import GateLinks

BRIDGE, GATE = "vehicle_bridge", "gate"
ASK_PERIOD_S = 1.0
"""Period of the requests that ask all gates for their links."""
NOTED_FOR_S = 60.0
"""Time for which a service's text says why the process before was killed."""
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
KILL_MARGIN_S = 0.5


@dataclass
class _Slot:
    """State of one service in the launcher.

    Attributes:
        service: its declaration.
        policy: its restart policy.
        state: its state.
        text: sentence about the state, for people.
        child: its present process.
        started_s: monotonic time of the last start.
        due_s: monotonic time of the restart when restarting, of SIGKILL when stopping.
        exit_code: exit code of the last process.
        killed: why this launcher killed the present process, or "".
        note: what became of the process before the present one, for people; "" after `NOTED_FOR_S`.
    """

    service: ComposeService
    policy: RestartPolicy
    state: ServiceState = "waiting"
    text: str = ""
    child: Child | None = None
    started_s: float | None = None
    due_s: float | None = None
    exit_code: int | None = None
    killed: str = ""
    note: str = ""

    @property
    def has_started(self) -> bool:
        return self.started_s is not None or self.state == "external"


class Launcher:
    """Runs services until a signal, and with a terminal until all have ended. For the main thread only.

    Args:
        services: the services.
        folder: folder of the run, already acquired.
        instance: the stack; its `router` is the address for people's programs.
        bus: address of the router for services.
        compose_file: path of the compose file, for the state.
        external: services that another launcher runs; this one waits for them but does not start or stop them.
        terminal: gets every line of output; None when detached.
        systemd: gets notifications; None where systemd has not started the launcher.
    """

    def __init__(
        self,
        services: Mapping[str, ComposeService],
        folder: RunFolder,
        instance: Instance,
        bus: str,
        compose_file: str,
        *,
        external: frozenset[str] = frozenset(),
        terminal: TextIO | None = None,
        systemd: SystemdNotifier | None = None,
    ) -> None:
        self._slots = {name: _Slot(service, RestartPolicy(service)) for name, service in services.items()}
        for name in external.intersection(self._slots):
            self._slots[name].state = "external"
        self._levels = in_levels(services)
        self._folder = folder
        self._instance = instance
        self._bus = bus
        self._compose_file = compose_file
        self._ends_with_services = terminal is not None
        self._output = Output(folder, services, terminal)
        self._selector = selectors.DefaultSelector()
        self._wake_read, self._wake_write = socket.socketpair()
        self._gate_watch = GateWatch()
        self._health = HealthWatcher(replace(instance, router=bus), self._wake, self._on_gate)
        self._freeze_detector = FreezeDetector()
        self._systemd = systemd or SystemdNotifier({})
        self._sample_due_s = self._ask_due_s = time.monotonic()
        self._stop_requests = 0
        self._stopping: Iterator[list[str]] | None = None
        self._level: list[str] = []
        self._written: RunState | None = None
        self._ready_printed = False
        self._failures_printed: set[str] = set()

    def run(self) -> int:
        """Run until the end; returns the exit code, 1 if a service failed."""
        for end in (self._wake_read, self._wake_write):
            end.setblocking(False)
        self._selector.register(self._wake_read, selectors.EVENT_READ, None)
        for number in STOP_SIGNALS:
            signal.signal(number, self._on_signal)
        start_s = time.monotonic()
        self._advance()
        with self._health:
            while self._stopping is None or self._level:
                self._wait()
                self._advance()
                self._print_readiness(start_s)
        self._output.close()
        self._systemd.close()
        self._folder.release()
        return 1 if any(slot.state == "failed" for slot in self._slots.values()) else 0

    # -- events --

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._stop_requests += 1
        self._wake()

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            self._wake_write.send(b"\0")

    def _wait(self) -> None:
        """Wait for an event or the next due time, and handle events."""
        due = [slot.due_s for slot in self._slots.values() if slot.due_s is not None]
        if self._stopping is None:
            due.append(self._sample_due_s)
        if self._systemd.due_s is not None:
            due.append(self._systemd.due_s)
        timeout_s = None if not due else max(0.0, min(due) - time.monotonic())
        for selected, _ in self._selector.select(timeout_s):
            name = selected.data
            if name is None:
                with contextlib.suppress(BlockingIOError):
                    self._wake_read.recv(4096)
                continue
            child = self._slots[name].child
            if child is None:  # both descriptors were ready, and the first one ended it
                continue
            if selected.fd == child.pidfd:
                self._on_exit(name, child)
            else:
                self._read(name, child)

    def _read(self, name: str, child: Child) -> bool:
        """Read a service's output; False if there is no more for now."""
        try:
            data = os.read(child.output.fileno(), 65536)
        except BlockingIOError:
            return False
        if data:
            self._output.on_data(name, data)
            return True
        if child.output in self._selector.get_map():
            self._selector.unregister(child.output)
        return False

    def _on_exit(self, name: str, child: Child) -> None:
        slot = self._slots[name]
        now_s = time.monotonic()
        self._selector.unregister(child.pidfd)
        slot.exit_code = child.reap()
        while self._read(name, child):
            pass
        if child.output in self._selector.get_map():
            self._selector.unregister(child.output)
        child.output.close()
        self._output.on_exit(name)
        self._health.forget(name)
        slot.child = None
        slot.due_s = None
        if self._stopping is not None or self._stop_requests:
            self._set(slot, "stopped", f"stopped with {describe_exit(slot.exit_code)}")
            return
        how = f"was {slot.killed}" if slot.killed else f"ended with {describe_exit(slot.exit_code)}"
        slot.note = how if slot.killed else ""
        if slot.exit_code > 0 and (said := self._output.last_line(name)):
            how = f"{how}: {said}"
        delay_s = slot.policy.after_exit(now_s, now_s - (slot.started_s or now_s), slot.exit_code, how)
        if delay_s is not None:
            slot.due_s = now_s + delay_s
            self._set(slot, "restarting", f"{how}; again in {delay_s:.1f} s")
        elif slot.policy.gave_up:
            self._set(slot, "failed", slot.policy.gave_up)
        else:
            self._set(slot, "exited", how)

    # -- actions --

    def _advance(self) -> None:
        """Start, restart, stop and kill services that are due, and write the state."""
        now_s = time.monotonic()
        ended = all(s.state in ("exited", "failed", "stopped", "external") for s in self._slots.values())
        # A detached launcher stays after all have ended, so that `jezero ps` can show why.
        if self._stopping is None and (self._stop_requests or (ended and self._ends_with_services)):
            self._start_stopping()
        if self._stopping is not None:
            self._stop(now_s)
        else:
            for slot in self._slots.values():
                if slot.state == "waiting":
                    self._start_if_possible(slot)
                elif slot.state == "restarting" and slot.due_s is not None and now_s >= slot.due_s:
                    slot.due_s = None
                    self._start(slot)
            if now_s >= self._sample_due_s:
                self._sample_due_s = now_s + SAMPLE_PERIOD_S
                self._kill_frozen(now_s)
                self._watch_gate(now_s)
        reason = self._not_ready_reason()
        self._write(reason)
        # Not when the vehicle is ready, which may wait for GNSS for minutes: systemd watches only what has started.
        stopping = self._stopping is not None
        started = not stopping and all(slot.state != "waiting" for slot in self._slots.values())
        self._systemd.update(now_s, reason or "ready", started=started, stopping=stopping)

    def _kill_frozen(self, now_s: float) -> None:
        """Kill frozen services, which are then restarted as after a crash."""
        running = {slot.child.pid: slot for slot in self._slots.values() if slot.child is not None}
        connected = self._health.connected
        samples = {}
        for pid, slot in running.items():
            name = slot.service.name
            reachable = connected and self._health.report(name).alive
            samples[pid] = sample_process(pid, reports=self._health.reports_received(name), reachable=reachable)
        for pid, how in self._freeze_detector.update(now_s, samples).items():
            slot = running[pid]
            self._kill(slot, f"frozen and killed: {how}")

    def _kill(self, slot: _Slot, how: str) -> None:
        """Kill a service's process, which is then restarted as after a crash."""
        if slot.child is not None and not slot.killed:
            slot.killed = how
            slot.child.signal(signal.SIGKILL)

    def _on_gate(self, links: GateLinks, is_reply: bool) -> None:
        self._gate_watch.on_beat(links, time.monotonic(), is_reply=is_reply)

    def _watch_gate(self, now_s: float) -> None:
        """Start the gate anew where a link of it is up and passes nothing."""
        slot = self._slots.get(GATE)
        if slot is None or slot.child is None or slot.started_s is None or not self._health.connected:
            return
        if now_s >= self._ask_due_s:
            self._ask_due_s = now_s + ASK_PERIOD_S
            self._health.ask_gates()
        process = f"{socket.gethostname()} pid {slot.child.pid}"
        if reason := self._gate_watch.problem(process, slot.started_s, now_s):
            self._kill(slot, f"killed, so that its links begin anew: {reason}")

    def _start_if_possible(self, slot: _Slot) -> None:
        missing = []
        for name, condition in slot.service.depends_on.items():
            other = self._slots[name]
            if other.state == "failed" and name in slot.service.optional:
                continue
            if condition == "service_healthy" and not self._is_healthy(other):
                missing.append(f"{name} to be healthy" if other.state != "failed" else f"{name}, which failed")
            elif not other.has_started:
                missing.append(f"{name} to start" if other.state != "failed" else f"{name}, which failed")
        if missing:
            slot.text = f"waits for {', '.join(missing)}"
        else:
            self._start(slot)

    def _start(self, slot: _Slot) -> None:
        name = slot.service.name
        try:
            slot.child = spawn(slot.service)
        except SpawnError as error:
            self._set(slot, "failed", str(error))
            return
        slot.killed = ""
        slot.started_s = time.monotonic()
        self._selector.register(slot.child.pidfd, selectors.EVENT_READ, name)
        self._selector.register(slot.child.output, selectors.EVENT_READ, name)
        self._set(slot, "running", f"started, process {slot.child.pid}")

    def _set(self, slot: _Slot, state: ServiceState, text: str) -> None:
        slot.state = state
        slot.text = text
        self._output.write_line(slot.service.name, f"[launcher] {text}")

    # -- stopping --

    def _start_stopping(self) -> None:
        self._stopping = iter([list(level) for level in reversed(self._levels)])
        self._level = next(self._stopping, [])
        self._terminate(self._level)

    def _terminate(self, level: list[str]) -> None:
        for name in level:
            slot = self._slots[name]
            if slot.child is not None:
                slot.child.signal(signal.SIGTERM)
                slot.due_s = time.monotonic() + slot.service.stop_grace_s
                slot.state = "stopping"
            elif slot.state in ("waiting", "restarting"):
                slot.due_s = None
                self._set(slot, "stopped", "stopped before it ran")

    def _stop(self, now_s: float) -> None:
        """Kill services after their grace time, or all at a second signal; continue with the next level."""
        assert self._stopping is not None
        if self._stop_requests > 1:
            for slot in self._slots.values():
                if slot.child is not None:
                    slot.child.signal(signal.SIGKILL)
        while self._level:
            running = [slot for name in self._level if (slot := self._slots[name]).child is not None]
            if running:
                for slot in running:
                    if slot.child is not None and slot.due_s is not None and now_s >= slot.due_s:
                        self._output.write_line(
                            slot.service.name, f"[launcher] killed: still running after {_grace(slot)}"
                        )
                        slot.child.signal(signal.SIGKILL)
                        slot.due_s = now_s + KILL_MARGIN_S
                return
            self._level = next(self._stopping, [])
            self._terminate(self._level)

    # -- state --

    def _is_healthy(self, slot: _Slot) -> bool:
        if slot.state == "external":  # the router, which may belong to another vehicle's stack
            return self._health.connected
        if slot.state != "running":
            return False
        return not slot.service.has_healthcheck or self._health.report(slot.service.name).healthy

    def _not_ready_reason(self) -> str:
        """Why the vehicle is not ready, or ""."""
        if self._stopping is not None:
            return "stopping"
        for name, slot in self._slots.items():
            if slot.state == "failed":
                return f"{name} failed: {slot.text}"
        for name, slot in self._slots.items():
            if self._is_healthy(slot):
                continue
            report = self._health.report(name)
            reason = (
                (report.text or "no health report on the bus") if slot.state in ("running", "external") else slot.text
            )
            return f"{name} is {slot.state}: {reason}"
        for name in self._slots:
            report = self._health.report(name)
            if report.health == "degraded":
                return f"{name} is degraded: {report.text}"
        if BRIDGE in self._slots:
            ready, reason = self._health.vehicle_ready
            return "" if ready else reason or "the vehicle is not ready"
        return ""

    def _print_readiness(self, start_s: float) -> None:
        """Print once that the vehicle is ready, and before that each reason why it can't become ready."""
        state = self._written
        if state is None or self._ready_printed or self._stopping is not None:
            return
        if state.ready:
            self._output.print_line(f"ready after {time.monotonic() - start_s:.1f} s")
            for line in state.addresses:
                self._output.print_line(line)
        for service in state.services:
            if service.state == "failed" and service.text not in self._failures_printed:
                self._failures_printed.add(service.text)
                reason = f"{service.service} failed: {service.text}"
                self._output.print_line(f"not ready: {reason}; end the stack with Ctrl+C, and mend that")
        self._ready_printed = state.ready

    def _write(self, reason: str) -> None:
        """Write the state, where it has changed.

        Args:
            reason: why the vehicle is not ready, or "".
        """
        pid = os.getpid()
        state = RunState(
            launcher_pid=pid,
            launcher_start_ticks=start_ticks(pid) or 0,
            compose_file=self._compose_file,
            vehicle=self._instance.vehicle,
            router=shown_router(self._instance.router),
            bus=self._bus,
            ready=not reason,
            not_ready_reason=reason,
            services=tuple(self._describe(name, slot) for name, slot in self._slots.items()),
        )
        if state == self._written:
            return
        try:
            self._folder.write(state)
        except OSError:  # the disk is full: the services must not die of it
            if self._written is None:
                raise
        else:
            self._written = state

    def _describe(self, name: str, slot: _Slot) -> LaunchedService:
        report = self._health.report(name)
        text = report.text if slot.state == "running" and report.text else slot.text
        noted = slot.note and slot.state == "running" and time.monotonic() - (slot.started_s or 0.0) < NOTED_FOR_S
        return LaunchedService(
            service=name,
            state=slot.state,
            pid=None if slot.child is None else slot.child.pid,
            healthy=self._is_healthy(slot),
            health=report.health,
            restarts=slot.policy.restarts,
            exit_code=slot.exit_code,
            started_monotonic_s=slot.started_s,
            text=f"{text}; the process before {slot.note}" if noted else text,
        )


def _grace(slot: _Slot) -> str:
    return f"{slot.service.stop_grace_s:g} s"
