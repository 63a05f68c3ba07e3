"""What is published for people and generators: schemas of the scene and of messages, and all flows.

What flows, on which topic and when, is told once here and said on by the AsyncAPI document.
"""

from __future__ import annotations

import json

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.schema.asyncapi import document, messages_schema


def text_of(what: str) -> str:
    """The JSON schema of the "scene", the protobuf schema of the "messages", or "asyncapi"."""
    if what == "messages":
        return messages_schema()
    if what == "asyncapi":
        return json.dumps(document(), indent=2, ensure_ascii=False)
    schema = Scene.model_json_schema()
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    return json.dumps(schema, indent=2)
