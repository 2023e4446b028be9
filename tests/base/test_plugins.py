"""Actions of installed packages: which names they may have."""

from importlib.metadata import EntryPoint

import pytest

from jezero.base import plugins
from jezero.services.table import SERVICES


def test_no_action_may_have_the_name_of_a_service() -> None:
    assert {row.name for row in SERVICES} == set(plugins.SERVICE_NAMES)


def test_an_installed_action_with_a_name_that_it_may_not_have_is_left_out_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = tuple(EntryPoint(name, "mine:ACTION", plugins.GROUP) for name in ("spiral", "recorder", "go_to", "My-Own"))
    monkeypatch.setattr(plugins, "entry_points", lambda group: points)
    assert plugins.plugin_names.__wrapped__() == ("spiral",)
    refusals = plugins.refused_plugins()
    assert list(refusals) == ["My-Own", "go_to", "recorder"]
    assert refusals["recorder"] == (
        "action 'recorder' has the name of a service: its package must give it another name"
    )
    with pytest.raises(plugins.PluginError, match="action 'recorder' has the name of a service"):
        plugins.load_declaration.__wrapped__("recorder")
