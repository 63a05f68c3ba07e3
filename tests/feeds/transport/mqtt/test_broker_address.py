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
    for text in (
        'username = "me"\npassword = secret',
        'password = "secret"',
        "username = 5",
        "",
        'ca = "secret"',
    ):
        path.write_text(text)
        with pytest.raises(AccessError) as caught:
            BrokerAccess().with_credentials(path, {})
        assert "secret" not in str(caught.value)
        assert str(path) in str(caught.value)


def test_a_file_of_credentials_holds_what_a_scene_can_say_and_the_scene_stands_before_it(
    tmp_path: Path,
) -> None:
    path = tmp_path / "credentials.toml"
    path.write_text('ca_file = "ca.pem"\nclient_key_file = "/a/key.pem"\nversion = "3.1.1"\n')
    found = BrokerAccess(key_file=Path("own.pem")).with_credentials(path, {})
    assert found == BrokerAccess(
        ca_file=tmp_path / "ca.pem", key_file=Path("own.pem"), version="3.1.1"
    )
    assert BrokerAddress.parse("mqtts://here", access=found).versions == (4,)
    assert BrokerAccess(version="5").with_credentials(path, {}).version == "5"
    path.write_text('version = "4"\n')
    with pytest.raises(AccessError, match=r"version: expected one of 5, 3\.1\.1, any"):
        BrokerAccess().with_credentials(path, {})
