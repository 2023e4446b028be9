"""The program of the docs that reads a Pozyx sends what the service reads; Pozyx's library is replaced by a fake."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

from jezero.services.uwb.json_lines import RangeLines

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "use-a-uwb-module.md"
LIBRARY = """
POZYX_SUCCESS, POZYX_FAILURE = 1, 0


class DeviceRange:
    distance = 0


class PozyxSerial:
    def __init__(self, port):
        assert port == "/dev/ttyACM1"

    def doRanging(self, destination_id, device_range):
        device_range.distance = destination_id % 1000 + 2000
        return POZYX_FAILURE if destination_id == 0x6E2B else POZYX_SUCCESS
"""


def test_the_program_sends_the_ranges_that_a_pozyx_has_measured(tmp_path: Path) -> None:
    program = next(
        code for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL) if "pypozyx" in code
    )
    (tmp_path / "pypozyx.py").write_text(LIBRARY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as service:
        service.bind(("127.0.0.1", 0))
        service.settimeout(30.0)
        (tmp_path / "program.py").write_text(program.replace("9000", str(service.getsockname()[1])))
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        with subprocess.Popen([sys.executable, tmp_path / "program.py"], env=environment) as process:
            data = service.recv(2000)
            process.kill()
    assert RangeLines().receive(data) == [
        {f"{anchor:04X}": (anchor % 1000 + 2000) / 1000 for anchor in (0x6E04, 0x6E5D, 0x6E7F)}
    ]
