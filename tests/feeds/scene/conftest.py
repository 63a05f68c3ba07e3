from __future__ import annotations

import json

import jsonschema
import pytest

from plotfeed.feeds.schema import text_of


@pytest.fixture(scope="session")
def schema() -> jsonschema.Draft202012Validator:
    """That of scenes, which takes seconds to make."""
    tree = json.loads(text_of("scene"))
    jsonschema.Draft202012Validator.check_schema(tree)
    return jsonschema.Draft202012Validator(tree)
