"""What `check` says of who can see the drones of a scene, as JSON and as lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from plotfeed.feeds.engine.visibility import SEEN_PD, Outlook
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors.mount_keys import mount_of

MOST_DRONES = 12  # Told one by one, those first that nobody sees
MOST_SENSORS = 8  # Told one by one of a drone
MOST_SPANS = 3  # Told one by one of a sensor and a drone


def visibility(scene: Scene, outlook: Outlook) -> dict[str, Any]:
    """Who sees each drone that is looked at, from when to when and with what Pd, or why not."""
    names, repeats = outlook.drones, {each.id for each in scene.fleet.drones if each.repeat}
    views = {drone: list(of) for drone, of in groupby(outlook.sightlines(names), lambda v: v.drone)}
    turned = {s.id for s in scene.sensor if (m := mount_of(s)) is not None and m.look_at is None}
    found = []
    for drone in names:
        (from_s, to_s), mine = outlook.span_s(drone), views.get(drone, [])
        hindered = [(v.hindrance, v.sensor) for v in mine if v.hindrance is not None]
        told = {
            "drone": drone,
            "from_s": from_s,
            "to_s": to_s,
            "repeats": drone in repeats,
            "seen_by": [
                {
                    "sensor": v.sensor,
                    "spans_s": v.spans_s,
                    "pd_min": v.pd[0],
                    "pd_max": v.pd[1],
                    "if_turned": v.sensor in turned,
                }
                for v in mine
                if v.hindrance is None
            ],
            "not_seen_by": [
                {"sensor": sensor, "why": hindrance.kind, "text": hindrance.text}
                for hindrance, sensor in sorted(hindered, reverse=True)
            ],
        }
        found.append(told)
    times = outlook.times(len(names))
    return {"pd_at_least": SEEN_PD, "times": times, "of": len(scene.fleet.names), "drones": found}


def visibility_lines(found: dict[str, Any]) -> Iterator[str]:
    """Lines to read of what `visibility` has found."""
    drones, of = found["drones"], found["of"]
    if not drones:
        return
    which = "" if len(drones) == of else f", {len(drones)} of {of} drones"
    yield (
        f"\nwho sees the drones, with a Pd of {found['pd_at_least']:g} or more at some of "
        f"{found['times']} times of each flight{which}:"
    )
    shown = sorted(drones, key=lambda told: bool(told["seen_by"]))[:MOST_DRONES]
    for told in shown:
        again = ", and again" if told["repeats"] else ""
        yield f"  {told['drone']}, from {told['from_s']:.0f} to {told['to_s']:.0f} s{again}:" + (
            "" if told["seen_by"] else " no sensor sees it"
        )
        for view in told["seen_by"][:MOST_SENSORS]:
            spans = [f"{a:.0f} to {b:.0f} s" for a, b in view["spans_s"]]
            more = [f"{len(spans) - MOST_SPANS} more"] if spans[MOST_SPANS:] else []
            pds = dict.fromkeys(f"{view[name]:.2f}" for name in ("pd_min", "pd_max"))
            there = " if it is turned there" * view["if_turned"]
            when = ", ".join(spans[:MOST_SPANS] + more)
            yield f"    {view['sensor']}: {when}, Pd {' to '.join(pds)}{there}"
        if more := told["seen_by"][MOST_SENSORS:]:
            yield f"    and {len(more)} sensors more"
        for view in told["not_seen_by"][:MOST_SENSORS]:
            yield f"    {view['sensor']}: not, {view['why']}: {view['text']}"
        if more := told["not_seen_by"][MOST_SENSORS:]:
            whys = Counter(view["why"] for view in more).most_common()
            yield f"    not {len(more)} more: {', '.join(f'{why} {n}' for why, n in whys)}"
    if more := drones[len(shown) :]:
        yield f"  and {len(more)} more: --json has them"
