"""Getting into brokers that ask who comes, and not into those that are not what they say."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brokers import free_port, has_ipv6, mosquitto, password_file
from support.certificates import Certificates, Pair
from support.command import plotfeed_here
from support.scene_files import scene_file, scene_text
from support.waiting import until

from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys
from plotfeed.feeds.scene.scene import SceneError, load
from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker
from plotfeed.feeds.transport.mqtt.address import (
    VERSIONS,
    AccessError,
    AddressError,
    BrokerAccess,
    BrokerAddress,
)
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MqttError

ME, PASSWORD = "surveyor", "open sesame"
PLACES = ("anyone", "password", "tls", "tls-password", "mutual", "expired", "elsewhere")


@dataclass(frozen=True)
class Brokers:
    """A broker that listens in all these ways, and the certificates to it."""

    kind: str
    ports: dict[str, int]
    certificates: Certificates

    def url(self, place: str, host: str = "127.0.0.1") -> str:
        scheme = "mqtt" if place in {"anyone", "password", "mqtt3"} else "mqtts"
        return f"{scheme}://{host}:{self.ports[place]}"

    def access(
        self, *, client: Pair | None = None, ca: Path | None = None, password: str | None = None
    ) -> BrokerAccess:
        return BrokerAccess(
            ca_file=ca or self.certificates.ca,
            certificate_file=client and client.certificate,
            key_file=client and client.key,
            username=None if password is None else ME,
            password=password,
        )


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return Certificates(tmp_path_factory.mktemp("certificates"))


def tls_of_mosquitto(pair: Pair) -> str:
    return f"certfile {pair.certificate}\nkeyfile {pair.key}\n"


@pytest.fixture(scope="module")
def brokers(
    certificates: Certificates, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Brokers]:
    folder = tmp_path_factory.mktemp("mosquitto")
    asks = f"allow_anonymous false\npassword_file {password_file(folder, ME, PASSWORD)}\n"
    ours = tls_of_mosquitto(certificates.broker)
    settings = {
        "anyone": "allow_anonymous true\n",
        "password": asks,
        "tls": f"allow_anonymous true\n{ours}",
        "tls-password": asks + ours,
        "mutual": f"{ours}cafile {certificates.ca}\nrequire_certificate true\n"
        "allow_anonymous true\n",
        "expired": f"allow_anonymous true\n{tls_of_mosquitto(certificates.expired)}",
        "elsewhere": f"allow_anonymous true\n{tls_of_mosquitto(certificates.elsewhere)}",
    }
    ports = {place: free_port() for place in settings}
    text = "".join(f"listener {ports[p]} 127.0.0.1\n{settings[p]}" for p in settings)
    with mosquitto(folder, ports["anyone"], text):
        yield Brokers("mosquitto", ports, certificates)


async def version_spoken(address: BrokerAddress) -> int:
    """Connect and go; raises what a session would say after its first attempt."""
    link = MqttTransport(address, "test")
    running = asyncio.create_task(link.run())
    try:
        await until(lambda: link.connections or link.last_error)
        await link.wait_until_up(0.0)
        assert link.is_up
        return link._versions[0]
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def refusal(address: BrokerAddress) -> str:
    with pytest.raises(MqttError) as caught:
        await version_spoken(address)
    text = str(caught.value)
    assert caught.value.exit_code == 1
    assert text.startswith(f"MQTT broker {address}: ")
    assert text.isprintable()
    assert PASSWORD not in text
    assert PASSWORD not in repr(address)
    return text.removeprefix(f"MQTT broker {address}: ")


@pytest.mark.parametrize("place", ["anyone", "password", "tls", "tls-password"])
@pytest.mark.asyncio
async def test_whoever_has_the_keys_comes_in(brokers: Brokers, place: str) -> None:
    password = PASSWORD if "password" in place else None
    url = brokers.url(place)
    access = brokers.access(password=password)
    if not url.startswith("mqtts"):
        access = BrokerAccess(username=access.username, password=access.password)
    for version in ("any", "5"):
        address = BrokerAddress.parse(url, versions=VERSIONS[version], access=access)
        assert await version_spoken(address) == 5


@pytest.mark.asyncio
async def test_a_client_is_known_by_its_certificate(brokers: Brokers) -> None:
    access = brokers.access(client=brokers.certificates.client)
    for version, spoken in (("any", 5), ("5", 5), ("3.1.1", 4)):
        address = BrokerAddress.parse(
            brokers.url("mutual"), versions=VERSIONS[version], access=access
        )
        assert await version_spoken(address) == spoken


@pytest.mark.parametrize("version", ["5", "3.1.1", "any"])
@pytest.mark.parametrize("client", ["none", "stranger"])
@pytest.mark.asyncio
async def test_a_client_without_its_certificate_stays_outside(
    brokers: Brokers, client: str, version: str
) -> None:
    pair = brokers.certificates.stranger if client == "stranger" else None
    address = BrokerAddress.parse(
        brokers.url("mutual"), versions=VERSIONS[version], access=brokers.access(client=pair)
    )
    # Whether its alert or the end of the connection comes first is up to the network.
    text = await refusal(address)
    assert "certificate" in text or "TLS failed: " in text


@pytest.mark.parametrize("place", ["password", "tls-password"])
@pytest.mark.parametrize("password", [None, "wrong"])
@pytest.mark.asyncio
async def test_a_wrong_password_is_told_as_far_as_the_broker_tells(
    brokers: Brokers, place: str, password: str | None
) -> None:
    access = BrokerAccess(username=password and ME, password=password)
    if place.startswith("tls"):
        access = brokers.access(password=password)
    for version in VERSIONS.values():
        text = await refusal(
            BrokerAddress.parse(brokers.url(place), versions=version, access=access)
        )
        if brokers.kind == "mosquitto":
            assert text in {"it refuses: not authorized", "it refuses: not authorised"}
        else:
            assert "user name and password" in text  # it hangs up without a word


UNTRUSTED = {
    "expired": "certificate has expired",
    "elsewhere": "certificate is not valid for '127.0.0.1'",
}


@pytest.mark.parametrize("place", UNTRUSTED)
@pytest.mark.asyncio
async def test_a_broker_that_is_not_what_it_says_is_not_trusted(
    brokers: Brokers, place: str
) -> None:
    text = await refusal(BrokerAddress.parse(brokers.url(place), access=brokers.access()))
    assert text.startswith("its certificate is not good: ")
    assert UNTRUSTED[place] in text


@pytest.mark.parametrize("ca", ["other", "system"])
@pytest.mark.asyncio
async def test_a_broker_whom_nobody_vouches_for_is_not_trusted(brokers: Brokers, ca: str) -> None:
    access = brokers.access(ca=brokers.certificates.other_ca) if ca == "other" else BrokerAccess()
    text = await refusal(BrokerAddress.parse(brokers.url("tls"), access=access))
    assert text == "its certificate is not good: unable to get local issuer certificate"


@pytest.mark.asyncio
async def test_a_name_must_be_the_brokers_too(brokers: Brokers) -> None:
    url = brokers.url("tls", "localhost")
    assert await version_spoken(BrokerAddress.parse(url, access=brokers.access())) == 5
    url = brokers.url("elsewhere", "localhost")
    text = await refusal(BrokerAddress.parse(url, access=brokers.access()))
    assert "Hostname mismatch" in text


@pytest.mark.asyncio
async def test_tls_where_there_is_none_and_none_where_there_is_are_told(brokers: Brokers) -> None:
    plain = f"mqtt://127.0.0.1:{brokers.ports['tls']}"
    assert "it wants TLS (mqtts://)" in await refusal(BrokerAddress.parse(plain))
    secured = f"mqtts://127.0.0.1:{brokers.ports['anyone']}"
    assert await refusal(BrokerAddress.parse(secured, access=brokers.access()))


async def only_3_1_1(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Welcome who speaks 3.1.1, and say to others that it is not spoken here (3.1.2.2)."""
    hello = await reader.read(1024)
    speaks_it = hello[hello.index(b"MQTT") + 4] == 4
    writer.write(b"\x20\x02\x00\x00" if speaks_it else b"\x20\x02\x00\x01")
    await (reader.read() if speaks_it else writer.drain())
    writer.close()


@pytest.mark.asyncio
async def test_a_broker_of_3_1_1_alone_is_spoken_to_in_3_1_1() -> None:
    async with await asyncio.start_server(only_3_1_1, "127.0.0.1", 0) as server:
        url = f"mqtt://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        for version in ("any", "3.1.1"):
            assert await version_spoken(BrokerAddress.parse(url, versions=VERSIONS[version])) == 4
        text = await refusal(BrokerAddress.parse(url, versions=VERSIONS["5"]))
    assert text == "it refuses: unacceptable protocol version"


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6 loopback")
@pytest.mark.asyncio
async def test_brokers_are_reached_by_ipv6() -> None:
    broker = await EmbeddedBroker.start(free_port(), EmbeddedBrokerKeys(host="::1"))
    try:
        address = BrokerAddress.parse(f"mqtt://[::1]:{broker.ports.mqtt}")
        assert await version_spoken(address) == 5
    finally:
        await broker.stop()


@pytest.mark.asyncio
async def test_a_host_that_is_none_is_told() -> None:
    assert await refusal(BrokerAddress.parse("mqtt://nowhere.invalid"))
    assert await refusal(BrokerAddress.parse(f"mqtt://{'a' * 64}")) == "no host can have this name"
    refused = await refusal(BrokerAddress.parse(f"mqtt://127.0.0.1:{free_port()}"))
    assert "refused" in refused or "failed" in refused


def test_keys_are_for_tls_alone(certificates: Certificates) -> None:
    with pytest.raises(AddressError, match="need mqtts://"):
        BrokerAddress.parse("mqtt://localhost", access=BrokerAccess(ca_file=certificates.ca))


def test_files_that_are_no_keys_are_named(certificates: Certificates, tmp_path: Path) -> None:
    ours, junk, absent = certificates.client, tmp_path / "junk", tmp_path / "absent"
    junk.write_text("junk")
    cases = [
        (BrokerAccess(ca_file=junk), f"CA file {junk}: no certificate in it"),
        (BrokerAccess(ca_file=absent), f"CA file {absent}: No such file or directory"),
        (
            BrokerAccess(certificate_file=ours.certificate, key_file=certificates.stranger.key),
            f"client certificate {ours.certificate}, key {certificates.stranger.key}: "
            "the key is of another certificate",
        ),
        (
            BrokerAccess(certificate_file=junk, key_file=ours.key),
            f"client certificate {junk}, key {ours.key}: not both PEM, or the key has a passphrase",
        ),
        (
            BrokerAccess(certificate_file=ours.certificate),
            f"client certificate {ours.certificate}, key in it: "
            "not both PEM, or the key has a passphrase",
        ),
        (
            BrokerAccess(certificate_file=absent, key_file=ours.key),
            f"client certificate {absent}, key {ours.key}: No such file or directory",
        ),
        (
            BrokerAccess(certificate_file=ours.certificate, key_file=absent),
            f"client key {absent}: no such file",
        ),
        (BrokerAccess(key_file=ours.key), f"client key {ours.key}: expected its certificate too"),
    ]
    for access, text in cases:
        with pytest.raises(AccessError) as caught:
            access.tls_context()
        assert str(caught.value) == text


def test_the_environment_stands_before_the_file(tmp_path: Path) -> None:
    path = tmp_path / "credentials.toml"
    path.write_text('username = "file"\npassword = "of the file"\n')
    user, secret = "PLOTFEED_MQTT_USERNAME", "PLOTFEED_MQTT_PASSWORD"
    found = BrokerAccess().with_credentials(path, {})
    assert (found.username, found.password) == ("file", "of the file")
    found = BrokerAccess().with_credentials(path, {secret: PASSWORD})
    assert (found.username, found.password) == ("file", PASSWORD)
    found = BrokerAccess().with_credentials(path, {user: ME, secret: PASSWORD})
    assert (found.username, found.password) == (ME, PASSWORD)
    found = BrokerAccess().with_credentials(None, {user: ME})
    assert (found.username, found.password) == (ME, None)
    assert BrokerAccess().with_credentials(None, {}) == BrokerAccess()


@pytest.mark.parametrize(
    "environment",
    [
        {"PLOTFEED_MQTT_PASSWORD": "a secret"},
        {"PLOTFEED_MQTT_USERNAME": ME, "PLOTFEED_MQTT_PASSWORD": "a secret\udcff"},
        {"PLOTFEED_MQTT_USERNAME": ME, "PLOTFEED_MQTT_PASSWORD": "a secret" * 10_000},
    ],
)
def test_credentials_that_mqtt_cannot_carry_are_refused(environment: dict[str, str]) -> None:
    with pytest.raises(AccessError) as caught:
        BrokerAccess().with_credentials(None, environment)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("topic", ["a/+", "a/#", "a\x07"])
def test_topics_that_no_broker_takes_are_refused(tmp_path: Path, topic: str) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_text("time,latitude_deg,longitude_deg,altitude_m\n1767268800,40,-3,9\n")
    options = ("--set", "altitude_reference=ellipsoid", "--prefix", topic)
    done = plotfeed_here("inject", flight, *options)
    assert done.returncode == 2
    assert done.stderr.startswith("plotfeed: topic 'a")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("prefix", ["$SYS/here", "a/b\\u0007"])
def test_prefixes_that_no_broker_takes_are_refused(tmp_path: Path, prefix: str) -> None:
    path = scene_file(tmp_path, scene_text(mqtt=f'prefix = "{prefix}"'))
    with pytest.raises(SceneError, match=r"mqtt\.prefix: expected printable characters"):
        load(path)


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
