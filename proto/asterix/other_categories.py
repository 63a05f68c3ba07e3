"""Where records and items end in categories that plotfeed does not write, and whose they are.

Only the lengths of items are known here, their sources and their times of day: enough to cut a
block into records without libasterix, which knows what the items say (`proto.asterix.standard`).
The lengths are those of EUROCONTROL's documents of each category, in the edition that is named.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from plotfeed.proto.asterix.codec.layout import (
    EXPLICIT,
    Category,
    Explicit,
    Item,
    Undecoded,
    item_of,
)

# A category, its edition, and its items by their field reference numbers, - where none is.
#
# NAME:3 has three octets; :s is SAC and SIC, :t a time of day; :x goes on with each octet whose
# last bit is set, :x2.1 after two and then one; :r8 counts by its first octet how often eight
# octets come, :f2 goes on so while the last bit is set; :e begins with its own length, and :(1 x)
# has flags, and behind them the subfields that they name.
_ITEMS = """
001 1.4:
    010:s 020:x 040:4 070:2 090:2 130:f1 141:2 050:2 120:1 131:1 080:2 100:4 060:2 030:f1 150:1 -
    - - - SP:e
001 1.4 tracks:
    010:s 020:x 161:2 040:4 042:4 200:4 070:2 090:2 141:2 130:f1 131:1 120:1 170:x 210:f1 050:2
    080:2 100:4 060:2 030:f1 SP:e - 150:1
002 1.2: 010:s 000:1 020:1 030:t 041:2 050:f1 060:f1 070:r2 100:8 090:2 080:f1 - SP:e
004 1.13: 010:s 000:1 015:r2 020:t 040:2 045:1 060:x 030:2 170:(7 2 10 8 t 2 x 6 4 2) 120:(x 1 1 3)
    070:(t t 3 2 2 2) 076:2 074:2 075:3 100:(6 7 7 7 7 7) 035:2 171:(7 2 10 8 t 2 x 6 4 2) 110:r2
    - RE:e SP:e
008 1.3: 010:s 000:1 020:x 036:r3 034:r4 040:2 050:r2 090:t 100:x3 110:f1 120:2 038:r4 SP:e
009 2.1: 010:s 000:1 020:x 030:r6 060:x 070:t 080:x3 090:r3 100:2
010 1.1: 010:s 000:1 020:x 140:t 041:8 040:4 042:4 200:4 202:4 161:2 170:x 060:2 220:3 245:7 250:r8
    300:1 090:2 091:2 270:x 550:1 310:1 500:4 280:r2 131:1 210:2 - SP:e RE:e
011 1.3:
    010:s 000:1 015:1 140:t 041:8 042:4 202:4 210:2 060:2 245:7 380:(r8 3 - 3 - - - 4 1 - 1) 161:2
    170:x 290:(1 1 1 1 1 2 1 1 1 1 1 1) 430:1 090:2 093:2 092:2 215:2 270:x 390:(2 7 4 1 4 1 4 4 3
    2 2 r4 6 1) 300:1 310:1 500:(2 4 2 2 2 2) 600:3 605:r2 610:r2 SP:e RE:e
017 1.3:
    010:s 012:s 000:1 350:r2 220:3 221:2 140:t 045:6 070:2 050:2 200:4 230:1 240:1 210:r3 360:1 -
    - - - - SP:e
018 1.8: 036:s 037:s 000:1 001:1 005:3 016:4 017:r4 018:1 019:e 028:2 030:2 025:4 027:1 029:7 002:t
    006:r3 007:1 008:x 009:x 010:1 011:7 014:4 015:4 020:4 021:6 022:4 023:7 004:1 031:6 032:2
    033:2 034:2 035:2 012:1 013:1
019 1.3: 010:s 000:1 140:t 550:1 551:1 552:r2 553:x 600:8 610:2 620:1 - - RE:e SP:e
020 1.11: 010:s 020:x 140:t 041:8 042:6 161:2 170:x 070:2 202:4 090:2 100:4 220:3 245:7 110:2 105:2
    210:2 300:1 310:1 500:(6 6 2) 400:r1 250:r8 230:2 260:7 030:f1 055:1 050:2 RE:e SP:e
021 2.7: 010:s 040:x 161:2 015:1 071:t 130:6 131:8 072:t 150:2 151:2 080:3 073:t 074:4 075:t 076:4
    140:2 090:x 210:1 070:2 230:2 145:2 152:2 200:1 155:2 157:2 160:4 165:2 077:t 170:6 020:1
    220:(2 2 2 1) 146:2 148:2 110:(x r15) 016:1 008:1 271:x 132:1 250:r8 260:7 400:1 295:(1 1 1 1
    1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1) - - - - - RE:e SP:e
023 1.3: 010:s 000:1 015:1 070:t 100:x 101:x2.1 200:1 110:x 120:r6 - - - RE:e SP:e
032 1.2: 010:s 015:2 018:s 035:1 020:t 040:2 050:x3 060:2 400:7 410:2 420:1 440:4 450:4 480:2 490:2
    430:4 435:1 460:r2 500:(4 1 3 r4 6 1 7 7) - RE:e
065 1.6: 010:s 000:1 015:1 030:t 020:1 040:1 050:1 - - - - - RE:e SP:e
150 3.0:
    010:2 020:2 030:1 040:2 050:7 060:4 070:4 080:4 090:4 100:1 110:1 120:7 130:3 140:r12 150:r4
    160:r4 170:r3 180:r4 190:2 200:r1 210:2 220:2 230:2 240:r4 250:r2 251:r4 171:r3 151:r6
240 1.3: 010:s 000:1 020:4 030:r1 040:12 041:12 048:2 049:5 050:r4 051:r64 052:r256 140:t RE:e SP:e
247 1.3: 010:s 015:1 140:t 550:r3 - SP:e RE:e
"""
_HEAD = re.compile(r"^(\d{3}) \S+( tracks)?:\s", re.MULTILINE)
_ITEM = re.compile(r"-|(\w+):(\([^)]*\)|\S+)")
# Items that are read, and not only cut.
_READ = {"s": "SAC 8, SIC 8", "t": "TIME 24: 1/128 s modulo 86400", "e": EXPLICIT}


def _parts(form: str) -> str:
    """An item of that length as layouts write it, its octets as integers without a meaning."""
    kind, octets = form[0], form[1:]
    if kind in _READ:
        return _READ[kind]
    if kind == "(":
        each = enumerate(octets[:-1].split(), 1)
        return "; ".join("-" if word == "-" else f"{n} ({_parts(word)})" for n, word in each)
    if kind == "x":
        return " | ".join(f"OCTETS {8 * int(n) - 1}" for n in (octets or "1").split("."))
    if kind in "rf":
        return f"repeated: OCTETS {8 * int(octets) - (kind == 'f')}"
    return f"OCTETS {8 * int(form)}"


def _item(name: str, form: str) -> Item:
    item = item_of(name, _parts(form))
    if form in _READ or isinstance(item, Explicit | Undecoded):
        return item
    return Undecoded(name, item)


def _categories() -> Mapping[int, Category]:
    found: dict[int, Category] = {}
    words = _HEAD.split(_ITEMS)[1:]
    for text, tracks, items in zip(words[::3], words[1::3], words[2::3], strict=True):
        number = int(text)
        uap = tuple(
            _item(f"I{text}/{match[1]}", match[2]) if match[1] else None
            for match in _ITEM.finditer(items)
        )
        found[number] = (
            Category(number, found[number].uap, uap) if tracks else Category(number, uap)
        )
    return found


# By number; their items are octets but for sources and times of day.
OTHER_CATEGORIES = _categories()
