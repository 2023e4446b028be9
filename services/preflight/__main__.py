"""`python -m jezero.services.preflight`: the preflight checks over Zenoh."""

import sys

from jezero.runtime.process import run_process
from jezero.services.preflight.service import Preflight

if __name__ == "__main__":
    sys.exit(run_process("preflight", lambda _instance, _boot_id: (Preflight(), {})))
