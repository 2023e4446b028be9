"""The table of all generated pages."""

from importlib import import_module

PAGES = ("topics", "actions", "settings", "commands")
"""Names of the pages: each is a module beside this one with a function `page`."""


def reference_page(name: str) -> str:
    """The page docs/reference/<name>.md."""
    text: str = import_module(f"jezero.cli.reference.{name}").page()
    return text
