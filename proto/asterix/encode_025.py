"""Whether a system works, in category 025, each a data block of one record."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

from plotfeed.proto.asterix.cat025 import CAT025
from plotfeed.proto.asterix.codec.encode import Reports, checked_position
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.units import TIME_LSB_NS

SERVICE_AND_SYSTEM_STATUS = 1  # I025/000/RTYP


class Operation(IntEnum):
    """What a system is used for, I025/100/OPS."""

    OPERATIONAL = 0
    STANDBY = 1
    MAINTENANCE = 2


class State(IntEnum):
    """How a system or a service does, I025/100."""

    RUNNING = 0
    FAILED = 1
    DEGRADED = 2
    UNDEFINED = 3


class StatusEncoder025:
    """Status reports, as I025/010, 000, 070, 100, 600 and 610, and of errors 105.

    The height of the system's reference point is above the WGS-84 ellipsoid, of which mean sea
    level is `geoid_undulation_m` high. `category` is CAT025 or CAT025_HALF_TURN.
    """

    def __init__(
        self,
        sac: int,
        sic: int,
        *,
        latitude_deg: float,
        longitude_deg: float,
        height_m: float,
        geoid_undulation_m: float = 0.0,
        category: Category = CAT025,
    ) -> None:
        checked_position(latitude_deg, longitude_deg, field="I025/600")
        self._constants: dict[str, float | str] = {
            "I025/010/SAC": sac,
            "I025/010/SIC": sic,
            "I025/000/RTYP": SERVICE_AND_SYSTEM_STATUS,
            "I025/600/LAT": latitude_deg,
            "I025/600/LON": longitude_deg,
            "I025/610": height_m - geoid_undulation_m,
        }
        self._category = category
        self._by_errors: dict[int, Reports] = {}
        self._reports(0)

    def block(
        self,
        t_utc_ns: int,
        *,
        released: bool = True,
        operation: Operation = Operation.OPERATIONAL,
        service: State = State.RUNNING,
        system: State = State.RUNNING,
        errors: Sequence[int] = (),
        event: bool = False,
    ) -> bytes:
        """Data block of a report; `released` for operational use, `event` if it is not periodic.

        `errors` are values of I025/105, such as 2 for an invalid source of time.
        """
        columns = {
            "I025/000/RG": int(event),
            "I025/070": t_utc_ns,
            "I025/100/NOGO": int(not released),
            "I025/100/OPS": operation,
            "I025/100/SSTAT": service,
            "I025/100/SYSTAT": system,
            "I025/100/SESTAT": service,
        }
        columns |= {f"I025/105/{index}": error for index, error in enumerate(errors)}
        (block,) = self._reports(len(errors)).blocks(columns)
        return block

    def _reports(self, errors: int) -> Reports:
        if errors not in self._by_errors:
            items = ("I025/010", "I025/000", "I025/070", "I025/100/SYSTAT", "I025/600", "I025/610")
            self._by_errors[errors] = Reports(
                self._category,
                (*items, f"I025/105*{errors}") if errors else items,
                constants=self._constants,
                lsb={"I025/070": TIME_LSB_NS},
            )
        return self._by_errors[errors]
