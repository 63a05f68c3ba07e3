"""Writes docs/asyncapi.json: what `plotfeed schema asyncapi` prints.

python docs/write_asyncapi.py
"""

from __future__ import annotations

from pathlib import Path

from plotfeed.feeds.schema.published import text_of

DOCUMENT = Path(__file__).with_name("asyncapi.json")

if __name__ == "__main__":
    DOCUMENT.write_text(text_of("asyncapi") + "\n")
