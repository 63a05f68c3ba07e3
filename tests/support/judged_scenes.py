"""Random scenes in simulated time, and what the report says of each."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from support.ledgers import record_session, told
from support.random_scenes import SECONDS, written_scene

from plotfeed.feeds.scene.scene import load
from plotfeed.models.residuals import Check

LINKS = "links"
OF_LINKS = {"delay", "loss", "duplicates", "flipped bits", "order", "bursts of losses"}
NOT_OF_ERRORS = {"false alarms", "missed scans", "time", "plots"}


@dataclass(frozen=True)
class JudgedScene:
    """What the report says of one of them."""

    seed: int
    figures: list[Check]  # That chance decides
    kinds: dict[str, str]  # Of sensors, by id
    plots: Counter[str]  # Of drones, found in what sensors handed to their links, by kind of sensor
    wrong: list[str]
    notes: list[str]
    not_compared: int  # Of the plots
    lost: int  # Plots of the ledger that were not found, though a format that has them was recorded

    def judged(self) -> Counter[tuple[str, str]]:
        """Figures by kind of sensor and by what they are of."""
        return Counter((self.kinds.get(f.sensor, LINKS), _subject(f)) for f in self.figures)


def _subject(figure: Check) -> str:
    if figure.name in OF_LINKS:
        return LINKS
    if figure.name.startswith("Pd"):
        return "detection"
    return figure.name if figure.name in NOT_OF_ERRORS else "errors"


def judged_scene(seed: int, folder: Path) -> JudgedScene:
    """Run and report the random scene of that seed."""
    path = written_scene(seed, folder)
    record = record_session(path, folder / f"{seed}.mcap", SECONDS)
    found = told(record)
    record.unlink()
    kinds = {sensor.id: sensor.type_name() for sensor in load(path).sensor}
    with_plots = [sensor for sensor in found.sensors if sensor.plots_from]
    plots: Counter[str] = Counter()
    for sensor in with_plots:
        plots[kinds[sensor.sensor]] += sensor.joined - sensor.not_compared
    return JudgedScene(
        seed,
        [c for c in found.verdicts.checks if 0 < c.p < 1],
        kinds,
        plots,
        [
            f"{c.sensor} ({kinds.get(c.sensor, '-')}) {c.name}: {c.found:.4g} of {c.expected:.4g}"
            for c in found.verdicts.wrong
        ],
        list(found.notes),
        sum(sensor.not_compared for sensor in with_plots),
        sum(sensor.plots - sensor.joined for sensor in with_plots),
    )
