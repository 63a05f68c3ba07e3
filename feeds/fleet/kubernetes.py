"""Manifests with which Kubernetes runs the parts of a fleet."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from string import Template

from plotfeed.feeds.transport.mqtt.address import BrokerAddress


def manifests(
    scene: Path, *, parts: int, spares: int, start: str, broker: str, duration_s: float | None
) -> str:
    """YAML: a StatefulSet of a pod a part, one more for each spare, and who may reach whom.

    Raises `AddressError` where `broker` is none.
    """
    words = ["run", "/scene/scene.toml", "--part", f"$(PART)/{parts}", "--start", start]
    words += ["--broker", broker, "--wait"]
    words += [] if duration_s is None else ["--duration", f"{duration_s:g}"]
    port = BrokerAddress.parse(broker).port
    text = files("plotfeed.feeds.fleet").joinpath("part.yaml").read_text(encoding="utf-8")
    head, policy, stateful_set = text.split("---\n")
    names = ["plotfeed-part", *(f"plotfeed-spare-{n}" for n in range(1, spares + 1))]
    asked = {"parts": parts, "scene": scene, "broker": broker, "port": port}
    asked["arguments"] = json.dumps(words)
    once = [Template(each).substitute(asked) for each in (head, policy)]
    found = [Template(stateful_set).substitute(asked, name=name) for name in names]
    return "---\n".join([*once, *found])
