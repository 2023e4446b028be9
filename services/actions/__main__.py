"""`python -m jezero.services.actions takeoff`: the server of one action."""

import os
import sys
from pathlib import Path

from jezero.base.plugins import PluginError, action_names, find_action
from jezero.runtime.process import Worker, run_process
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.table import action_server


def main() -> int:
    """Run the server named on the command line until a signal stops it."""
    if len(sys.argv) != 2:
        print(f"usage: python -m jezero.services.actions {{{','.join(action_names())}}}", file=sys.stderr)
        return 2
    name = sys.argv[1]
    try:
        return run_process(name, lambda _instance, boot_id: (_make(name, boot_id), {}))
    except PluginError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return os.EX_CONFIG


def _make(name: str, boot_id: int) -> ActionServer:
    pictures = None
    if find_action(name).takes_pictures:
        run_dir = os.environ.get("JEZERO_RUN_DIR")
        folder = Path(run_dir).absolute() / "pictures" / name if run_dir else None
        pictures = PictureStore(folder, execute=Worker().add)
    return action_server(name, boot_id, pictures=pictures)


if __name__ == "__main__":
    sys.exit(main())
