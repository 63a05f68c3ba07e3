"""Writes the table of docs/feed-checks.md: how often each planted fault is seen, and has its name.

python docs/commands/write_feed_checks.py

The radars of examples/scenes/feed-faults.toml, a hundred of each with draws of their own, in
simulated time; a minute and a half of processor time.
"""

from __future__ import annotations

from pathlib import Path

from pages import between, table

from plotfeed.feeds.report.spreads import share_interval
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.score.feed_checks import FALSE_RATE, simulated_feed
from plotfeed.feeds.score.feed_residuals import feed_checks
from plotfeed.feeds.sensing.simulation import simulate
from plotfeed.models.scoring.residuals import judged_wrong

DOCS = Path(__file__).parents[1]
SCENE = DOCS.parent / "examples" / "scenes" / "feed-faults.toml"
START_UTC_NS = 1_767_268_800 * 10**9
SEEDS, CLEAN = 100, 1000
SECONDS = (15.0, 30.0, 60.0)
TITLES = {
    "askew": ("azimuth 2° off", {"azimuth"}),
    "late": ("stamped 1 s late", {"time"}),
    "blind": ("Pd × 0.6", {"Pd"}),
    "cluttered": ("false alarms × 4", {"false alarms"}),
    "lying": ("errors × 2.5", {"range spread", "azimuth spread", "elevation spread"}),
}


def called_wrong(scene: Scene, name: str, copies: int, seconds: float) -> list[set[str]]:
    """The checks that each of so many equal radars fails."""
    sensor = next(s for s in scene.sensor if s.id == name)
    many = tuple(sensor.model_copy(update={"id": f"{name}-{i}"}) for i in range(copies))
    made = scene.model_copy(update={"sensor": many})
    found = []
    for seen in simulate(made, seconds, start_utc_ns=START_UTC_NS).values():
        checks = feed_checks(simulated_feed(made, seen))
        wrong = judged_wrong(checks, FALSE_RATE)
        found.append({c.name for c, is_wrong in zip(checks, wrong, strict=True) if is_wrong})
    return found


def main() -> None:
    """Count, and write."""
    scene, rows = load(SCENE), []
    for name, (title, names) in TITLES.items():
        cells = []
        for seconds in SECONDS:
            found = called_wrong(scene, name, SEEDS, seconds)
            named = sum(bool(names & each) for each in found)
            alone = sum(bool(each) and each <= names for each in found)
            cells.append(f"{named} ({alone})")
            print(name, seconds, cells[-1], flush=True)
        rows.append((title, ", ".join(sorted(names)), *cells))
    clean = []
    for seconds in SECONDS:
        failed = sum(map(bool, called_wrong(scene, "clean", CLEAN, seconds)))
        low, high = share_interval(failed, CLEAN)
        clean.append(f"{failed} of {CLEAN} ({100 * low:.1f}-{100 * high:.1f} %)")
        print("clean", seconds, clean[-1], flush=True)
    rows.append(("none", "none", *clean))
    head = ("fault", "named", *(f">{seconds:g} s" for seconds in SECONDS))
    between(DOCS / "feed-checks.md", "rates", "\n".join(table(head, rows)))


if __name__ == "__main__":
    main()
