"""Scenes that come with plotfeed: each shows what its file and docs/scenes.md say to look for."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.command import plotfeed_here
from support.doc_commands import doc_command

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.engine.simulation import SimulatedSensor, Simulation, simulate
from plotfeed.feeds.page.scene_outline import load_basemap
from plotfeed.feeds.scene.changes import changed
from plotfeed.feeds.scene.examples import MAX_WORDS, head_of, summaries
from plotfeed.feeds.scene.scene import example
from plotfeed.models.state import FALSE_ALARM, Bools, Floats
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "scenes.md").read_text()


@cache
def seen(name: str, duration_s: float) -> Simulation:
    return simulate(name, duration_s, start_utc_ns=START_NS)


def after_s(sensor: SimulatedSensor) -> Floats:
    """When each look was, from the start."""
    times: Floats = (sensor.looks.t_utc_ns - START_NS) / NS
    return times


def turned_deg(sensor: SimulatedSensor, looks: Bools) -> float:
    """Between how far apart those looks were."""
    return float(np.ptp((sensor.looks.azimuth_deg[looks] + 180.0) % 360.0))


@pytest.mark.parametrize("name", summaries())
def test_each_says_what_it_is_gives_no_doubts_and_can_have_the_usual_stories(name: str) -> None:
    shown = example(name)
    head, sensors = head_of(shown.text), {sensor.id: sensor for sensor in shown.sensor}
    assert head.summary == summaries()[name]
    assert 20 < len(head.summary) <= len(head.words) < MAX_WORDS
    told = [text for sensor in report(shown)["sensors"] for text in sensor["warnings"]]
    assert not told or name == "section-4"
    assert f"## {name}\n" in PAGE or f"[{name}]" in PAGE
    assert shown.stories.keys() >= {"bad-link", "outage", "drift", "swarm"}
    for story in shown.stories.values():
        for sensor, keys in story.sets.items():
            assert changed(sensors[sensor], keys) != sensors[sensor]
            changed(sensors[sensor], keys).model(shown.scene.site)
    if name == "section-4":
        assert list(sensors) == ["active", "mimo", "passive", "microphone"]  # the paper's
        assert shown.scene.start_utc_ns is None


def test_all_are_listed_with_their_files_and_none_besides() -> None:
    told = json.loads(plotfeed_here("scenes", "--json").stdout)
    assert [scene["name"] for scene in told] == list(summaries())
    assert told[0]["name"] == "field-day"
    assert all(Path(scene["file"]).is_file() for scene in told)
    lines = plotfeed_here("scenes").stdout
    assert all(name in lines and about in lines for name, about in summaries().items())
    refused = plotfeed_here("demo", "nowhere", "--broker", "none")
    assert (refused.returncode, refused.stdout) == (2, "")
    expected = "plotfeed: no shipped scene 'nowhere': expected one of field-day"
    assert refused.stderr.startswith(expected)


def test_the_field_day_has_work_for_every_sensor_and_trouble_for_its_tracker() -> None:
    shown = example("field-day")
    road = fly(shown, 60.0)
    of: dict[str, list[str]] = {sensor.id: [] for sensor in shown.sensor}
    for entry in road.ledgers:
        of[entry.sensor] += [plot.drone for plot in entry.plots]
    assert all(len(plots) > 20 for plots in of.values())
    assert {"intruder", "survey-1", "parcel-1", "racer-1", ""} <= set(of["tower"])
    assert "parcel-1" in of["rf"]
    assert not any(name.startswith("survey") for name in of["rf"])
    sent = [m for entry in road.ledgers if entry.sensor == "tower" for m in entry.messages]
    assert 0.02 < np.mean([not m.delivered for m in sent]) < 0.12
    records = [r for payload in road.payloads("tower/asterix/062") for r in decode(payload)]
    assert len(records) > 200
    for state, least in (("TSB", 10), ("CST", 10), ("TSE", 1)):  # begun, coasted, ended
        assert sum(record.get(f"I062/080/{state}") == 1 for record in records) >= least


def test_a_stadium_swarm_is_fewer_plots_than_drones_and_all_of_its_emitters() -> None:
    found = seen("stadium", 110.0)
    radar = found["roof-radar"].plots
    of_drones = radar.drone != FALSE_ALARM
    per_scan = np.bincount(radar.scan[of_drones] - radar.scan.min())
    assert 1 <= np.median(per_scan) < 8
    together = [1 + len(merged) for merged in radar.merged_drones[of_drones]]
    assert max(together) >= 8
    for name in ("rf-west", "rf-north"):
        rf = found[name].plots
        identities = set(rf.identity.tolist()) - {""}
        assert {"broadcaster", *(f"swarm-{n}" for n in range(1, 17))} >= identities
        assert np.median(np.bincount(rf.scan - rf.scan.min())) == 17
    camera = found["roof-camera"]  # sees those in its picture alone
    assert after_s(camera).min() > 60.0  # they come from further out than it sees
    assert len(np.unique(camera.looks.drone[camera.looks.detected])) >= 5


def test_the_airport_s_radars_disagree_by_their_registration() -> None:
    found = seen("airport", 40.0)
    for name, expected_deg in (("north", 0.0), ("south", 0.8)):
        plots = found[name].plots
        of_drones = plots.drone != FALSE_ALARM
        error_deg = (plots.azimuth_deg - plots.true_azimuth_deg)[of_drones]
        sigma_deg = float(np.nanmedian(plots.sigma_azimuth_deg[of_drones]))
        six_sigma_deg = 6 * sigma_deg / len(error_deg) ** 0.5
        assert np.mean(error_deg) == pytest.approx(expected_deg, abs=six_sigma_deg)
    of_gulls = [name.startswith("bird/gulls-") for name in found.drones]
    assert sum(of_gulls) == 12
    plots = found["north"].plots.drone
    assert np.isin(plots, np.flatnonzero(of_gulls)).sum() > 5 * (plots == 0).sum()


def test_the_valley_s_radars_hand_the_drone_over() -> None:
    found = seen("valley", 60.0)
    floor, ridge = found["floor"], found["ridge"]
    assert floor.looks.pd[after_s(floor) < 40.0].max() < 1e-3  # behind the ridge
    assert floor.looks.pd[after_s(floor) > 57.0].min() > 0.9
    assert ridge.looks.pd.min() > 0.9


def test_the_city_s_direction_finders_lose_who_sinks_into_a_street_and_its_cameras_turn() -> None:
    found = seen("city", 60.0)
    for name in ("rf-south", "rf-west"):
        rf = found[name]
        assert rf.looks.pd[after_s(rf) < 2.5].max() < 0.2
        assert rf.looks.pd[(after_s(rf) > 6.0) & (after_s(rf) < 50.0)].min() > 0.9
        assert set(rf.plots.identity.tolist()) <= {"courier", ""}
    courier = found.drones.index("courier")
    camera, turret = found["camera"], found["turret"]
    at_it = camera.looks.drone == courier
    assert len(np.unique(after_s(camera)[at_it & camera.looks.detected].astype(int))) >= 10
    assert turned_deg(camera, at_it) > 15.0  # far beyond one picture: it was turned
    at_it = turret.looks.drone == courier
    assert after_s(turret)[at_it].min() > 2.0  # it was in the street, and then took the way there
    assert turret.looks.detected[at_it].sum() > 100
    assert turned_deg(turret, at_it) > 5.0
    assert "Phantom 4" in turret.plots.kind[turret.plots.drone == courier].tolist()


def test_maps_and_ground_are_what_their_command_makes() -> None:
    made, folder = doc_command("write_example_ground"), ROOT / "feeds" / "scene" / "examples"
    for name in made["MAPS"]:
        assert (folder / f"{name}.geojson").read_text() == made["geojson"](name)
    tile = made["valley_heights_m"]().round().astype(">i2").tobytes()
    assert made["TILE"].read_bytes() == tile
    shown, field = example("field-day"), folder / "field-day.geojson"
    assert load_basemap(field.name, field, shown.scene.site).content.count(b'"town"') == 1


def test_the_coast_s_broadcasts_place_a_drone_finely_and_coarsely() -> None:
    found = seen("coast", 60.0)
    passive = found["passive"].plots
    of_drones = passive.drone != FALSE_ALARM
    fine, coarse = (
        passive.sigma_bistatic_range_m[of_drones & (passive.channel == channel)]
        for channel in (0, 1)
    )
    assert min(len(fine), len(coarse)) > 60
    assert np.median(fine) < 15.0
    assert np.median(coarse) > 150.0
    far, near = (found.drones.index(name) for name in ("from-the-boat", "along-the-beach"))
    assert {far, near} <= set(passive.drone.tolist())
    assert near in found["pier"].plots.drone
    assert far not in found["pier"].plots.drone


@pytest.fixture(scope="module")
def delivered() -> Feed:
    return fly(example("delivery"), 40.0)


def claims(road: Feed, drone: str) -> dict[int, pb.Claim]:
    """What the ledger says of a drone's claims, by seconds from the start."""
    return {
        entry.scan - START_NS // NS: claim
        for entry in road.ledgers
        if entry.sensor == "cooperative"
        for claim in entry.claims
        if claim.drone == drone
    }


def off_m(claim: pb.Claim) -> float:
    return float(np.linalg.norm([claim.error_east_m, claim.error_north_m, claim.error_up_m]))


def test_four_deliverers_do_not_do_or_say_what_they_should(delivered: Feed) -> None:
    stray, spoofed, frozen, runaway = (
        claims(delivered, name) for name in ("stray", "spoofed", "frozen", "runaway")
    )
    assert (stray[19].contingency, stray[30].contingency) == ("", "stray")
    assert off_m(stray[30]) < 10.0
    assert max(off_m(spoofed[14]), off_m(frozen[17])) < 10.0
    assert off_m(spoofed[30]) > 60.0
    assert off_m(frozen[30]) > 100.0
    assert runaway[24].HasField("error_east_m")
    assert not runaway[26].HasField("error_east_m")
    assert runaway[30].contingency == "fly-away"
    said = {m.topic.rpartition("/")[2] for m in delivered.messages if "/claimed/" in m.topic}
    assert said >= {f"parcel-{n}" for n in range(1, 21)}
    parcels = [off_m(claims(delivered, f"parcel-{n}")[35]) for n in range(1, 21)]
    assert max(parcels) < 10.0
    assert delivered.plots("west").drone.tolist().count("runaway") > 30
