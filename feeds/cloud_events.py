"""CloudEvents 1.0 attributes of messages, which MQTT 5 carries as user properties."""

from __future__ import annotations

from plotfeed.feeds.times import iso_utc


def attributes(
    source: str, kind: str, number: str, t_utc_ns: int, **more: object
) -> tuple[tuple[str, str], ...]:
    """Of a message about that time; `number` tells those of one source and kind apart."""
    return (
        ("specversion", "1.0"),
        ("id", f"{kind.replace('/', '-')}-{number}"),
        ("source", source),
        ("type", f"plotfeed.{kind.replace('/', '.')}"),
        ("time", iso_utc(t_utc_ns)),
        *[(name, str(value)) for name, value in more.items()],
    )
