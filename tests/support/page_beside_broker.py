"""What a page says beside what its broker carries in the same time, and where they differ."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.page.shown import tracks_to_show
from plotfeed.feeds.page.updates import TrackFlag
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import MqttMessage, MqttReceiver

if TYPE_CHECKING:
    from playwright.sync_api import Page

LAG_S = 2.0  # At both ends of the time, in which nothing is expected to have come already
BEHIND_S = 20.0  # A page on a busy machine may show so late what has come; how late it was is told
KEPT_S = 60.0  # A track that is silent for longer is gone
PLOTS = ("/plots", "/048", "/015", "/205")  # How topics end that have any
Told = dict[int, list[tuple[float, int, float]]]
LISTEN = """() => {
  const { feed, reader } = plotfeed, take = feed.onFrame;
  globalThis.said = { plots: [] };
  feed.onFrame = (buffer) => {
    take(buffer);
    const frame = reader.read(buffer), { news } = plotfeed.picture;
    for (const { kind, rows, columns } of frame.sections) {
      if (kind !== 2) continue;
      const { sensors } = news.scene, { sensor, t_utc_ms: times } = columns;
      for (let i = 0; i < rows; i++) said.plots.push([sensors[sensor[i]].id, times[i]]);
    }
  };
}"""
# In a frame of the screen that has just been drawn: words that stand there since before the last
# update tell of what was known then.
SAMPLE = """async () => {
  const { picture, display } = plotfeed;
  display.redraw();
  await new Promise(requestAnimationFrame);
  const now = picture.nowMs(performance.now());
  const text = (id) => document.getElementById(id).innerText;
  return {
    now_ms: now,
    tracks: [...picture.tracks.values()].map((t) => [t.id, t.t_utc_ms, t.flags]),
    labels: display.words.map((w) => w[4]).filter((w) => /^T[0-9]/.test(w)),
    score: text("score-text"),
    feed: text("score-feed"),
    late: text("late-text"),
  };
}"""


class Beside:
    """A page that shows a session, and a client of its broker that hears all."""

    def __init__(self, page: Page, client: MqttReceiver, scene: Scene) -> None:
        """From now on both are taken down; the scene's is the broker's prefix."""
        self.page, self.client, self.scene = page, client, scene
        # When the page was asked, by the monotonic clock, and what it said.
        self.samples: list[tuple[float, dict[str, Any]]] = []
        page.evaluate(LISTEN)
        self.began_s = time.monotonic()

    def sample(self) -> dict[str, Any]:
        """Ask the page what it shows now."""
        said: dict[str, Any] = self.page.evaluate(SAMPLE)
        self.samples.append((time.monotonic(), said))
        return said

    def differences(self) -> dict[str, Any]:
        """What was compared by number, and in words all that the page said otherwise."""
        ended_s = time.monotonic()
        self.page.wait_for_timeout(1000 * LAG_S)  # what has come is shown by then
        shown = self.page.evaluate("said.plots")
        heard = list(self.client.heard)
        told = self._tracks_told(heard)
        of_tracks = (_tracks_of_sample(told, at_s, self.began_s, s) for at_s, s in self.samples)
        return {
            "seconds": round(ended_s - self.began_s, 1),
            "plots_shown": len(shown),
            "messages_heard": sum(message.at_s >= self.began_s for message in heard),
            "samples": len(self.samples),
            "tracks_compared": sum(len(sample["tracks"]) for _, sample in self.samples),
            "most_behind_s": self._most_behind_s(told),
            "differences": [*self._plots(shown, heard, ended_s), *chain(*of_tracks)],
        }

    def _plots(
        self, shown: list[tuple[str, float]], heard: list[MqttMessage], ended_s: float
    ) -> Iterator[str]:
        """Plots on the page that did not leave, and those that left and are not on it."""
        page, told = Counter(map(tuple, shown)), Counter[tuple[str, float]]()
        in_time = Counter[tuple[str, float]]()
        for message in heard:
            if message.topic != f"{self.scene.mqtt.prefix}/truth":
                continue
            for entry in entries_in(message.payload):
                if not any(m.delivered and m.topic.endswith(PLOTS) for m in entry.messages):
                    continue
                plots = Counter((entry.sensor, p.time_utc_ns / 1e6) for p in entry.plots)
                told += plots
                if self.began_s + LAG_S < message.at_s < ended_s - LAG_S:
                    in_time += plots
        first_ms = min((at_ms for _, at_ms in in_time), default=0.0)
        for key in (page - told).elements():
            if key[1] > first_ms:  # the client came later than those that are older
                yield f"plot of {key[0]} at {key[1]} ms is shown, and never left"
        for key in (in_time - page).elements():
            yield f"plot of {key[0]} at {key[1]} ms has left, and is not shown"

    def _tracks_told(self, heard: list[MqttMessage]) -> Told:
        """When what was told of each track: flags, and as of which time, milliseconds."""
        told: Told = defaultdict(list)
        site = site_frame(self.scene.scene.site)
        near_ns = int(1e6 * self.samples[0][1]["now_ms"])
        for message in heard:
            if message.topic == self.scene.page.tracks_topic:
                for track in tracks_to_show(message.payload, None, near_ns, site):
                    states = (track.tentative, track.coasted, track.ended)
                    flags = sum(
                        flag for flag, holds in zip(TrackFlag, states, strict=True) if holds
                    )
                    number = int(track.name.rpartition(".")[2])
                    told[number].append((message.at_s, flags, (track.t_utc_ns or 0) / 1e6))
        return told

    def _most_behind_s(self, told: Told) -> float:
        """How long the next report of a track had been there at most that was not shown yet."""
        most_s = 0.0
        for asked_s, sample in self.samples:
            for track, t_ms, _ in sample["tracks"]:
                later = [at_s for at_s, _, when_ms in told[track] if when_ms > t_ms + 1]
                most_s = max(most_s, asked_s - min(later, default=asked_s))
        return round(most_s, 2)


def _tracks_of_sample(
    told: Told, asked_s: float, began_s: float, sample: dict[str, Any]
) -> Iterator[str]:
    """Compare the tracks of a sample with what had come of them by then."""
    now_ms = sample["now_ms"]
    shown = {track: (t_ms, flags) for track, t_ms, flags in sample["tracks"]}
    aged = {label.split()[0]: label for label in sample["labels"] if " " in label}
    plain = {label for label in sample["labels"] if " " not in label}
    for track in sorted(shown.keys() | told.keys()):
        came = [each for each in told[track] if each[0] <= asked_s]
        may_be = {
            (round(t_ms), flags)
            for i, (_, flags, t_ms) in enumerate(came)
            if i + 1 == len(came) or came[i + 1][0] > asked_s - BEHIND_S
        }
        if track in shown:
            t_ms, flags = shown[track]
            if came and (round(t_ms), flags) not in may_be:
                yield f"T{track} is shown as of {t_ms:.0f} with {flags}; it was told {may_be}"
            age_s = (now_ms - t_ms) / 1e3
            if age_s > KEPT_S + LAG_S:
                yield f"T{track} is still shown, {age_s:.0f} s after its last report"
            if age_s > 20.0 + LAG_S and f"T{track}" in plain:
                yield f"T{track} is {age_s:.0f} s old, and is drawn as if it were told of"
            if age_s < 1.0 and f"T{track}" in aged:
                yield f"T{track} is {age_s:.1f} s old, and is drawn as {aged[f'T{track}']}"
        elif came and came[-1][0] > began_s and asked_s - came[-1][0] > BEHIND_S:
            _, flags, t_ms = came[-1]
            if not flags & TrackFlag.ENDED and now_ms - t_ms < 1e3 * (KEPT_S - LAG_S):
                yield f"T{track} was told of {(now_ms - t_ms) / 1e3:.0f} s ago, and is not shown"
