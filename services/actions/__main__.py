"""`python -m jezero.services.actions takeoff`: the server of one action."""

import sys

from jezero.runtime.config import ConfigError, instance_from_environment
from jezero.runtime.zenoh_bus import new_boot_id, run_service
from jezero.services.actions.table import BEHAVIOURS, action_server


def main() -> int:
    """Run the server named on the command line until it is told to stop."""
    if len(sys.argv) != 2 or sys.argv[1] not in BEHAVIOURS:
        print(f"usage: python -m jezero.services.actions {{{','.join(BEHAVIOURS)}}}", file=sys.stderr)
        return 2
    boot_id = new_boot_id()
    try:
        return run_service(action_server(sys.argv[1], boot_id), instance_from_environment(), boot_id)
    except ConfigError as error:
        print(f"{sys.argv[1]}: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
