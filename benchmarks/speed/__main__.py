"""Every figure of docs/performance.md about speed, in one run: `make speed`.

`python -m benchmarks.speed [--out FILE] [--only PART]...` prints one table and writes JSON. It takes about six minutes.
Nothing is asserted: the targets stand beside the figures. A part that can't be measured is left out with the reason.
"""

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table

from benchmarks.speed import hovering, latency, many_vehicles, message_cost, virtual_time
from benchmarks.speed.stack import percentile, running_stack
from jezero import JezeroError
from jezero.deploy.launcher.ports import reserved_instance

STARTS = 5
GOALS = 40
MOST_VEHICLES = 6
Row = tuple[str, str, str, str]
"""Name, figure, target, and how it was measured."""


def measure_start(folder: Path) -> dict[str, Any]:
    """Measure the seconds that `jezero up --wait` takes."""
    taken_s = []
    for number in range(STARTS):
        with (
            reserved_instance(vehicle=f"start{os.getpid()}") as instance,
            running_stack(instance, folder / f"start{number}") as stack,
        ):
            taken_s.append(stack.ready_s)
    return {"seconds": taken_s, "median_s": percentile(taken_s, 0.5), "most_s": max(taken_s)}


def rows_of_start(figures: dict[str, Any]) -> Iterator[Row]:
    yield (
        "jezero up --wait",
        f"{figures['median_s']:.1f} s",
        "6 s",
        f"median of {STARTS}, most {figures['most_s']:.1f} s",
    )


def measure_hover(folder: Path) -> dict[str, Any]:
    """Measure a hovering stack, and the cost of each of its messages."""
    with (
        reserved_instance(vehicle=f"hover{os.getpid()}") as instance,
        running_stack(instance, folder / "hover") as stack,
    ):
        hover = hovering.measure(stack)
    costs = message_cost.measure(hover.samples, folder)

    def topics(rates_hz: dict[str, float]) -> dict[str, Any]:
        return {name: {"rate_hz": hz, **msgspec.structs.asdict(costs[name])} for name, hz in rates_hz.items()}

    return {
        "cpu_cores": hover.cpu,
        "cpu_cores_without_camera": hover.cpu_without_camera,
        "processes": hover.processes,
        "messages_per_second": sum(hover.rates_hz.values()),
        "topics": topics(hover.rates_hz),
        "topics_in_orbit": topics(hover.orbit_rates_hz),
    }


def rows_of_hover(figures: dict[str, Any]) -> Iterator[Row]:
    shares = figures["processes"].values()
    memory = f"{sum(s.pss_mb for s in shares):.0f} MB, shared pages once"
    without = figures["cpu_cores_without_camera"]
    yield "whole stack hovering, without camera", f"{100 * without:.0f} % of a core", "100 %", ""
    yield "the same with camera", f"{100 * figures['cpu_cores']:.0f} % of a core", "", memory
    for name, share in sorted(figures["processes"].items(), key=lambda item: -item[1].cpu):
        yield f"  {name}", f"{100 * share.cpu:.1f} %", "", f"{share.rss_mb:.0f} MB, {share.pss_mb:.0f} of its own"
    how = "size; processor time of one at its writer + in the router + at each reader"
    yield "messages while hovering", f"{figures['messages_per_second']:.0f} per second", "", how
    yield from _rows_of_topics(figures["topics"])
    yield "more while it orbits the rover", "", "", ""
    yield from _rows_of_topics(figures["topics_in_orbit"])


def _rows_of_topics(topics: dict[str, Any]) -> Iterator[Row]:
    for name, topic in topics.items():
        parts = " + ".join(f"{topic[f'{who}_us']:.0f}" for who in ("writer", "router", "reader"))
        yield f"  {name}", f"{topic['rate_hz']:.0f} per second", "", f"{topic['size_bytes']} B; {parts} us"


PARTS_OF_DELAY = (("median_ms", ".2f"), ("p95_ms", ".1f"), ("n", "d"))


def measure_latency(folder: Path) -> dict[str, Any]:
    """Measure delays in comparison with bare Zenoh."""
    found = latency.measure(folder / "latency", GOALS)
    exchanges = {
        name: {**msgspec.to_builtins(row), "ratio": row.ratio, "ratio_by_hand": row.ratio_by_hand}
        for name, row in found.exchanges.items()
    }
    return {**msgspec.structs.asdict(found), "exchanges": exchanges}


def rows_of_latency(figures: dict[str, Any]) -> Iterator[Row]:
    for name, row in figures["exchanges"].items():
        three = [row[who] for who in ("own", "bare", "by_hand")]
        medians, late, n = ([f"{d[figure]:{how}}" for d in three] for figure, how in PARTS_OF_DELAY)
        how = f"{medians[0]} ms; bare {medians[1]}, by hand {medians[2]}; 95 % {' / '.join(late)}; n {' / '.join(n)}"
        target = "2x bare" if name == latency.ODOMETRY_TO_SETPOINT else "1.5x bare"
        yield name, f"{row['ratio']:.2f}x bare Zenoh, {row['ratio_by_hand']:.2f}x by hand", target, how
    yield "tick, in none of these", f"{figures['tick_ms']:.1f} ms", "", "from one odometry to the next"


def measure_virtual(_folder: Path) -> dict[str, Any]:
    """Measure a flight in virtual time."""
    return msgspec.structs.asdict(virtual_time.measure(seed=0))


def rows_of_virtual(figures: dict[str, Any]) -> Iterator[Row]:
    factor = f"{figures['core_factor']:.1f}x real time"
    how = f"one flight of {figures['sim_time_s']:.0f} s, per s of processor; {figures['real_time_factor']:.1f}x by wall"
    yield "virtual time on one core", factor, "12x", how
    core = f"{figures['flying_core_factor']:.1f}x real time"
    yield "the same, the flying core alone", core, "12x", "without camera, tag detector and estimator"
    for name, part in figures["parts"].items():
        yield f"  {name}", f"{part.us_per_step:.0f} us per 4 ms", "", f"{part.calls} calls"


def measure_fleet(folder: Path) -> dict[str, Any]:
    """Measure the number of vehicles on one router."""
    fleets = many_vehicles.measure(folder / "fleet", MOST_VEHICLES)
    return {"in_real_time": sum(f.in_real_time for f in fleets), "most_tried": len(fleets), "fleets": fleets}


def rows_of_fleet(figures: dict[str, Any]) -> Iterator[Row]:
    yield (
        "vehicles in real time",
        str(figures["in_real_time"]),
        "",
        f"tried up to {figures['most_tried']}, without camera and tag detector",
    )
    for fleet in figures["fleets"]:
        rates = ", ".join(f"{rate:.3f}" for rate in fleet.rates) or fleet.text.splitlines()[0]
        yield f"  {fleet.vehicles} hovering", "real time" if fleet.in_real_time else "too slow", "0.98 each", rates


MEASURE: dict[str, tuple[Callable[[Path], dict[str, Any]], Callable[[dict[str, Any]], Iterator[Row]]]] = {
    "latency": (measure_latency, rows_of_latency),
    "start": (measure_start, rows_of_start),
    "hover": (measure_hover, rows_of_hover),
    "virtual": (measure_virtual, rows_of_virtual),
    "fleet": (measure_fleet, rows_of_fleet),
}


def machine() -> dict[str, Any]:
    """The machine of the measurement; the load is that before the run."""
    return {"cores": os.cpu_count(), "machine": platform.machine(), "python": platform.python_version(),
            "load_1_min": os.getloadavg()[0], "taken_unix_s": round(time.time())}  # fmt: skip


def main() -> None:
    """Measure, print a table and write the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--out", type=Path, default=Path("runs/bench.json"))
    parser.add_argument("--only", choices=list(MEASURE), action="append", help="leave the other parts out")
    options = parser.parse_args()
    report: dict[str, Any] = {"machine": machine()}
    console = Console(width=max(120, Console().width))
    table = Table("what", "figure", "target", "how", title="jezero: speed and cost")
    with tempfile.TemporaryDirectory(prefix="jezero-bench-") as folder:
        for part, (measure, rows) in MEASURE.items():
            if options.only and part not in options.only:
                continue
            load = os.getloadavg()[0]
            console.print(f"measuring {part}, load {load:.1f} ...", style="dim")
            begin_s = time.monotonic()
            try:
                figures = measure(Path(folder))
            except (RuntimeError, JezeroError) as error:  # the other parts are still worth having
                report[part] = {"load_1_min": load, "error": str(error)}
                table.add_row(part, "not measured", "", str(error))
            else:
                report[part] = {"load_1_min": load, "taken_s": time.monotonic() - begin_s, **figures}
                for row in rows(report[part]):
                    table.add_row(*row)
            table.add_section()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2))
    console.print(table)
    console.print(f"load {report['machine']['load_1_min']:.1f} before, {os.getloadavg()[0]:.1f} after; {options.out}")


if __name__ == "__main__":
    main()
