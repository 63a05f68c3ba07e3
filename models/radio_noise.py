"""External radio noise by Recommendation ITU-R P.372: what an antenna collects before a receiver.

A noise figure F_a is in dB over k T0 B. The medians are used; atmospheric noise, which matters at
night below some 20 MHz, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.quiet import quiet
from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True)
class NoiseLine:
    """A median noise figure, c - d log10(f / MHz), and the frequencies for which it is given."""

    c_db: float
    d_db: float
    min_mhz: float
    max_mhz: float

    @quiet
    def median_db(self, frequency_hz: ArrayLike) -> Floats:
        """F_am, dB; NaN outside the line's frequencies."""
        frequency_mhz = np.asarray(frequency_hz, dtype=np.float64) / 1e6
        given = (frequency_mhz >= self.min_mhz) & (frequency_mhz <= self.max_mhz)
        return np.where(given, self.c_db - self.d_db * np.log10(frequency_mhz), np.nan)


# P.372, man-made noise, table of c and d. The range 0.3 to 250 MHz is stated for the first three.
# The quiet rural line falls below galactic noise from 2 MHz on, and ends where that does.
MAN_MADE = {
    "city": NoiseLine(76.8, 27.7, 0.3, 250.0),
    "residential": NoiseLine(72.5, 27.7, 0.3, 250.0),
    "rural": NoiseLine(67.2, 27.7, 0.3, 250.0),
    "quiet-rural": NoiseLine(53.6, 28.6, 0.3, 100.0),
}
GALACTIC = NoiseLine(
    52.0, 23.0, 10.0, 100.0
)  # P.372; below some 10 MHz the ionosphere keeps it out


@quiet
def external_noise_db(environment: str, frequency_hz: ArrayLike) -> Floats:
    """F_a, dB: the powers of man-made noise and, where it is given, of galactic noise.

    NaN where P.372 gives no man-made noise for that environment, one of `MAN_MADE`.
    """
    man_made = 10 ** (MAN_MADE[environment].median_db(frequency_hz) / 10)
    galactic = 10 ** (GALACTIC.median_db(frequency_hz) / 10)
    return 10 * np.log10(man_made + np.nan_to_num(galactic))
