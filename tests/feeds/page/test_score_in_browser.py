"""The card of the tracker's score: there for who shows the truth, and for nobody else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from support.chromium import until
from support.made_up_session import MadeUpSession
from support.page_server import Served

if TYPE_CHECKING:
    from playwright.sync_api import Page

FIGURES = {
    "gospa_m": 12.34,
    "ospa_m": 8.7,
    "completeness": 0.75,
    "spuriousness": 0.25,
    "position_error_m": 5.61,
    "latency_s": 0.042,
    "latency_p95_s": None,
}
AZIMUTH = {
    "sensor": "radar-3", "check": "azimuth", "unit": "deg", "claimed": 0.0, "found": 2.013,
    "z": 37.1, "of": 58, "wrong": True, "why_not": "",
}  # fmt: skip


def score(second: int, *feed: dict[str, Any]) -> dict[str, Any]:
    return {
        "time_utc": f"2026-01-01T12:00:{second:02}Z", "cutoff_m": 50.0, "drones": 4, "tracks": 4,
        "reports": 100, "unreadable": 3, "problem": "a track of the future", "now": FIGURES,
        "window_s": second, "window": FIGURES, "feed_false_rate": 0.01, "feed": list(feed),
    }  # fmt: skip


def test_the_score_is_shown_with_the_truth_alone(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    card = page.locator('[data-card="score"]')
    served.call(lambda: stage.view.score(score(1)))
    until(page, "plotfeed.picture.framesTaken > 3")
    assert not card.is_visible()
    page.get_by_role("button", name="Truth").click()
    until(page, "document.getElementById('score-body').checkVisibility()")
    words = card.inner_text()
    for told in ("12.3 m", "75 %", "25 %", "5.6 m", "0.04 s", "3 reports of tracks left out"):
        assert told in words
    assert "nothing to judge yet" in words
    served.call(lambda: stage.view.score(score(2, AZIMUTH)))
    until(
        page, "document.getElementById('score-feed').textContent.includes('radar-3: azimuth 2.01')"
    )
    page.get_by_role("button", name="Truth").click()
    until(page, "document.getElementById('score-body').hidden")
    assert "Shown with the truth" in card.inner_text()
    assert "radar-3" not in card.inner_text()
