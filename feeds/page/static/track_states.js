// Whether a track is still told of: what its tracker says of it, and for how long it has said nothing.

import { TrackFlag } from "./frames.js";

export const TRACK_KEPT_MS = 60_000; // after its last report; it fades until then
const LATE = 2.5; // times as long as its tracker usually takes
const LEAST_MS = 2000;
const MOST_MS = 20_000;
const FAINTEST = 0.35;

let usualMs = 0; // from one report of a track to the next, of all tracks: for those that have had only one

/** Note how long a tracker takes from one report of a track to the next: a fading mean, milliseconds. */
export function noteReport(track, tMs) {
  const apart = tMs - track.t_utc_ms;
  if (!(apart > 0)) return;
  const before = track.apart_ms ?? (usualMs || apart);
  track.apart_ms = before + 0.2 * (Math.min(apart, 3 * before) - before);
  usualMs = track.apart_ms;
}

/** Whether the next report of it has stayed out for so long that it is no longer where it was. */
export function isSilent(track, nowMs) {
  return nowMs - track.t_utc_ms > Math.min(Math.max(LATE * (track.apart_ms ?? usualMs), LEAST_MS), MOST_MS);
}

/** How strongly it is drawn, from 1 down as it goes on being silent. */
export function fadedTo(track, nowMs) {
  return Math.max(1 - (nowMs - track.t_utc_ms) / TRACK_KEPT_MS, FAINTEST);
}

export function ageText(track, nowMs) {
  return `${Math.round((nowMs - track.t_utc_ms) / 1000)} s`;
}

/** Its state in words: what its tracker says, and that it says nothing any more. */
export function stateOf(track, nowMs) {
  const told = track.flags & TrackFlag.COASTED ? "coasted" : track.flags & TrackFlag.TENTATIVE ? "tentative" : "confirmed";
  return isSilent(track, nowMs) ? `not updated, was ${told}` : told;
}

/** How a drone is that has been gone for so many milliseconds, and why no sensor sees it, if none does. */
export function droneState(unseen, name, gone) {
  if (gone > 0) return `gone for ${(gone / 1000).toFixed(0)} s`;
  return name in unseen ? `flying, no sensor sees it${unseen[name] && `: ${unseen[name]}`}` : "flying";
}
