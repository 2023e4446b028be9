"""`python -m jezero.services.mission`: flies missions; the present one is kept below `JEZERO_RUN_DIR`."""

import os
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import msgspec

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.mission.config import MissionConfig
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.service import MissionService


def main() -> int:
    """Run until a signal stops it."""
    run_dir = os.environ.get("JEZERO_RUN_DIR")
    path = Path(run_dir).absolute() / "mission.json" if run_dir else None

    def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
        saved = None if path is None else load(path)
        config, vehicle = load_config(MissionConfig, "mission"), load_config(VehicleConfig, "vehicle")
        keep = partial(save, path)
        return MissionService(boot_id, saved=saved, save=keep, config=config, vehicle=vehicle), {}

    return run_process("mission", build)


def load(path: Path) -> MissionRecord | None:
    """The mission in a file; None without one that can be read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=MissionRecord)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        print(f"the mission in {path} can't be read and is left out: {error}", file=sys.stderr)
        return None


def save(path: Path | None, record: MissionRecord) -> None:
    """Write the mission into its file; one that can't be written flies on, and is lost at a restart."""
    if path is None:
        return
    new = path.with_suffix(".new")
    try:
        new.write_bytes(msgspec.json.encode(record))
        new.replace(path)
    except OSError as error:
        print(f"the mission can't be kept over a restart: {error}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
