"""Where a broker is, as people write it, and what opens its door; no scene holds secrets."""

from __future__ import annotations

import os
import ssl
import tomllib
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from urllib.parse import urlsplit

from plotfeed.feeds.console.printed import bracketed
from plotfeed.proto.errors import PlotfeedError

USERNAME_VARIABLE = "PLOTFEED_MQTT_USERNAME"
PASSWORD_VARIABLE = "PLOTFEED_MQTT_PASSWORD"  # noqa: S105 - its name, not its value  # nosec B105
MAX_OCTETS = 65_535  # Of a text in MQTT
MAX_FILE_OCTETS = 1 << 16
# What a file of credentials may hold: the names that they have in [mqtt] of a scene.
CREDENTIALS = {
    "username",
    "password",
    "ca_file",
    "client_certificate_file",
    "client_key_file",
    "version",
}
# MQTT by its own names; 4 is how 3.1.1 is numbered in the protocol.
VERSIONS = {"5": (5,), "3.1.1": (4,), "any": (5, 4)}


class AccessError(PlotfeedError):
    """Certificates or credentials that cannot be used."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerAccess:
    """Certificates, credentials and the version of MQTT; the password is never shown."""

    ca_file: Path | None = None  # Who vouches for the broker; without it, whom the system trusts
    certificate_file: Path | None = None
    key_file: Path | None = None  # Of the client, where the broker asks for one
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    version: str | None = None  # Of VERSIONS; without it, any

    def tls_context(self) -> ssl.SSLContext:
        """Settings for a connection with TLS; raises `AccessError`."""
        return _tls_context(self.ca_file, self.certificate_file, self.key_file)

    def with_credentials(self, file: Path | None) -> BrokerAccess:
        """Access with what a file of credentials holds beside what is stated already.

        User name and password of the environment stand before those of the file. Raises
        `AccessError`.
        """
        found = {} if file is None else _credentials(file)
        username = os.environ.get(USERNAME_VARIABLE, found.get("username"))
        password = os.environ.get(PASSWORD_VARIABLE, found.get("password"))
        if password is not None and username is None:
            raise AccessError(f"{PASSWORD_VARIABLE} is set, and there is no {USERNAME_VARIABLE}")
        for what, text in (("user name", username), ("password", password)):
            if text is not None and not _fits(text):
                raise AccessError(f"the {what} for MQTT is not UTF-8, or too long")
        folder = Path() if file is None else file.parent
        return BrokerAccess(
            ca_file=self.ca_file or _beside(folder, found.get("ca_file")),
            certificate_file=self.certificate_file
            or _beside(folder, found.get("client_certificate_file")),
            key_file=self.key_file or _beside(folder, found.get("client_key_file")),
            username=username,
            password=password,
            version=self.version or found.get("version"),
        )


def _fits(text: str) -> bool:
    try:
        return len(text.encode()) <= MAX_OCTETS
    except UnicodeEncodeError:
        return False


def _beside(folder: Path, name: str | None) -> Path | None:
    """The file of that name, relative to the folder of the file that names it."""
    return None if name is None else folder / name


def _credentials(file: Path) -> dict[str, str]:
    # What TOML says of a mistake is not passed on: it might quote the password.
    expected = AccessError(
        f"{file}: expected TOML with username and password, or any of ca_file, "
        "client_certificate_file, client_key_file and version, all text"
    )
    try:
        with file.open("rb") as opened:
            found = tomllib.loads(opened.read(MAX_FILE_OCTETS).decode("utf-8-sig"))
    except OSError as error:
        raise AccessError(f"{file}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise expected from None
    is_known = found.keys() <= CREDENTIALS and all(isinstance(x, str) for x in found.values())
    if not found or not is_known or ("password" in found and "username" not in found):
        raise expected
    if found.get("version", "any") not in VERSIONS:
        raise AccessError(f"{file}: version: expected one of {', '.join(VERSIONS)}, as text")
    return found


@lru_cache(maxsize=16)  # a session has a link for each sensor, and the system's CAs are many
def _tls_context(ca: Path | None, certificate: Path | None, key: Path | None) -> ssl.SSLContext:
    try:
        context = ssl.create_default_context(cafile=ca)
    except OSError as error:
        why = "no certificate in it" if isinstance(error, ssl.SSLError) else error.strerror
        raise AccessError(f"CA file {ca}: {why}") from None
    if certificate is None:
        if key is not None:
            raise AccessError(f"client key {key}: expected its certificate too")
        return context
    if key is not None and not key.is_file():  # else OpenSSL does not say which of the two
        raise AccessError(f"client key {key}: no such file")
    try:
        # There is nobody to ask for a passphrase.
        context.load_cert_chain(certificate, key, lambda: "")
    except OSError as error:
        raise AccessError(
            f"client certificate {certificate}, key {key or 'in it'}: {_why(error)}"
        ) from None
    return context


def _why(error: OSError) -> str:
    if not isinstance(error, ssl.SSLError):
        return error.strerror or str(error)
    if error.reason == "KEY_VALUES_MISMATCH":
        return "the key is of another certificate"
    return "not both PEM, or the key has a passphrase"


DEFAULT_PORTS = {"mqtt": 1883, "mqtts": 8883}
NO_ACCESS = BrokerAccess()


class AddressError(PlotfeedError):
    """What should be the address of a broker, and is not."""


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """Where a broker is, and which versions of MQTT to try, one after the other."""

    host: str
    port: int = DEFAULT_PORTS["mqtt"]
    versions: tuple[int, ...] = VERSIONS["any"]
    tls: bool = False
    access: BrokerAccess = NO_ACCESS
    # Whether it is the embedded one: nobody is left to be told when its session dies.
    ends_with_us: bool = False
    waits: bool = False  # Whether it is waited for until it is up

    @property
    def destination(self) -> str:
        """What counts and ledger call it: MQTT, with its version where it is spoken to in one."""
        names = [name for name, versions in VERSIONS.items() if versions == self.versions]
        return "MQTT" if len(self.versions) > 1 or not names else f"MQTT {names[0]}"

    @classmethod
    def parse(
        cls, url: str, *, access: BrokerAccess | None = None, waits: bool = False
    ) -> BrokerAddress:
        """Read mqtt://HOST[:PORT], or mqtts:// for TLS; raises `AddressError`."""
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError:
            raise _no_address(url) from None
        if parts.username is not None:
            raise AddressError(
                "a broker's address holds no credentials: give them as "
                f"{USERNAME_VARIABLE} and {PASSWORD_VARIABLE}, or in a file"
            )
        rest = parts.path.strip("/") + parts.query + parts.fragment
        if parts.scheme not in DEFAULT_PORTS or not parts.hostname or rest or port == 0:
            raise _no_address(url)
        access, tls = access or BrokerAccess(), parts.scheme == "mqtts"
        needs_tls = access.ca_file or access.certificate_file or access.key_file
        if needs_tls and not tls:  # or what was to be kept secret would go in clear
            raise AddressError(
                f"broker {url!r}: a CA, certificate or key is given, and they need mqtts://"
            )
        port = port or DEFAULT_PORTS[parts.scheme]
        versions = VERSIONS[access.version or "any"]
        return cls(parts.hostname, port, versions, tls, access, waits=waits)

    def __str__(self) -> str:
        return f"{'mqtts' if self.tls else 'mqtt'}://{bracketed(self.host)}:{self.port}"


def without_secrets(url: str) -> str:
    """What may be shown of an address in which someone may have put a password."""
    scheme, _, rest = url.partition("?")[0].partition("://")
    return f"{scheme}://...@{rest.rpartition('@')[2]}" if "@" in url else url.partition("?")[0]


def _no_address(url: str) -> AddressError:
    shown = without_secrets(url)
    return AddressError(f"broker {shown!r}: expected mqtt://HOST:PORT, or mqtts:// for TLS")
