"""What the page shows: told by the session as it happens, told on to browsers as updates.

Everything here is cheap when it is called and worked out once an update, for all sensors together.
Nothing waits, and whatever is kept is bounded.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Any

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.formats import carries_plots
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.page_access import CONCEALS, without_truth
from plotfeed.feeds.page.scene_outline import Basemap, Placements, cover_of, outline
from plotfeed.feeds.page.shown import Drones, PlotStore, ShownTracks
from plotfeed.feeds.page.strips import LinkRecord, Loss, Rates, looks_summary, new_looks
from plotfeed.feeds.page.updates import (
    LAYOUTS,
    MAX_WATCHED,
    SectionKind,
    Update,
    UpdateFlag,
    header,
    news,
)
from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.state import Plots, Texts, TruthState
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from plotfeed.feeds.formats.told_tracks import ToldTrack

MAX_REASON = 300
LAYOUTS_BY_KIND = {str(int(kind)): layout for kind, layout in LAYOUTS.items()}
_NOWHERE = Site(latitude_deg=0.0, longitude_deg=0.0, height_m=0.0)


class View:
    """A session as it is to be seen, whatever scene it runs."""

    def __init__(self) -> None:
        self.basemap: Basemap | None = None
        self.generation = 0  # Of the scene: goes up with each
        self._number = 0
        self._news: dict[str, Any] = {"layouts": LAYOUTS_BY_KIND, "session": {}, "totals": {}}
        self._changed: set[str] = set()
        self._watched: frozenset[str] = frozenset()
        self._details_are_due = False
        self._is_new = True
        self._totals: dict[str, float] = {}
        self._begin(Placements(_NOWHERE, ()), ())

    # What the session tells.

    def scene(self, scene: Scene, basemap: Basemap | None = None) -> None:
        """Another scene begins, or the same one anew: what was seen before is forgotten."""
        self.basemap = basemap
        self.generation += 1
        placements = Placements(scene.scene.site, scene.sensor)
        self._begin(placements, [sensor.id for sensor in scene.sensor])
        self._site = scene.scene.site
        self.tell(
            scene=outline(scene, placements, basemap) | {"afterglow_s": scene.page.afterglow_s},
            generation=self.generation,
            **{key: {} for key in ("settings", "covers", "pointing")},
            **{key: [] for key in ("marks", "stories")},
            undoes="",
            refusal=None,
        )

    def clear(self) -> None:
        """Begin at another time of the scene, as after a leap within a recording."""
        self._begin(self._placements, list(self._sensors))

    def delivered(self, sensor: str, plots: Plots, at_utc_ns: int) -> None:
        """Plots that a broker delivered then; what their link did is not known."""
        if (number := self._sensors.get(sensor)) is not None:
            self._plots.take(number, plots, at_utc_ns)
            self._rates.plots(number, len(plots))

    def settled(self, report: Batch, sent: Sequence[pb.Sent], *, is_counted: bool = True) -> None:
        """Take a sector and what became of its messages: plots leave with the first that has them.

        Of one from before a leap, which is not counted, the plots are there and fade.
        """
        if (number := self._sensors.get(report.sensor)) is None:
            return
        carried_ns = (m.sent_utc_ns for m in sent if m.delivered and carries_plots(m.topic))
        first_utc_ns = min(carried_ns, default=None)
        self._plots.take(number, report.plots, first_utc_ns)
        if not is_counted:
            return
        looks, link = report.looks, self._links[number]
        if len(looks) > 1 and self._merges[number]:  # what merged has one outcome, and odds
            both = np.stack([looks.pd, looks.channel.astype(np.float64)])
            looks = looks.rows(np.unique(both, axis=1, return_index=True)[1])
        self._looks[number].add(looks.range_m, looks.pd, looks.detected)
        if first_utc_ns is not None:
            self._rates.plots(number, len(report.plots))
        for message in sent:
            due_ns, at_ns = message.due_utc_ns, message.sent_utc_ns
            if message.delivered:
                self._rates.sent(at_ns - (message.link_due_utc_ns or due_ns))
                link.sent(due_ns, at_ns, duplicate=message.copy > 0)
            else:
                told_ns, by_chain = due_ns + link.usual_delay_ns, message.fate == pb.LOST
                heappush(self._losses, Loss(told_ns, number, message.number, due_ns, by_chain))

    def truth(
        self,
        now_utc_ns: int,
        state: TruthState,
        names: Sequence[str],
        target_class: Texts | None = None,
    ) -> None:
        """Take where the drones are now, and what each is; ten times a second is enough."""
        self._drones.take(now_utc_ns, state, names, target_class)

    def unseen(self, why: Mapping[str, str]) -> None:
        """Tell which drones of the scene no sensor will see, and why."""
        self._drones.unseen, self._drones.changed = why, True

    def settings(self, sensor: Sensor, since_utc_ns: int) -> None:
        """Show a sensor as it is since then: its keys, its cover, what its link is asked to do.

        Messages that its link was given before are not judged by that. Where more than its link is
        another, detections are counted anew.
        """
        if (number := self._sensors.get(sensor.id)) is None:
            return
        before, self.in_force[sensor.id] = self.in_force.get(sensor.id), sensor
        keys = sensor.model_dump(mode="json", exclude_unset=True, exclude={"event", "scan"})
        self.tell(settings={**self._news["settings"], sensor.id: keys})
        covers = {**self._news["covers"], sensor.id: cover_of(sensor, self._site)}
        if covers != self._news["covers"]:
            self.tell(covers=covers)
        self._links[number].begin(sensor.link or LinkSettings(), since_utc_ns)
        self._merges[number] = keys.get("merging") is not None
        link = {"link", "event"}
        if before is None or before.model_dump(exclude=link) != sensor.model_dump(exclude=link):
            self._looks[number] = new_looks(float(self._placements.range_max_m[number]))

    def pointing(self, pointing: Mapping[str, Mapping[str, Any]]) -> None:
        """Where mounts and steered beams pointed in their last scans, by sensor."""
        if pointing != self._news["pointing"]:
            self.tell(pointing=dict(pointing))

    def session(self, state: Mapping[str, Any]) -> None:
        """Clock, recording, replay, and what there is to choose from; keys replace earlier ones.

        `clock`: kind, paused, speed. `refuses`: why controls do not work, by name (pause, step,
        speed, restart, record, scene, replay, sensor). `record`: on, file, seconds. `replay`: file,
        position_s, duration_s, paused; empty if none runs. `scenes`, `recordings`: names to choose
        from. `notes`: sentences on what is shown.
        """
        before = self._news["session"]
        if any(before.get(key) != value for key, value in state.items()):
            self.tell(session={**before, **state})

    def tell(self, **news: Any) -> None:
        """News by their keys, each in place of what was told by it before.

        `marks`: what has changed lately, `t_utc_ms`, `kind` (story, change or script) and `words`.
        `stories`: what can happen at a word, and since when; `undoes`: what undo would undo.
        `refusal`: why telemetry was refused. `track_problem`: why what the tracker published
        could not be read. `connect`: where and how to receive what the session sends. `fleet`: how
        the parts do whose page this is. `audience`, `actions`: what the audience may see and do,
        and who did what.
        """
        self._news |= news
        self._changed |= news.keys()

    def totals(self, totals: SessionCounters) -> None:
        """Counts of the whole session; told on once a second."""
        self._totals = {
            name: getattr(totals, name)
            for name in totals.__slots__
            if isinstance(getattr(totals, name), int | float)
        }

    def tracks(self, tracks: Sequence[ToldTrack]) -> None:
        """News of the tracker under test."""
        self._tracks.take(tracks)

    def score(self, score: dict[str, Any]) -> None:
        """How the tracker and the feed do, for who sees the truth."""
        self._score = self._new_score = {"score": score}

    # What the server asks.

    def watch(self, sensors: Iterable[str]) -> None:
        """Work out the details of these sensors, at most `MAX_WATCHED`, with the next update."""
        known = sorted(s for s in set(sensors) if s in self._sensors)[:MAX_WATCHED]
        if frozenset(known) != self._watched:
            self._watched = frozenset(known)
            self._details_are_due = True

    def update(self, now_utc_ns: int, monotonic_s: float) -> Update:
        """What has changed since the last one."""
        self._number += 1
        # Losses count when they would have been heard of, had they been deliveries.
        while self._losses and self._losses[0].told_utc_ns <= now_utc_ns:
            loss = heappop(self._losses)
            self._rates.lost()
            self._links[loss.sensor].lost(loss.number, loss.due_utc_ns, by_chain=loss.by_chain)
        seconds = self._rates.over(monotonic_s, now_utc_ns)
        if seconds:
            self.tell(totals=self._totals)
        if seconds or self._details_are_due:
            self._details_are_due = False
            watched = {name: self._sensors[name] for name in self._watched & self._sensors.keys()}
            details = {
                sensor: {
                    "link": self._links[number].summary(),
                    "detections": looks_summary(self._looks[number]),
                }
                for sensor, number in watched.items()
            }
            self.tell(details=details)
        public_plots, true_plots = self._plots.sections(now_utc_ns)
        public_tracks = self._tracks.news(now_utc_ns)
        if (names := self._tracks.names()) != self._news.get("track_names", {}):
            self.tell(track_names=names)
        if self._is_new:
            self._is_new = False
            self._changed.clear()
            return self.snapshot(now_utc_ns)
        told = {key: self._news[key] for key in sorted(self._changed)}
        self._changed.clear()
        if seconds:
            told["seconds"] = seconds
        true_news = {**(self._drones.news() if self._drones.changed else {}), **self._new_score}
        self._drones.changed, self._new_score = False, {}
        return self._made(now_utc_ns, told, public_plots + public_tracks, true_news, true_plots)

    def snapshot(self, now_utc_ns: int) -> Update:
        """An update of all that there is to see, for who comes or has missed something."""
        plots, true_plots = self._plots.kept()
        told = {**self._news, "seconds": list(self._rates.history)}
        true_news = {**self._drones.news(), **self._score}
        marks = plots + self._tracks.snapshot()
        return self._made(now_utc_ns, told, marks, true_news, true_plots, flags=UpdateFlag.SNAPSHOT)

    def _made(
        self,
        now_utc_ns: int,
        told: Mapping[str, Any],
        marks: bytes,
        true_news: Mapping[str, Any],
        true_plots: bytes,
        *,
        flags: UpdateFlag = UpdateFlag(0),  # noqa: B008 - it does not change
    ) -> Update:
        """An update of news and marks, for everybody and for who sees the truth."""
        head = header(self._number, now_utc_ns, flags)
        truth = _news(true_news, SectionKind.TRUE_NEWS) + true_plots + self._drones.section()
        audience = None
        if CONCEALS & told.keys():
            audience = head + _news(without_truth(told)) + marks
        return Update(head + _news(told) + marks, truth, bool(flags), audience)

    def _begin(self, placements: Placements, sensors: Sequence[str]) -> None:
        self._placements = placements
        self._sensors = {sensor: number for number, sensor in enumerate(sensors)}
        self._plots = PlotStore(placements)
        self._rates = Rates(len(sensors))
        self._links = [LinkRecord() for _ in sensors]
        self._losses: list[Loss] = []
        self._merges = [False] * len(sensors)
        self.in_force: dict[str, Sensor] = {}  # By id, as `settings` was told last
        self._looks = [new_looks(range_m) for range_m in placements.range_max_m.tolist()]
        self._drones = Drones(placements.site)
        self._tracks = ShownTracks(placements.site)
        self._totals = {}
        self._score = self._new_score = {}
        self._is_new = True


def _news(told: Mapping[str, Any], kind: SectionKind = SectionKind.NEWS) -> bytes:
    if not told:
        return b""
    try:
        text = json.dumps(told, separators=(",", ":"), default=str, allow_nan=False)
    except ValueError:
        text = json.dumps(finite(told), separators=(",", ":"), default=str)
    return news(text.encode(), kind)
