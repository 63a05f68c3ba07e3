"""Drones that are forgotten: those that stay are as they were; nothing of the others is held."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.held_sizes import held
from support.one_sample import add_sample

from plotfeed.models.beam import Borders
from plotfeed.models.chance import Chance, Purpose, ScanDraws
from plotfeed.models.state import NS, Emitter, Signature, renamed
from plotfeed.models.tracks import TrackLives, TrackRule
from plotfeed.models.truth import Trajectories

T0 = 1_767_268_800 * NS
RADIO = (Emitter(frequency_hz=2.4e9, eirp_dbm=20.0),)


def say(into: Trajectories, drone: str, t_s: float, place: int) -> None:
    add_sample(
        into,
        drone,
        T0 + round(t_s * NS),
        latitude_deg=40.0 + 1e-3 * place,
        longitude_deg=-3.0 + 1e-6 * t_s,
        height_m=700.0,
        velocity_enu_m_s=None,
        sigma_m=1.0,
        signature=Signature(rcs_m2=1.0 + place, emitters=RADIO * (place % 3)),
    )


steps = st.lists(st.tuples(st.sampled_from("abcdefgh"), st.booleans()), max_size=60)


@given(steps)
def test_drones_that_stay_keep_their_rows_and_their_states(steps: list[tuple[str, bool]]) -> None:
    """To the last bit what each would be alone; a name that comes again begins anew."""
    together = Trajectories(stale_after_s=3.0)
    alone: dict[str, Trajectories] = {}
    rows: dict[str, int] = {}
    for k, (drone, goes) in enumerate(steps):
        if goes and drone in alone:
            before = together.names
            together.forget([drone])
            others, row = set(renamed(before, together.names).tolist()), rows.pop(drone)
            assert row in others
            assert others.isdisjoint(rows.values())
            del alone[drone]
        else:
            own = alone.setdefault(drone, Trajectories(stale_after_s=3.0))
            for into in (together, own):
                say(into, drone, 0.2 * k, ord(drone))
            row = together.names.index(drone)
            free = [i for i in range(len(together.names)) if i not in rows.values()]
            assert row == rows.setdefault(drone, min(free, default=row))
        for asked_s in (0.2 * k - 1.0, 0.2 * k, 0.2 * k + 1.0):
            t_utc_ns = T0 + round(asked_s * NS)
            there = together.state_at(t_utc_ns)
            found = {together.names[row]: i for i, row in enumerate(there.drone.tolist())}
            assert found.keys() <= alone.keys()
            for name, own in alone.items():
                state = own.state_at(t_utc_ns)
                assert (name in found) == bool(len(state))
                if len(state):
                    i = found[name]
                    assert (there.position_ecef_m[i] == state.position_ecef_m[0]).all()
                    assert (there.velocity_ecef_m_s[i] == state.velocity_ecef_m_s[0]).all()
                    emitters = together.signatures.emitters[rows[name]]
                    assert emitters == own.signatures.emitters[0]
        assert len(together) == len(alone)


def test_a_week_of_a_thousand_names_an_hour_holds_no_more_than_an_hour_of_them() -> None:
    trajectories, sizes = Trajectories(stale_after_s=3.0), []
    say(trajectories, "stays", 0.0, 1)
    for hour in range(168):
        names = [f"{hour}-{i}" for i in range(1000)]
        n = len(names) + 1
        t_utc_ns = np.full(n, T0 + hour * 3600 * NS + NS)
        trajectories.add_samples(
            [*names, "stays"],
            t_utc_ns,
            latitude_deg=np.full(n, 40.0),
            longitude_deg=np.full(n, -3.0),
            height_m=np.full(n, 700.0),
            velocity_enu_m_s=np.zeros((n, 3)),
            sigma_m=np.full(n, 1.0),
            signatures=trajectories.signatures.__class__(
                rcs_m2=np.ones(n), sound_power_db=np.ones(n), emitters=[RADIO] * n
            ),
        )
        assert len(trajectories.state_at(int(t_utc_ns[0]))) == n
        trajectories.forget(names)
        sizes.append(held(trajectories))
    assert trajectories.names == ["stays"]
    assert max(sizes) == sizes[0] < 20_000


def test_draws_of_drones_that_stay_are_the_same_however_many_there_were() -> None:
    draws = ScanDraws([Chance(1, "radar")], Purpose.DETECTION)
    zeros = np.zeros(1, np.int64)

    def drawn(row: int) -> tuple[float, float]:
        of = draws.of(zeros, zeros + 7, zeros + row)
        return float(of.standard_gamma(0.3, (1,))[0]), float(of.standard_normal((1,))[0])

    before, small = drawn(5), held(draws)
    drawn(20_000)
    assert held(draws) > 50 * small
    draws.trim(6)
    assert drawn(5) == before
    assert held(draws) == small


def test_borders_and_lives_of_tracks_hold_no_more_than_the_drones_that_are_known() -> None:
    borders = Borders(3)
    borders.make_room(10_000)
    borders.azimuth_deg[:] = 1.0
    borders.forget(np.arange(5, 10_000), 5)
    assert borders.azimuth_deg.shape[1] < 100
    assert (borders.azimuth_deg[:, :5] == 1.0).all()
    assert np.isnan(borders.azimuth_deg[:, 5:]).all()
    rule = TrackRule(confirm_hits=1, confirm_window=2, drop_misses=2, period_ns=NS)
    lives, drones = TrackLives(rule), np.arange(5000)
    hit = np.ones(len(drones), np.bool_)
    begun = lives.take(drones, np.full(len(drones), NS), hit, start_ns=0, end_ns=NS)
    lives.forget(drones[3:], 3)
    assert held(lives) < 2000
    assert lives.drones.tolist() == [0, 1, 2]
    later = lives.take(drones[:4], np.full(4, 2 * NS), hit[:4], start_ns=NS, end_ns=2 * NS)
    assert later.track[:3].tolist() == begun.track[:3].tolist()
    assert later.first.tolist() == [False, False, False, True], "who has the row is another"
