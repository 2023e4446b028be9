"""Names that the shell completes after TAB; click completes commands, options and choices by itself.

Each function returns the names that begin with what was typed. None of them needs a running stack.
"""

import click
from click.shell_completion import CompletionItem


def actions(context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Names of all actions."""
    from jezero.base.plugins import action_names

    return [name for name in action_names() if name.startswith(incomplete)]


def missions(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of the missions that come with jezero; files where none begins so."""
    from jezero.mission_files import shipped_names

    names = [CompletionItem(name) for name in shipped_names() if name.startswith(incomplete)]
    return names or [CompletionItem(incomplete, type="file")]


def files(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of files, where any text is taken."""
    return [CompletionItem(incomplete, type="file")]


def services(context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Names of the services of jezero's compose file."""
    return [name for name in _shipped_services() if name.startswith(incomplete)]


def profiles(context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Names of the profiles of jezero's compose file."""
    found = {profile for profiles in _shipped_services().values() for profile in profiles}
    return sorted(profile for profile in found if profile.startswith(incomplete))


def topics(context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Names of all topics but the feedback of actions and the health of services."""
    from jezero.schemas.topics import TOPICS

    return [topic.name for topic in TOPICS if topic.name.startswith(incomplete)]


def _shipped_services() -> dict[str, tuple[str, ...]]:
    """The profiles of each service of the compose file that jezero ships."""
    from jezero.deploy.launcher.compose import parse, shipped_compose_file

    found = parse(shipped_compose_file().read_text(encoding="utf-8"), {})
    return {name: tuple(service.profiles) for name, service in found.items()}
