"""The published schemas: of the scene file, and of our messages."""

from __future__ import annotations

import json
from importlib.resources import files


def text_of(what: str) -> str:
    """The JSON schema of the "scene", or the protobuf schema of the "messages"."""
    if what == "messages":
        return files("plotfeed.proto").joinpath("plotfeed.proto").read_text().rstrip()
    from plotfeed.feeds.scene import Scene  # noqa: PLC0415 - pydantic is slow to import

    schema = Scene.model_json_schema()
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    return json.dumps(schema, indent=2)
