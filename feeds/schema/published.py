"""The published schemas: of the scene file, of our messages, and of what flows over MQTT."""

from __future__ import annotations

import json
from importlib.resources import files


def text_of(what: str) -> str:
    """The JSON schema of the "scene", the protobuf schema of the "messages", or "asyncapi"."""
    if what == "messages":
        return files("plotfeed.proto").joinpath("plotfeed.proto").read_text().rstrip()
    if what == "asyncapi":
        from plotfeed.feeds.schema.asyncapi import document

        return json.dumps(document(), indent=2, ensure_ascii=False)
    from plotfeed.feeds.scene.scene import Scene

    schema = Scene.model_json_schema()
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    return json.dumps(schema, indent=2)
