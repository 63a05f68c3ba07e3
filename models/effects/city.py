"""Loss of radio signals from the air among houses: in sight or not, once for each pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from plotfeed.models.state import Floats


@dataclass(frozen=True, kw_only=True)
class City:
    """An environment by the laws of Al-Hourani, Kandeepan and Lardner 2014.

    Among drones at one elevation a share is in sight, expit(b (elevation - a) - ln a); what is lost
    beyond free space is `in_sight_db` or `hidden_db`, give or take `shadowing_db`.
    """

    a: float
    b: float
    in_sight_db: float
    hidden_db: float
    shadowing_db: float = 0.0

    def sight_probability(self, elevation_deg: Floats) -> Floats:
        """Probability that a drone at that elevation is in sight; (...)."""
        return np.asarray(expit(self.b * (elevation_deg - self.a) - np.log(self.a)))

    def power_factor(self, elevation_deg: Floats, draws: Floats | None) -> Floats:
        """Factor of power beyond free space; (n,), and (2, n) draws of pairs: uniform and normal.

        Without draws, of what is likelier, in sight or not.
        """
        sight = self.sight_probability(elevation_deg) > (0.5 if draws is None else draws[0])
        lost_db = np.where(sight, self.in_sight_db, self.hidden_db)
        if draws is not None:
            lost_db = lost_db + self.shadowing_db * draws[1]
        return np.asarray(10 ** (-lost_db / 10))


# 10.1109/LWC.2014.2342736: a and b of the sigmoid, and mean excess losses at 2 GHz.
CITIES = {
    "suburban": City(a=4.88, b=0.43, in_sight_db=0.1, hidden_db=21.0),
    "urban": City(a=9.61, b=0.16, in_sight_db=1.0, hidden_db=20.0),
    "dense-urban": City(a=12.08, b=0.11, in_sight_db=1.6, hidden_db=23.0),
    "high-rise": City(a=27.23, b=0.08, in_sight_db=2.3, hidden_db=34.0),
}
