"""The option with which a takeoff overrides failed preflight checks."""

from typing import Any, get_args

import click


class OverrideName(click.ParamType[str]):
    """The name of a preflight check that a takeoff may override."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from jezero.schemas.preflight import Override

        if value not in (names := get_args(Override)):
            self.fail(f"{value!r} is no check that can be overridden; these are: {', '.join(names)}", param, ctx)
        return str(value)


override_option = click.option(
    "--override",
    multiple=True,
    type=OverrideName(),
    help="Take off although this preflight check has failed; may be given several times.",
)
