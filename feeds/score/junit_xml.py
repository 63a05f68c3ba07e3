"""A score as JUnit's XML, which services for continuous integration read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, tostring  # nosec B405

from plotfeed.feeds.score.score_figures import Score
from plotfeed.feeds.score.score_profiles import LimitVerdict
from plotfeed.proto.utc import NS

FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What no XML 1.0 document may hold, escaped or not."""


def junit_of(score: Score, profile: str, verdicts: Sequence[LimitVerdict]) -> bytes:
    """A suite with a case for the tracker and one for each limit.

    A limit that is broken is a failure, a tracker that failed an error, and what cannot be tested
    is skipped. Its time is that of the run.
    """
    failed = sum(each.status == "failed" for each in verdicts)
    skipped = sum(each.status == "not testable" for each in verdicts)
    counts = {
        "tests": str(len(verdicts) + 1),
        "failures": str(failed),
        "errors": str(int(bool(score.failure))),
        "skipped": str(skipped),
        "time": f"{(score.end_utc_ns - score.start_utc_ns) / NS:.3f}",
    }
    suites = Element("testsuites", counts)
    suite = SubElement(suites, "testsuite", {"name": clean(f"plotfeed score {profile}"), **counts})
    place = clean(f"plotfeed.score.{profile}")
    tracker = SubElement(suite, "testcase", classname=place, name="tracker", time="0")
    if score.failure:
        SubElement(tracker, "error", message=clean(score.failure), type="tracker")
    for each in verdicts:
        case = SubElement(suite, "testcase", classname=place, name=clean(each.name), time="0")
        if each.status == "failed":
            SubElement(case, "failure", message=clean(each.told), type="limit")
        elif each.status == "not testable":
            SubElement(case, "skipped", message=clean(each.told))
    text: bytes = tostring(suites, "utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + text + b"\n"


def clean(text: str) -> str:
    """Text without what XML may not hold."""
    return FORBIDDEN.sub("", text)
