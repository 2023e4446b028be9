"""Names that the shell completes after TAB; click completes commands, options and choices by itself.

Each function returns the names that begin with what was typed. None of them needs a running stack.
"""

import click
from click.shell_completion import BashComplete, CompletionItem

from jezero.base.mistakes import own_fields


class BashWithoutSpace(BashComplete):
    """Completion in bash, which writes no space after a `KEY=`: the value follows."""

    source_template = BashComplete.source_template.replace(
        "elif [[ $type == 'plain' ]]",
        "elif [[ $type == 'value' ]]; then\n            COMPREPLY+=($value)\n            compopt -o nospace\n"
        "        elif [[ $type == 'plain' ]]",
    )

    def format_completion(self, item: CompletionItem) -> str:
        return f"value,{item.value}" if item.value.endswith("=") else super().format_completion(item)


def actions(context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Names of all actions."""
    from jezero.base.plugins import action_names

    return [name for name in action_names() if name.startswith(incomplete)]


def goal_fields(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """`KEY=` for each field of the goal of the action NAME that has not been typed yet."""
    from jezero.base.plugins import PluginError, find_action

    try:
        found = find_action(context.params.get("name") or "")
    except PluginError:
        return []
    typed = {word.partition("=")[0] for word in context.params.get("fields") or ()}
    words = [f"{name}=" for name in (*own_fields(found.goal_type), "on_client_loss") if name not in typed]
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


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


def worlds(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of the worlds; files where none begins so."""
    from jezero.base.config import known_worlds

    names = [CompletionItem(name) for name in sorted(known_worlds()) if name.startswith(incomplete)]
    return names or [CompletionItem(incomplete, type="file")]


def topics(context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Names of all topics but the feedback of actions and the health of services."""
    from jezero.schemas.topics import TOPICS

    return [topic.name for topic in TOPICS if topic.name.startswith(incomplete)]


def _shipped_services() -> dict[str, tuple[str, ...]]:
    """The profiles of each service of the compose file that jezero ships."""
    from jezero.deploy.launcher.compose import parse, shipped_compose_file

    found = parse(shipped_compose_file().read_text(encoding="utf-8"), {})
    return {name: tuple(service.profiles) for name, service in found.items()}
