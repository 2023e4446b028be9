"""The `jezero` command. A command's module is imported only when that command runs."""

import importlib
import os
import sys
from errno import EPIPE
from typing import TYPE_CHECKING, Any

from jezero.base.extras import extra_hint, pip_command
from jezero.cli.sections import COMMANDS, SECTIONS

try:
    import click
except ModuleNotFoundError:
    typed = next((COMMANDS[word] for word in sys.argv[1:] if word in COMMANDS), None)
    sys.exit(
        f"jezero's command line is an extra: {pip_command('cli' if typed is None else typed.extras_for(sys.argv))}"
    )


if TYPE_CHECKING:
    from click.shell_completion import CompletionItem


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
            entry = COMMANDS.get(ctx.invoked_subcommand or "")
            hint = extra_hint(error.name, extras="" if entry is None else entry.extras)
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


if "_JEZERO_COMPLETE" in os.environ:
    from click.shell_completion import add_completion_class

    from jezero.cli.completion import BashWithoutSpace

    add_completion_class(BashWithoutSpace)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="jezero")
def main() -> None:
    """Fly a drone that works with a rover.

    `jezero up` starts everything; in a second terminal `jezero takeoff`, `jezero target -1 -2 -3` and
    `jezero land_on_spot` fly. `jezero COMMAND --help` explains a command.
    """


if __name__ == "__main__":
    main(prog_name="jezero")
