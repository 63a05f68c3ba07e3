"""Manifests with which Kubernetes runs the parts of a fleet."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from string import Template


def manifests(
    scene: Path, *, parts: int, spares: int, start: str, broker: str, duration_s: float | None
) -> str:
    """YAML: a StatefulSet of a pod a part, and one more of pods that stand by for each spare."""
    words = ["run", "/scene/scene.toml", "--part", f"$(PART)/{parts}", "--start", start]
    words += ["--broker", broker, "--wait"]
    words += [] if duration_s is None else ["--duration", f"{duration_s:g}"]
    text = files("plotfeed.feeds.fleet").joinpath("part.yaml").read_text(encoding="utf-8")
    head, line, stateful_set = text.partition("---\n")
    names = ["plotfeed-part", *(f"plotfeed-spare-{n}" for n in range(1, spares + 1))]
    asked = {"parts": parts, "scene": scene, "broker": broker, "arguments": json.dumps(words)}
    found = [Template(line + stateful_set).substitute(asked, name=name) for name in names]
    return Template(head).substitute(asked) + "".join(found)
