"""The lists of the page: events and services. Each row has a mark in front, as colours alone tell nothing."""

from typing import Any

from nicegui.element import Element


class Events(Element, component="static/events.js"):
    """The last events in words, the newest first."""

    def show(self, rows: list[dict[str, Any]]) -> None:
        """Show these rows."""
        if self.props.get("rows") != rows:
            self.props["rows"] = rows


class Services(Element, component="static/services.js"):
    """Each service with its state and its sentence."""

    def show(self, rows: list[dict[str, Any]]) -> None:
        """Show these rows."""
        if self.props.get("rows") != rows:
            self.props["rows"] = rows
