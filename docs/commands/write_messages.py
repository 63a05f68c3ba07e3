"""Writes docs/messages.md: our protobuf messages, field by field, from the schema's own comments.

python docs/commands/write_messages.py
"""

from __future__ import annotations

import re
from pathlib import Path

from plotfeed.feeds.schema.asyncapi import messages_schema

PAGE = Path(__file__).parents[1] / "messages.md"
INTRODUCTION = """# plotfeed's own messages

Written by `python docs/commands/write_messages.py` from
[plotfeed.proto](../proto/plotfeed.proto) and [ledger.proto](../proto/ledger.proto), which have the
number and type of each field and which `plotfeed schema messages` prints. The unit of a field is
the end of its name: `_m_s` metres a second, `_dbm` decibels over a milliwatt, `_utc_ns` nanoseconds
of UTC since 1970. Azimuth is clockwise from true north, elevation above the sensor's horizontal. A
field in *italics* is optional: absent, it was not measured or is not known; zero is a value. JSON
is protobuf's own mapping, with these names. `Ledger` and its `Look`, `PlotTruth` and `Sent`, which
recordings of before hold, say what the columns of `LedgerBatch` say.
"""
# What is said above a message or an enumeration, its name, and what is inside.
BLOCK = re.compile(r"((?:^//.*\n)*)^(?:message|enum) (\w+) {\n((?:.*\n)*?)}", re.MULTILINE)
# A field of a message, or a value of an enumeration.
FIELD = re.compile(
    r"^ +(?:(optional|repeated) )?(?:[\w.]+ |map<.*> )?(\w+) = \d+;(?: *// (.*))?$", re.MULTILINE
)
FORMER = ("Ledger", "Look", "PlotTruth", "Sent")  # Of recordings of before, in other words


def page() -> str:
    """The whole page."""
    lines = [INTRODUCTION]
    first: dict[tuple[str, str], str] = {}  # Which message a field is described in
    for comment, title, inside in BLOCK.findall(messages_schema()):
        if title in FORMER:
            continue
        told: dict[str, list[str]] = {}
        for option, field, text in FIELD.findall(inside):
            if text == "never sent":
                continue
            name = f"*`{field}`*" if option == "optional" else f"`{field}`"
            where = first.setdefault((name, text), title)
            is_new = where == title or not text
            as_there = f"as in [{where}](#{where.lower()})"
            told.setdefault(text if is_new else as_there, []).append(name)
        about = " ".join(comment.replace("//", "").split())
        lines += ["", f"## {title}", "", *([about, ""] if about else [])]
        lines += [f"- {', '.join(names)}{text and f': {text}'}" for text, names in told.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
