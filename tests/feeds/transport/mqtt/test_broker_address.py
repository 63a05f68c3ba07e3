from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.transport.mqtt.address import (
    AccessError,
    AddressError,
    BrokerAccess,
    BrokerAddress,
)


@pytest.mark.parametrize(
    ("url", "host", "port"),
    [
        ("mqtt://localhost", "localhost", 1883),
        ("mqtt://10.0.0.1:1884", "10.0.0.1", 1884),
        ("mqtt://[::1]:1884", "::1", 1884),
        ("MQTT://broker.example:1", "broker.example", 1),
        ("mqtt://localhost/", "localhost", 1883),
        ("mqtts://localhost", "localhost", 8883),
    ],
)
def test_an_address_is_a_host_and_a_port(url: str, host: str, port: int) -> None:
    address = BrokerAddress.parse(url)
    assert (address.host, address.port) == (host, port)
    assert BrokerAddress.parse(str(address)) == address


@pytest.mark.parametrize(
    "url",
    [
        "", "localhost", "localhost:1883", "http://localhost", "mqtt://", "mqtt://:1883",
        "mqtt://localhost:x", "mqtt://localhost:0", "mqtt://localhost:65536", "mqtt://[::1",
        "mqtt://user@localhost", "mqtt://user:secret@localhost", "mqtt://localhost/topic",
    ],
)  # fmt: skip
def test_what_is_no_address_is_refused_without_showing_secrets(url: str) -> None:
    with pytest.raises(AddressError) as caught:
        BrokerAddress.parse(url)
    assert "secret" not in str(caught.value)


@given(st.text(max_size=30) | st.text(max_size=20).map("mqtt://".__add__))
def test_arbitrary_text_is_an_address_or_none(url: str) -> None:
    try:
        address = BrokerAddress.parse(url)
    except AddressError as error:
        assert str(error)
    else:
        assert address.host
        assert 0 < address.port < 65536


def test_a_password_is_never_shown() -> None:
    assert "secret" not in repr(BrokerAccess(username="me", password="secret"))  # noqa: S106


def test_credentials_that_cannot_be_read_are_one_line_without_them(tmp_path: Path) -> None:
    path = tmp_path / "credentials.toml"
    for text in ('username = "me"\npassword = secret', 'password = "secret"', "username = 5"):
        path.write_text(text)
        with pytest.raises(AccessError) as caught:
            BrokerAccess().with_credentials(path, {})
        assert "secret" not in str(caught.value)
        assert str(path) in str(caught.value)
