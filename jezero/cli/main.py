"""The `jezero` command. A command's module is imported only when that command runs."""

import importlib
import sys
from errno import EPIPE
from typing import TYPE_CHECKING, Any, NamedTuple

try:
    import click
except ModuleNotFoundError:
    sys.exit("jezero's command line is an extra: pip install 'jezero[cli]'")


if TYPE_CHECKING:
    from click.shell_completion import CompletionItem


class Listed(NamedTuple):
    """Place of a command, and its line in the help."""

    module: str
    name: str
    summary: str


SECTIONS: dict[str, dict[str, Listed]] = {
    "Stack": {
        "up": Listed("jezero.cli.stack", "up", "Start the services (Ctrl+C stops them; -d in the background)."),
        "down": Listed("jezero.cli.stack", "down", "Stop the services."),
        "ps": Listed("jezero.cli.stack", "ps", "Show the state and health of the services."),
        "logs": Listed("jezero.cli.stack", "logs", "Show the output of the services."),
        "twin": Listed("jezero.cli.twin", "twin", "Run a simulated vehicle as hardware would be, to rehearse on it."),
        "info": Listed("jezero.cli.info", "info", "Show the declared services and topics."),
        "keys": Listed("jezero.cli.keys", "keys", "Make the certificates of a team's computers and people."),
    },
    "Flight": {
        "preflight": Listed("jezero.cli.flight", "preflight", "Check what a pilot checks before a takeoff."),
        "takeoff": Listed("jezero.cli.flight", "takeoff", "Take off."),
        "target": Listed("jezero.cli.flight", "target", "Fly to a point."),
        "land_on_spot": Listed("jezero.cli.flight", "land_on_spot", "Land."),
        "return": Listed("jezero.cli.flight", "return_home", "Fly home and land, on the rover if it is known."),
        "hover": Listed("jezero.cli.flight", "hover", "Hover here, or at a point."),
        "pause": Listed("jezero.cli.flight", "pause", "Pause the goal in charge: hover until it is resumed."),
        "resume": Listed("jezero.cli.flight", "resume", "Go on with the paused goal in charge."),
        "modify": Listed("jezero.cli.flight", "modify", "Change fields of the goal in charge, such as its speed."),
        "abort": Listed("jezero.cli.flight", "abort", "End the goal in charge and hover."),
        "kill": Listed("jezero.cli.flight", "kill", "Stop the motors at once, also in the air."),
        "action": Listed("jezero.cli.flight", "action", "List all actions, or send a goal to any of them."),
        "status": Listed("jezero.cli.flight", "status", "Show what the vehicle does, and where it is."),
        "rover": Listed("jezero.cli.flight", "rover", "Drive the rover."),
        "ground": Listed("jezero.cli.ground", "ground", "Serve the ground station's pages alone (--connect)."),
        "camera": Listed("jezero.cli.camera", "camera", "Save images of the camera, and calibrate it."),
    },
    "Missions": {
        "fence": Listed("jezero.cli.missions", "fence", "Set the places to stay in and out of."),
        "mission": Listed("jezero.cli.missions", "mission", "Check a mission file, fly it, and command it in flight."),
    },
    "Survey": {
        "getimages": Listed("jezero.cli.survey", "getimages", "Take images of a target from all sides."),
        "gridsweep": Listed(
            "jezero.cli.survey", "gridsweep", "Take images of an area in lines (--plan-only: draw the plan)."
        ),
        "map": Listed("jezero.cli.survey", "map_", "Make a map from the images of gridsweep."),
    },
    "Records": {
        "watch": Listed("jezero.cli.records", "watch", "Serve the messages to a viewer, live (--foxglove)."),
        "recording": Listed("jezero.cli.records", "recording", "Look into recordings, cut, repair and export them."),
        "replay": Listed("jezero.cli.replay", "replay", "Replay a recording (--through: through one of its services)."),
        "tune": Listed("jezero.cli.tune", "tune", "Find the estimator's noise settings that fit recorded flights."),
        "report": Listed("jezero.cli.records", "report", "Draw the figures of recorded flights."),
    },
    "Demonstration": {
        "fly": Listed(
            "jezero.cli.demonstration", "fly", "Fly to two points and land on the rover (--fast: in virtual time)."
        ),
        "demo": Listed("jezero.cli.demonstration", "demo", "Fly the thesis' mission: images, a map, a landing."),
    },
    "Development": {
        "new": Listed("jezero.cli.new", "new", "Write the package of a new action."),
    },
    "Tests": {
        "campaign": Listed("jezero.cli.trials", "campaign", "Fly missions with seeded faults in virtual time."),
        "bench": Listed("jezero.cli.trials", "bench", "Land many times in virtual time and measure the accuracy."),
    },
}
COMMANDS = {name: entry for section in SECTIONS.values() for name, entry in section.items()}


class LazyGroup(click.Group):
    """Group whose commands are those of the table, each imported only when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        entry = COMMANDS.get(cmd_name)
        if entry is None:
            return None
        command = getattr(importlib.import_module(entry.module), entry.name)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.NoSuchCommand as error:  # click knows no names, as no command has been imported
            raise click.NoSuchCommand(error.command_name, possibilities=COMMANDS, ctx=ctx) from None

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list["CompletionItem"]:
        """Commands by the table: a command whose extra is missing can't be imported for its help."""
        from click.shell_completion import CompletionItem

        found = [CompletionItem(name, help=entry.summary) for name, entry in COMMANDS.items()]
        return [item for item in found if item.value.startswith(incomplete)] or super().shell_complete(ctx, incomplete)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; wrong settings, a missing extra and what the operating system refuses become one sentence."""
        try:
            return super().invoke(ctx)
        except ValueError as error:
            from jezero.base.config import ConfigError

            if not isinstance(error, ConfigError):
                raise
            raise click.ClickException(str(error)) from None
        except ModuleNotFoundError as error:
            from jezero.base.extras import extra_hint

            hint = extra_hint(error.name)
            if not hint:
                raise
            raise click.ClickException(f"this command {hint}") from None
        except OSError as error:
            from jezero.base.files import describe_os_error

            if error.errno == EPIPE:  # click ends quietly when nobody reads the output any more
                raise
            raise click.ClickException(describe_os_error(error)) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, entries in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name, entry.summary) for name, entry in entries.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="jezero")
def main() -> None:
    """Fly a drone that works with a rover.

    `jezero up` starts everything; in a second terminal `jezero takeoff`, `jezero target -1 -2 -3` and
    `jezero land_on_spot` fly. `jezero COMMAND --help` explains a command.
    """


if __name__ == "__main__":
    main(prog_name="jezero")
