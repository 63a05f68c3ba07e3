"""The page's own reckoning, as Node runs it: frames, tracks, maps, the past."""

from __future__ import annotations

import base64
import json
import shutil
import struct
import subprocess
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import made_up_session
from support.geojson_maps import NO_GEOJSON, SHAPES, loaded
from support.links import link
from support.made_up_session import MadeUpSession
from support.page_updates import read_frame
from support.tools import needed

from plotfeed import testing
from plotfeed.feeds.link.losses import chain_of
from plotfeed.feeds.page.updates import LAYOUTS, SectionKind
from plotfeed.feeds.page.view import View
from plotfeed.models.frames import ecef_to_geodetic
from plotfeed.proto.utc import NS

Node = Callable[..., Any]
READ = 'const frameOf = (text) => new Uint8Array(Buffer.from(text, "base64")).buffer;'


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Node:
    """What a script gives that uses modules of the page, and knows what it is given as `given`."""
    folder, program = tmp_path_factory.mktemp("page"), needed("node")
    shutil.copytree(str(files("plotfeed.feeds.page") / "static"), folder, dirs_exist_ok=True)
    (folder / "package.json").write_text('{"type": "module"}')

    def run(script: str, given: object = None) -> Any:
        (folder / "given.json").write_text(json.dumps(given))
        (folder / "script.js").write_text(
            'import { readFileSync } from "node:fs";\nglobalThis.location = { pathname: "/" };\n'
            'const given = JSON.parse(readFileSync("given.json"));\n'
            f"const answer = await (async () => {{ {script} }})();\n"
            "process.stdout.write(JSON.stringify(answer));\n"
        )
        command = [program, "script.js"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture(scope="module")
def updates() -> list[bytes]:
    """What a browser that sees the truth is sent of four seconds of a session, ten times each."""
    stage = MadeUpSession(View(), made_up_session.scene(16))
    assert stage.view is not None
    found = []
    for _ in range(40):
        stage.advance(stage.now_ns + NS // 10)
        update = stage.view.update(stage.now_ns, stage.now_ns / NS)
        found.append(update.public + update.truth)
    return found


def sent(octets: Sequence[bytes]) -> list[str]:
    return [base64.b64encode(each).decode() for each in octets]


def test_frames_are_read_as_they_were_written(node: Node, updates: list[bytes]) -> None:
    read = node(
        f"""{READ} const {{ FrameReader }} = await import("./frames.js");
        const reader = new FrameReader();
        const plain = (c) => Object.entries(c).map(([n, v]) => [n, Array.from(v, String)]);
        return given.map((text) => {{
          const frame = reader.read(frameOf(text)), {{ isSnapshot, number, nowMs }} = frame;
          const sections = frame.sections.map((s) =>
            [s.kind, s.news ?? [s.rows, s.first, plain(s.columns)]]);
          return {{ isSnapshot, number, nowMs, sections }};
        }});""",
        sent(updates),
    )
    seen = set()
    for octets, said in zip(updates, read, strict=True):
        frame = read_frame(octets)
        assert [frame.is_snapshot, frame.number] == [said["isSnapshot"], said["number"]]
        assert said["nowMs"] == frame.now_ms
        for section, (kind, told) in zip(frame.sections, said["sections"], strict=True):
            seen.add(kind)
            assert section.kind == kind
            if section.news:
                assert told == section.news
                continue
            rows, first, columns = told
            assert (rows, first) == (section.rows, section.first)
            for name, values in columns:
                expected = section.columns[name].astype(np.float64)
                np.testing.assert_array_equal(np.array(values, np.float64), expected)
    assert seen >= LAYOUTS.keys() - {SectionKind.LOST_PLOTS}


def test_what_was_to_be_seen_at_any_time_is_shown_again(
    node: Node, updates: Sequence[bytes]
) -> None:
    """Of two minutes, in any order; a leap back forgets all."""
    updates = [bytearray(each) for each in updates]
    for number, octets in enumerate(updates):  # three seconds apart
        struct.pack_into("<d", octets, 16, read_frame(octets).now_ms + 2900.0 * number)
    found = node(
        f"""{READ} const [{{ FrameReader }}, {{ Past }}, {{ Picture }}] =
          await Promise.all(["frames", "past", "picture"].map((name) => import(`./${{name}}.js`)));
        const reader = new FrameReader(), past = new Past(reader), live = new Picture();
        const told = (picture) => {{
          const {{ plots, lost, drones, droneNames, tracks, news }} = picture, rows = [];
          for (let row = plots.begin; row < plots.end; row++)
            rows.push([...plots.told(plots.at(row)), plots.drone[plots.at(row)]]);
          return [rows.sort(), lost.end - lost.begin, Array.from(drones?.east_m ?? []), droneNames,
            [...tracks.values()].map((t) => [t.id, t.t_utc_ms, t.flags]), news.session];
        }};
        const seen = [];
        for (const text of given) {{
          const frame = reader.read(frameOf(text));
          live.take(frame, 0);
          past.keep(frameOf(text), frame, live);
          seen.push([frame.nowMs, JSON.stringify(told(live))]);
        }}
        const same = [39, 3, 17, 16, 39, 0, 25].map((i) =>
          JSON.stringify(told(past.pictureAt(seen[i][0]))) === seen[i][1]);
        const oldest = JSON.stringify(told(past.pictureAt(0))) === seen[0][1];
        const kept = [past.oldestMs, past.latestMs];
        past.keep(frameOf(given[0]), reader.read(frameOf(given[0])), live);
        return {{ same, oldest, kept, after: [past.oldestMs, past.latestMs] }};""",
        sent(updates),
    )
    first_ms, last_ms = (read_frame(updates[i]).now_ms for i in (0, -1))
    assert found["same"] == [True] * 7
    assert found["oldest"]
    assert found["kept"] == [first_ms, last_ms]
    assert found["after"] == [first_ms, first_ms]


def test_what_is_true_of_plots_is_of_those_with_the_same_numbers(node: Node) -> None:
    found = node(
        """const { Plots } = await import("./picture.js"), plots = new Plots();
        const columns = { t_utc_ms: [0, 1, 2], latency_ms: [0, 0, 0], sensor: [0, 0, 0] };
        plots.add({ ...columns, flags: [0, 0, 0] }, 3, 1000);
        plots.addTruths({ drone: [7, -1], merged: [0, 2], true_east_m: [5, 6] }, 2, 1001);
        return ["drone", "merged", "true_east_m"].map((name) => [...plots[name].slice(0, 3)]);"""
    )
    assert found == [[-2, 7, -1], [0, 0, 2], [None, 5, 6]]


def test_a_track_is_silent_once_it_is_late_by_its_own_measure_and_soon_heard_again(
    node: Node,
) -> None:
    """After 2.5 times its usual interval, 2 s at least and 20 s at most."""
    found = node(
        """const { noteReport, isSilent, ageText, stateOf, fadedTo } =
          await import("./track_states.js");
        return given.map(([everyMs, flags]) => {
          const track = { flags };
          for (let k = 0; k < 40; k++) {
            noteReport(track, k * everyMs);
            track.t_utc_ms = k * everyMs;
          }
          const silentAfter = [1900, 2100, 2400, 2600, 19_900, 20_100].filter((ms) =>
            isSilent(track, track.t_utc_ms + ms));
          const late = track.t_utc_ms + 30_000;
          const told = [stateOf(track, track.t_utc_ms), stateOf(track, late), ageText(track, late)];
          const faded = [1000, 30_000, 59_000].map((ms) => fadedTo(track, track.t_utc_ms + ms));
          noteReport(track, late);
          track.t_utc_ms = late;
          return [silentAfter, [...told, stateOf(track, late + 300)], faded];
        });""",
        [[500, 0], [1000, 1], [60_000, 2]],
    )
    for (silent_after, told, faded), (expected, state) in zip(
        found,
        (
            ([2100, 2400, 2600, 19_900, 20_100], "confirmed"),
            ([2600, 19_900, 20_100], "tentative"),
            ([20_100], "coasted"),
        ),
        strict=True,
    ):
        assert silent_after == expected
        assert told == [state, f"not updated, was {state}", "30 s", state]
        assert faded == pytest.approx([59 / 60, 0.5, 0.35])


def test_places_and_maps_are_where_the_server_has_them(node: Node, tmp_path: Path) -> None:
    site = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
    enu_m = np.array([[0.0, 0.0, 0.0], [4000.0, -9000.0, 0.0], [-20_000.0, 15_000.0, 0.0]])
    refused = [tree for tree, _ in NO_GEOJSON]
    places, shapes, errors = node(
        """const { toGeodetic } = await import("./earth.js");
        const { shapesOf } = await import("./own_map.js"), [site, enu, tree, refused] = given;
        const why = (wrong) => { try { shapesOf(wrong, site); } catch (e) { return e.message; } };
        return [enu.map(([e, n]) => toGeodetic(site, e, n)), shapesOf(tree, site),
          refused.map(why)];""",
        [site, enu_m.tolist(), SHAPES, refused],
    )
    expected = np.stack(ecef_to_geodetic(testing.SITE.to_ecef(enu_m)), axis=-1)[:, :2]
    np.testing.assert_allclose(places, expected, rtol=0, atol=1e-9)
    for kind, ours in loaded(tmp_path, SHAPES).items():
        for mine, one in zip(shapes[kind], ours, strict=True):
            assert mine[2:][-1:] == one[2:][-1:] or kind != "points"
            numbers = [[x for x in each if not isinstance(x, str)] for each in (mine, one)]
            np.testing.assert_allclose(*numbers, atol=0.06)
    assert all(error and error.startswith(("expected", "coordinates")) for error in errors), errors


def test_the_loss_that_a_link_is_asked_for_is_that_of_its_law(node: Node) -> None:
    asked: list[dict[str, Any]] = [
        {"kind": "random", "probability": 0.1},
        {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 4.0},
        {"kind": "gilbert-elliott", "p": 0.02, "r": 0.3, "bad_loss": 0.8},
    ]
    found = node(
        """const { askedLoss } = await import("./strips.js");
        const { agoText } = await import("./timeline.js");
        return [given.map(askedLoss), [59.4, 80, 600].map(agoText)];""",
        asked,
    )
    for keys, told in zip(asked, found[0], strict=True):
        chain = chain_of(link(loss=keys).loss)
        assert told["share"] == pytest.approx(chain.mean_loss)
    assert [told["burst"] for told in found[0]] == pytest.approx(
        [1 / 0.9, 4.0, 1 / (1 - 0.8 * 0.7)]
    )
    assert found[1] == ["59 s", "1 min 20 s", "10 min 0 s"]
