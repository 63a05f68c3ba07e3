"""A chart in words: the table on the terminal, and the sentence with which it ends.

Everything is made from the values that `as_values` gives, so that JSON has what the table has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from plotfeed.feeds.accuracy_chart.whole import LITTLE

Values = Mapping[str, Any]

WORDS = {
    "range_m": "{} m",
    "bistatic_range_m": "{} m of path",
    "azimuth_deg": "{}° az",
    "elevation_deg": "{}° el",
    "pd": "Pd {}",
    "false_alarms": "{} alarms",
}
NEGLIGIBLE = 1e-12
"""Less than that is rounding."""


def lines(chart: Values) -> Iterator[str]:
    """The whole table."""
    turns = chart["rounds"]
    yield (
        f"{chart['scene']}: {chart['targets']:,} targets at once; "
        f"ns a target-scan, median (middle half) of {turns} turns"
    )
    yield "> what the scene has, * on the front: none is both cheaper and better"
    for sensor in chart["sensors"]:
        yield from _sensor_lines(sensor)
    for name in chart["unseen"]:
        yield f"\n{name}: left out, for it hardly ever detects a drone of the scene"
    yield ""
    yield from (verdict(sensor) for sensor in chart["sensors"])


def verdict(sensor: Values) -> str:
    """The cheapest configuration that adds little, and what it saves."""
    scene, cheapest = (sensor["configurations"][name] for name in ("scene", "cheapest"))
    if cheapest is None:
        return (
            f"{sensor['id']}: no configuration adds less than {LITTLE:g} of the sensor's own error."
        )
    changed = [
        f"{method} in place of {scene['methods'][stage]}"
        for stage, method in cheapest["methods"].items()
        if method != scene["methods"][stage]
    ]
    head = (
        f"{sensor['id']}: the cheapest configuration that adds less than {LITTLE:g} of the "
        f"sensor's own error"
    )
    if not changed:
        return f"{head} is what the scene has, {ns_text(scene['ns'])} ns a target-scan."
    saved = 1 - cheapest["ns"] / scene["ns"]
    much = f"{saved:.0%} less" if saved >= 0 else f"{-saved:.0%} more"
    return (
        f"{head} takes {ns_text(cheapest['ns'])} ns a target-scan, {much} than the scene's "
        f"{ns_text(scene['ns'])}, and adds {share_text(cheapest['share'])} "
        f"(the scene's: {share_text(scene['share'])}): {'; '.join(changed)}."
    )


def errors_text(errors: Mapping[str, float]) -> str:
    """Such as: 16 m, 0.15° az, Pd 0.008; what is only rounding is not told."""
    told = {name: error for name, error in errors.items() if error > NEGLIGIBLE}
    return (
        ", ".join(WORDS.get(name, "{}").format(f"{e:.2g}") for name, e in told.items())
        or "no error"
    )


def share_text(share: float | None) -> str:
    """Of the sensor's own error."""
    if share is None:
        return "all"
    if share >= 100:
        return f"{share:,.0f}"
    return f"{share:.2g}" if share > NEGLIGIBLE else "0"


def ns_text(ns: float) -> str:
    """Three figures."""
    return f"{ns:,.0f}" if ns >= 100 else f"{ns:.3g}"


def _sensor_lines(sensor: Values) -> Iterator[str]:
    own = sensor["own"]
    yield f"\n{sensor['id']} ({sensor['type']}), its own error, rms: {errors_text(own)}"
    yield f"  {'':14}  {'':32}{'ns':>10}  {'':24}{'of its own':>10}  error added"
    for stage in sensor["stages"]:
        for i, method in enumerate(stage["methods"]):
            yield _method_line("" if i else stage["stage"], method)
    costs = "  ".join(f"{b['targets']:,}: {ns_text(b['ns']['median'])}" for b in sensor["batches"])
    yield f"  {'targets at once':14} {costs}"
    for name in ("scene", "cheapest"):
        found = sensor["configurations"][name]
        if found is not None:
            yield (
                f"  {name:14}  {'all stages together':32}{ns_text(found['ns']):>10}  {'':24}"
                f"{share_text(found['share']):>10}  {errors_text(found['errors'])}"
            )


def _method_line(stage: str, method: Values) -> str:
    mark = f"{'>' if method['ours'] else ' '}{'*' if method['on_front'] else ' '}"
    ns = method["ns"]
    spread = f"({ns_text(ns['low'])} to {ns_text(ns['high'])})"
    return (
        f"  {stage:14}{mark}{method['method']:32}{ns_text(ns['median']):>10}  {spread:24}"
        f"{share_text(method['share']):>10}  {errors_text(method['errors'])}"
    )
