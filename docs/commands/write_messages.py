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
[plotfeed.proto](../proto/plotfeed.proto) and [ledger.proto](../proto/ledger.proto), which
`plotfeed schema messages` prints. The unit of a field is the end of its name: `_m` metres, `_deg`
degrees, `_m_s` metres a second, `_db` decibels, `_dbm` decibels over a milliwatt, `_hz` hertz,
`_us` microseconds, `_utc_ns` nanoseconds of UTC
since 1970. Azimuth is clockwise from true north, elevation above the sensor's horizontal. An
optional field that is absent was not measured or is not known; zero is a value. JSON is
protobuf's own mapping, with these names.
"""
FIELD = re.compile(
    r"^\s+(?:(optional|repeated) )?([\w.]+|map<\w+, \w+>) (\w+) = (\d+);(?:\s*// (.*))?$"
)
VALUE = re.compile(r"^\s+(\w+) = (\d+);(?:\s*// (.*))?$")


def page() -> str:
    """The whole page."""
    lines = [INTRODUCTION]
    comment: list[str] = []
    inside = False
    for line in messages_schema().splitlines():
        if match := re.match(r"^(message|enum) (\w+) {$", line):
            lines += ["", f"## {match[2]}", "", *([" ".join(comment), ""] if comment else [])]
            inside, comment = True, []
        elif line.startswith("//"):
            comment.append(line.removeprefix("//").strip())
        elif line.startswith("}") or not line.strip():
            inside, comment = inside and not line.startswith("}"), []
        elif inside and (match := FIELD.match(line)):
            kind = " ".join(part for part in (match[1], match[2]) if part)
            lines.append(f"{match[4]}. `{match[3]}`, {kind}{(match[5] and f': {match[5]}') or ''}")
        elif inside and (match := VALUE.match(line)):
            lines.append(f"- `{match[1]}` = {match[2]}{(match[3] and f': {match[3]}') or ''}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
