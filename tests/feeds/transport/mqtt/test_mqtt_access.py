"""Getting into brokers that ask who comes, and not into those that are not what they say.

A link does, and whole commands, whose keys are in a scene or in a file.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brokers import free_port, has_ipv6, mosquitto, password_file, wait_until_listening
from support.certificates import Certificates, Pair
from support.command import plotfeed, plotfeed_here, running
from support.own_time import in_own_time
from support.scene_files import radar, scene_file, scene_text
from support.servers import serving
from support.waiting import kept_up, until

from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys, MqttQueueKeys
from plotfeed.feeds.scene.scene import SceneError, from_tree, load
from plotfeed.feeds.transport.brokers import broker_address
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
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttReceiver

ME, PASSWORD = "surveyor", "open sesame"


@dataclass(frozen=True)
class Brokers:
    """Where mosquitto listens in all these ways, and the certificates to it."""

    ports: dict[str, int]
    certificates: Certificates

    def address(
        self,
        place: str,
        version: str = "any",
        *,
        host: str = "127.0.0.1",
        client: Pair | None = None,
        ca: Path | None = None,
        password: str | None = None,
    ) -> BrokerAddress:
        secured = place not in {"anyone", "password"}
        access = BrokerAccess(
            ca_file=(ca or self.certificates.ca) if secured else None,
            certificate_file=client and client.certificate,
            key_file=client and client.key,
            username=None if password is None else ME,
            password=password,
            version=version,
        )
        url = f"{'mqtts' if secured else 'mqtt'}://{host}:{self.ports[place]}"
        return BrokerAddress.parse(url, access=access)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return Certificates(tmp_path_factory.mktemp("certificates"))


@pytest.fixture(scope="module")
def brokers(
    certificates: Certificates, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Brokers]:
    folder = tmp_path_factory.mktemp("mosquitto")
    anyone = "allow_anonymous true\n"
    asks = f"allow_anonymous false\npassword_file {password_file(folder, ME, PASSWORD)}\n"
    ours, expired, elsewhere = (
        f"certfile {pair.certificate}\nkeyfile {pair.key}\n"
        for pair in (certificates.broker, certificates.expired, certificates.elsewhere)
    )
    settings = {
        "anyone": anyone,
        "password": asks,
        "tls": anyone + ours,
        "tls-password": asks + ours,
        "mutual": f"{anyone}{ours}cafile {certificates.ca}\nrequire_certificate true\n",
        "both": f"{asks}{ours}cafile {certificates.ca}\nrequire_certificate true\n",
        "expired": anyone + expired,
        "elsewhere": anyone + elsewhere,
    }
    ports = {place: free_port() for place in settings}
    text = "".join(f"listener {ports[p]} 127.0.0.1\n{settings[p]}" for p in settings)
    text += "max_queued_messages 0\n"
    with mosquitto(folder, ports["anyone"], text):
        yield Brokers(ports, certificates)


async def version_spoken(address: BrokerAddress) -> int:
    """Connect and go; raises what a session would say after its first attempt."""
    link = MqttTransport(address, "test")
    async with kept_up(link.run()):
        await until(lambda: link.connections or link.last_error)
        await link.wait_until_up(0.0)
        assert link.is_up
        return link.version


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


@pytest.mark.asyncio
async def test_whoever_has_the_keys_comes_in(brokers: Brokers) -> None:
    ours = brokers.certificates.client
    for address, spoken in (
        (brokers.address("anyone", "any"), 5),
        (brokers.address("password", "5", password=PASSWORD), 5),
        (brokers.address("tls", "any"), 5),
        (brokers.address("tls", host="localhost"), 5),
        (brokers.address("tls-password", "3.1.1", password=PASSWORD), 4),
        (brokers.address("mutual", "any", client=ours), 5),
        (brokers.address("mutual", "3.1.1", client=ours), 4),
    ):
        assert await version_spoken(address) == spoken


NO_ISSUER = "its certificate is not good: unable to get local issuer certificate"


@pytest.mark.asyncio
async def test_whoever_has_not_stays_outside_and_whoever_is_not_trusted_is_not_told(
    brokers: Brokers,
) -> None:
    keys = brokers.certificates
    for address, words in (
        *((brokers.address("password", v), "it refuses: not authori") for v in ("5", "3.1.1")),
        (brokers.address("password", password=PASSWORD[1:]), "it refuses: not authori"),
        (brokers.address("tls-password", "3.1.1"), "it refuses: not authori"),
        (brokers.address("tls-password", password=PASSWORD[1:]), "it refuses: not authori"),
        (brokers.address("expired"), "its certificate is not good: certificate has expired"),
        (brokers.address("elsewhere"), "certificate is not valid for '127.0.0.1'"),
        (brokers.address("elsewhere", host="localhost"), "Hostname mismatch"),
        (brokers.address("tls", ca=keys.other_ca), NO_ISSUER),
        (BrokerAddress.parse(f"mqtts://127.0.0.1:{brokers.ports['tls']}"), NO_ISSUER),
        (
            BrokerAddress.parse(f"mqtt://127.0.0.1:{brokers.ports['tls']}"),
            "it wants TLS (mqtts://)",
        ),
        (BrokerAddress.parse(f"mqtts://127.0.0.1:{brokers.ports['anyone']}"), ""),
    ):
        assert words in await refusal(address)
    # Whether its alert or the end of the connection comes first is up to the network.
    for version, client in (("5", None), ("any", keys.stranger), ("3.1.1", keys.stranger)):
        text = await refusal(brokers.address("mutual", version, client=client))
        assert "certificate" in text or "TLS failed: " in text


@in_own_time
async def test_a_broker_that_takes_no_more_connections_is_not_taken_for_tls() -> None:
    """As mosquitto does, which miscounts after that: so it is done in its stead."""

    async def hang_up(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    async with serving(hang_up) as port:
        text = await refusal(BrokerAddress.parse(f"mqtt://127.0.0.1:{port}"))
    assert text.startswith("it hung up without an answer: it may have as many connections as it")
    assert "a user name and password, or another version of MQTT than" in text
    assert "TLS" not in text


@in_own_time
async def test_a_broker_of_3_1_1_alone_is_spoken_to_in_3_1_1() -> None:
    """It welcomes who speaks that, and says to others that it is not spoken here (3.1.2.2)."""

    async def only_3_1_1(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        hello = await reader.read(1024)
        speaks_it = hello[hello.index(b"MQTT") + 4] == 4
        writer.write(b"\x20\x02\x00\x00" if speaks_it else b"\x20\x02\x00\x01")
        await (reader.read() if speaks_it else writer.drain())
        writer.close()

    async with serving(only_3_1_1) as port:
        url = f"mqtt://127.0.0.1:{port}"
        for version in ("any", "3.1.1"):
            access = BrokerAccess(version=version)
            assert await version_spoken(BrokerAddress.parse(url, access=access)) == 4
        text = await refusal(BrokerAddress.parse(url, access=BrokerAccess(version="5")))
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


def test_files_that_are_no_keys_are_named(certificates: Certificates, tmp_path: Path) -> None:
    ours, junk, absent = certificates.client, tmp_path / "junk", tmp_path / "absent"
    junk.write_text("junk")
    other, pem, nothing = certificates.stranger.key, ours.certificate, "No such file or directory"
    unread = "not both PEM, or the key has a passphrase"
    for ca, certificate, key, text in (
        (junk, None, None, f"CA file {junk}: no certificate in it"),
        (absent, None, None, f"CA file {absent}: {nothing}"),
        (None, pem, other, f"certificate {pem}, key {other}: the key is of another certificate"),
        (None, junk, ours.key, f"client certificate {junk}, key {ours.key}: {unread}"),
        (None, pem, None, f"client certificate {pem}, key in it: {unread}"),
        (None, absent, ours.key, f"client certificate {absent}, key {ours.key}: {nothing}"),
        (None, pem, absent, f"client key {absent}: no such file"),
        (None, None, ours.key, f"client key {ours.key}: expected its certificate too"),
    ):
        with pytest.raises(AccessError) as caught:
            BrokerAccess(ca_file=ca, certificate_file=certificate, key_file=key).tls_context()
        assert str(caught.value).removeprefix("client ") == text.removeprefix("client ")


def test_the_environment_stands_before_the_file_and_the_scene_before_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, own = tmp_path / "credentials.toml", BrokerAccess(key_file=Path("own.pem"), version="5")
    assert BrokerAccess().with_credentials(None) == BrokerAccess()
    path.write_text(
        'username = "file"\npassword = "of the file"\n'
        'ca_file = "ca.pem"\nclient_key_file = "/a/key.pem"\nversion = "3.1.1"\n'
    )
    for name, value, expected in (
        ("", "", ("file", "of the file")),
        ("PLOTFEED_MQTT_PASSWORD", PASSWORD, ("file", PASSWORD)),
        ("PLOTFEED_MQTT_USERNAME", ME, (ME, PASSWORD)),
    ):
        if name:
            monkeypatch.setenv(name, value)
        found = BrokerAccess().with_credentials(path)
        assert (found.username, found.password) == expected
        assert (found.ca_file, found.key_file) == (tmp_path / "ca.pem", Path("/a/key.pem"))
        assert BrokerAddress.parse("mqtts://here", access=found).versions == (4,)
    found = own.with_credentials(path)
    assert (found.key_file, found.version) == (Path("own.pem"), "5")
    monkeypatch.delenv("PLOTFEED_MQTT_PASSWORD")
    found = BrokerAccess().with_credentials(None)
    assert (found.username, found.password) == (ME, None)


NOT_READ = [
    'username = "me"\npassword = secret',
    'password = "secret"',
    "username = 5",
    "",
    'ca = "secret"',
    'version = "4"',
]
NOT_CARRIED = [("", "a secret"), (ME, "a secret\udcff"), (ME, "a secret" * 10_000)]


def test_credentials_that_cannot_be_read_or_carried_are_one_line_without_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "credentials.toml"
    for text in NOT_READ:
        path.write_text(text)
        with pytest.raises(AccessError) as caught:
            BrokerAccess().with_credentials(path)
        assert "secret" not in str(caught.value)
        assert str(path) in str(caught.value)
    assert "version: expected one of 5, 3.1.1, any" in str(caught.value)
    for name, password in NOT_CARRIED:
        monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", password)
        if name:
            monkeypatch.setenv("PLOTFEED_MQTT_USERNAME", name)
        with pytest.raises(AccessError) as caught:
            BrokerAccess().with_credentials(None)
        assert "secret" not in str(caught.value)
    assert "secret" not in repr(BrokerAccess(username="me", password="secret"))  # noqa: S106


def test_topics_and_prefixes_that_no_broker_takes_are_refused(tmp_path: Path) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_text("time,latitude_deg,longitude_deg,altitude_m\n1767268800,40,-3,9\n")
    for topic in ("a/+", "a\x07"):
        options = ("--set", "altitude_reference=ellipsoid", "--prefix", topic)
        done = plotfeed_here("inject", flight, *options)
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
        assert done.stderr.startswith("plotfeed: topic 'a")
    for prefix in ("$SYS/here", "a/b\\u0007"):
        with pytest.raises(SceneError, match=r"mqtt\.prefix: expected printable characters"):
            load(scene_file(tmp_path, scene_text(mqtt=f'prefix = "{prefix}"')))


def test_an_address_is_a_host_and_a_port_and_shows_no_secrets(certificates: Certificates) -> None:
    for url, host, port in (
        ("mqtt://localhost", "localhost", 1883),
        ("mqtt://[::1]:1884", "::1", 1884),
        ("MQTT://broker.example:1", "broker.example", 1),
        ("mqtt://localhost/", "localhost", 1883),
        ("mqtts://localhost", "localhost", 8883),
    ):
        address = BrokerAddress.parse(url)
        assert (address.host, address.port) == (host, port)
        assert BrokerAddress.parse(str(address)) == address
    for url in (
        *("", "localhost", "localhost:1883", "http://localhost", "mqtt://", "mqtt://:1883"),
        *("mqtt://localhost:x", "mqtt://localhost:0", "mqtt://localhost:65536", "mqtt://[::1"),
        *("mqtt://user@localhost", "mqtt://user:secret@localhost", "mqtt://localhost/topic"),
    ):
        with pytest.raises(AddressError) as caught:
            BrokerAddress.parse(url)
        assert "secret" not in str(caught.value)
    with pytest.raises(AddressError, match="need mqtts://"):  # keys are for TLS alone
        BrokerAddress.parse("mqtt://localhost", access=BrokerAccess(ca_file=certificates.ca))


@given(st.text(max_size=30) | st.text(max_size=20).map("mqtt://".__add__))
def test_arbitrary_text_is_an_address_or_none(url: str) -> None:
    try:
        address = BrokerAddress.parse(url)
    except AddressError as error:
        assert str(error)
    else:
        assert address.host
        assert 0 < address.port < 65536


# What docs/mqtt.md and docs/udp.md tell to write down.

DOCS = Path(__file__).parents[4] / "docs"
REST = {key: of for key, of in tomllib.loads(scene_text()).items() if key != "mqtt"}


def blocks(page: str, kind: str = "") -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```$", (DOCS / page).read_text(), re.M | re.S)
    return [text for its_kind, text in found if its_kind == kind]


def test_the_tables_of_the_pages_are_tables_of_a_scene(tmp_path: Path) -> None:
    limits, mqtt, credentials, queue, udp = (*blocks("mqtt.md", "toml"), *blocks("udp.md", "toml"))
    told = (REST | tomllib.loads(text) for text in (limits, mqtt + queue + udp))
    bare, scene = (from_tree(tree, tmp_path / "scene.toml") for tree in told)
    assert bare.mqtt.broker is None
    assert len(scene.udp) == 3
    assert scene.mqtt.queue.policy == "drop-oldest"
    assert [scene.mqtt.queue.limit(qos) for qos in (0, 1)] == [2000, 2000]
    assert [MqttQueueKeys().limit(qos) for qos in (0, 1)] == [0, 10_000]
    (tmp_path / "credentials.toml").write_text(credentials)
    assert scene.mqtt.broker is not None
    address = broker_address(scene, scene.mqtt.broker)
    assert str(address) == "mqtts://broker.example:8883"
    assert address.access.username == "plotfeed"
    assert address.access.ca_file == tmp_path / "ca.pem"
    assert address.versions == VERSIONS["any"]


def test_the_settings_for_mosquitto_are_settings_of_mosquitto(tmp_path: Path) -> None:
    (text,) = (block for block in blocks("mqtt.md") if "listener 8883" in block)
    secured, browsers = free_port(), free_port()
    keys = Certificates(tmp_path)
    for written, here in {
        "listener 8883": f"listener {secured} 127.0.0.1",
        "listener 9001": f"listener {browsers} 127.0.0.1",
        "/etc/mosquitto/passwords": password_file(tmp_path, "plotfeed", "x"),
        "/etc/mosquitto/broker.pem": keys.broker.certificate,
        "/etc/mosquitto/broker.key": keys.broker.key,
        "/etc/mosquitto/ca.pem": keys.ca,
    }.items():
        assert written in text
        text = text.replace(written, str(here))
    with mosquitto(tmp_path, secured, text, per_listener=False):
        wait_until_listening(browsers)


# Whole commands, through a broker that asks for a certificate and a password.


def keys_in(folder: Path, brokers: Brokers, **changes: object) -> Path:
    """A file of credentials that holds all but what is None."""
    ours = brokers.certificates
    keys = {
        "username": ME,
        "password": PASSWORD,
        "ca_file": ours.ca,
        "client_certificate_file": ours.client.certificate,
        "client_key_file": ours.client.key,
    }
    text = "".join(f'{key} = "{value}"\n' for key, value in (keys | changes).items() if value)
    (folder / "keys.toml").write_text(text)
    return folder / "keys.toml"


def scene_with_keys(folder: Path, brokers: Brokers, name: str, more: str) -> Path:
    """A scene that names its files relative to itself, as they lie beside it."""
    ours = brokers.certificates
    files = {
        "ca_file": ours.ca,
        "client_certificate_file": ours.client.certificate,
        "client_key_file": ours.client.key,
        "credentials_file": keys_in(folder, brokers, **dict.fromkeys(("ca_file", *CLIENT))),
    }
    beside = "".join(f'{key} = "{os.path.relpath(file, folder)}"\n' for key, file in files.items())
    mqtt = f'broker = "{brokers.address("both")}"\nprefix = "{name}"\n{beside}{more}\n'
    return scene_file(folder, scene_text(sensors=radar(period_s=0.2, sectors=8), mqtt=mqtt))


CLIENT = ("client_certificate_file", "client_key_file")


@pytest.mark.parametrize(("version", "properties"), [("5", True), ("3.1.1", False)])
def test_a_session_publishes_through_tls(
    brokers: Brokers, tmp_path: Path, version: str, properties: bool
) -> None:
    prefix, url = f"a/session/of/{version}", brokers.address("both")
    scene = scene_with_keys(tmp_path, brokers, prefix, f'version = "{version}"')
    with (
        MqttReceiver(brokers.ports["anyone"], 5, f"{prefix}/#") as ears,
        running("run", scene) as session,
    ):
        batch = ears.wait_for(lambda m: m.topic == f"{prefix}/radar/plots")
        status = ears.wait_for(lambda m: m.topic == f"{prefix}/radar/status")
        assert f"  MQTT        {url}" in session.introduction
        words = ("show", f"{url}/{prefix}/#", "--count", "3", "--credentials")
        shown = plotfeed(*words, keys_in(tmp_path, brokers))
        assert (len(shown.stdout.splitlines()), shown.stderr) == (3, "")
        session.process.kill()  # its last will says it, then
        ears.wait_for(lambda m: m.topic == status.topic and b"OFFLINE" in m.payload)
        truth = ears.wait_for(lambda m: m.topic == f"{prefix}/truth")
    assert (batch.qos, truth.qos, status.qos) == (0, 0, 1)
    assert pb.PlotBatch.FromString(batch.payload).sensor == "radar"
    assert json.loads(status.payload)["state"] == "ONLINE"
    assert bool(batch.user_properties) == properties == (batch.content_type is not None)


def test_a_command_that_is_not_let_in_says_so_in_a_line_without_secrets(
    brokers: Brokers, tmp_path: Path
) -> None:
    url, wrong = brokers.address("both"), "open barley"
    done = plotfeed("show", url, "--credentials", keys_in(tmp_path, brokers, password=wrong))
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1)
    assert done.stderr.startswith(f"plotfeed: MQTT broker {url}: it refuses: not authori")
    assert wrong not in done.stderr
    scene = scene_with_keys(tmp_path, brokers, "refused", "")
    scene.write_text(scene.read_text().replace("keys.toml", "absent.toml"))
    done = plotfeed_here("run", scene)
    assert done.returncode == 2
    assert done.stderr.endswith("absent.toml: No such file or directory\n")
