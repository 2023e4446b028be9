"""Identity from the environment: what is wrong is named."""

import pytest

from jezero.base.config import ConfigError
from jezero.runtime.instance import instance_from_environment


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        ("JEZERO_VEHICLE", "a/b", "is 'a/b': expected 1 to 32 letters, digits, '-' and '_'"),
        ("JEZERO_ROUTER", "tcp/here", "'tcp/here' is no address of a router"),
        ("JEZERO_ROUTER", "ws/here:1", "'ws/here:1' is no address of a router"),
        (
            "JEZERO_ROUTER",
            "tls/here:1",
            "tls/here:1 needs keys: name the folder of a bundle with --keys or JEZERO_KEYS",
        ),
        ("JEZERO_ROUTER", "tcp/10.0.0.1:1", "without TLS whoever is on the network of tcp/10.0.0.1:1 could fly"),
        ("JEZERO_INSTANCE", "250", "is '250': expected a whole number from 0 to 249"),
        ("JEZERO_INSTANCE", "one", "is 'one': expected a whole number, not a text"),
        ("JEZERO_GCS_PORT", "0", "is '0': expected a whole number from 1 to 65535"),
    ],
)
def test_a_wrong_variable_is_named_with_its_value_and_what_is_expected(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, expected: str
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigError) as caught:
        instance_from_environment()
    assert str(caught.value).startswith(variable) and expected in str(caught.value)


def test_an_address_without_tls_leaves_this_computer_where_a_variable_permits_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("JEZERO_ROUTER", "tcp/10.0.0.1:1")
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    assert instance_from_environment().router == "tcp/10.0.0.1:1"
    monkeypatch.setenv("JEZERO_INSECURE", "0")
    with pytest.raises(ConfigError, match="without TLS"):
        instance_from_environment()
