"""Where a broker is: addresses as people write them."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

from plotfeed.feeds.mqtt_access import PASSWORD_VARIABLE, USERNAME_VARIABLE, Access
from plotfeed.proto.errors import PlotfeedError

DEFAULT_PORTS = {"mqtt": 1883, "mqtts": 8883}
NO_ACCESS = Access()
VERSIONS = {"5": (5,), "3.1.1": (4,), "any": (5, 4)}
"""MQTT by its own names; 4 is how 3.1.1 is numbered in the protocol."""


class AddressError(PlotfeedError):
    """What should be the address of a broker, and is not."""


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """Where a broker is, and which versions of MQTT to try, one after the other."""

    host: str
    port: int = DEFAULT_PORTS["mqtt"]
    versions: tuple[int, ...] = VERSIONS["any"]
    tls: bool = False
    access: Access = NO_ACCESS

    @classmethod
    def parse(
        cls, url: str, *, versions: tuple[int, ...] = VERSIONS["any"], access: Access | None = None
    ) -> BrokerAddress:
        """From mqtt://HOST[:PORT], or mqtts:// for TLS; raises `AddressError`."""
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
        access, tls = access or Access(), parts.scheme == "mqtts"
        if access.needs_tls and not tls:  # or what was to be kept secret would go in clear
            raise AddressError(
                f"broker {url!r}: a CA, certificate or key is given, and they need mqtts://"
            )
        return cls(parts.hostname, port or DEFAULT_PORTS[parts.scheme], versions, tls, access)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"


def without_secrets(url: str) -> str:
    """What may be shown of an address in which someone may have put a password."""
    scheme, _, rest = url.partition("?")[0].partition("://")
    return f"{scheme}://...@{rest.rpartition('@')[2]}" if "@" in url else url.partition("?")[0]


def _no_address(url: str) -> AddressError:
    shown = without_secrets(url)
    return AddressError(f"broker {shown!r}: expected mqtt://HOST:PORT, or mqtts:// for TLS")
