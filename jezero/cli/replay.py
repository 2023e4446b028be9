"""`jezero replay`."""

from pathlib import Path

import click

from jezero.cli.recording import RECORDING_PATH
from jezero.cli.replay_through import replay_through


@click.command()
@click.argument("file", type=RECORDING_PATH)
@click.option("--through", "service", metavar="SERVICE", required=True, help="Run this service on its recorded inputs.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="With --through: a setting that is to differ; may be given several times.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="With --through: print one JSON object.")
def replay(file: Path, service: str, settings: tuple[str, ...], as_json: bool) -> None:
    """Replay FILE."""
    replay_through(file, service, settings, as_json=as_json)
