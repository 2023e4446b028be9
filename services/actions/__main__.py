"""`python -m jezero.services.actions takeoff`: the server of one action."""

import os
import sys
from pathlib import Path

from jezero.base.plugins import PluginError, action_names
from jezero.runtime.process import Worker, run_process
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.table import action_server, find_declaration


def main() -> int:
    """Run the server named on the command line until a signal stops it."""
    if len(sys.argv) != 2:
        print(f"usage: python -m jezero.services.actions {{{','.join(action_names())}}}", file=sys.stderr)
        return 2
    name = sys.argv[1]
    try:
        takes_pictures = find_declaration(name).action.takes_pictures
    except PluginError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return os.EX_CONFIG
    run_dir = os.environ.get("JEZERO_RUN_DIR")
    folder = Path(run_dir).absolute() / "pictures" / name if run_dir else None
    pictures = PictureStore(folder, execute=Worker().add) if takes_pictures else None
    return run_process(name, lambda _instance, boot_id: (action_server(name, boot_id, pictures=pictures), {}))


if __name__ == "__main__":
    sys.exit(main())
