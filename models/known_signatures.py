"""What there is to sense of every drone that is known, by its row, as the drones come and go."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plotfeed.models.emitters import EmitterTable
from plotfeed.models.known_rows import trimmed, with_room
from plotfeed.models.state import DRONE, Floats, Ints, Signatures, Texts

if TYPE_CHECKING:
    from plotfeed.models.effects.target_echoes import TargetEcho, TargetEchoes

COLUMNS = ("_rcs_m2", "_sound_power_db", "_size_m", "_target_class", "_model")


class KnownSignatures:
    """Columns with room for more rows than there are; what is put last of a row counts."""

    def __init__(self, *, tells_echoes: bool = False) -> None:
        """`tells_echoes` where echoes of some drone may be stated."""
        self._echoes: list[TargetEcho | None] | None = [] if tells_echoes else None
        self._echo_columns: TargetEchoes | None = None
        self._rcs_m2: Floats = np.zeros(0)
        self._sound_power_db: Floats = np.zeros(0)
        self._size_m: Floats = np.zeros(0)
        self._target_class: Texts = np.zeros(0, np.object_)
        self._model: Texts = np.zeros(0, np.object_)
        self._emitters = EmitterTable()

    def add_row(self) -> None:
        """Know one more drone, of which nothing is known yet."""
        self._emitters.append(())
        if self._echoes is not None:
            self._echoes.append(None)

    def make_room(self, rows: int) -> None:
        """Have columns for at least so many rows."""
        for name in COLUMNS:
            setattr(self, name, with_room(getattr(self, name), rows))

    def forget(self, row: int) -> None:
        """Let a drone radiate no more: it is gone."""
        self._emitters[row] = ()

    def cut(self, rows: int) -> None:
        """Keep so many rows, the first ones, and not much room for more."""
        self._emitters.cut(rows)
        if self._echoes is not None:
            del self._echoes[rows:]
            self._echo_columns = None
        for name in COLUMNS:
            setattr(self, name, trimmed(getattr(self, name), rows))

    def put(self, rows: Ints, signatures: Signatures) -> None:
        """Put those of drones in their rows; (m,) each."""
        self._rcs_m2[rows] = signatures.rcs_m2
        self._sound_power_db[rows] = signatures.sound_power_db
        self._size_m[rows] = np.nan if signatures.size_m is None else signatures.size_m
        target_class, model = signatures.target_class, signatures.model
        self._target_class[rows] = DRONE if target_class is None else target_class
        self._model[rows] = "" if model is None else model
        if self._echoes is not None:
            self._put_echoes(self._echoes, rows, signatures.echoes)
        for row, emitters in zip(rows.tolist(), signatures.emitters, strict=True):
            self._emitters[row] = emitters

    def _put_echoes(
        self, known: list[TargetEcho | None], rows: Ints, echoes: TargetEchoes | None
    ) -> None:
        for i, row in enumerate(rows.tolist()):
            from plotfeed.models.effects.target_echoes import NOT_STATED

            number = NOT_STATED if echoes is None else int(echoes.kind[i])
            echo = None if echoes is None or number == NOT_STATED else echoes.kinds[number]
            if known[row] != echo:
                known[row], self._echo_columns = echo, None

    def _told_echoes(self) -> TargetEchoes | None:
        if self._echoes is None:
            return None
        if self._echo_columns is None or len(self._echo_columns.kind) != len(self._echoes):
            from plotfeed.models.effects.target_echoes import TargetEchoes

            self._echo_columns = TargetEchoes.of(self._echoes)
        return self._echo_columns

    @property
    def all(self) -> Signatures:
        """Signatures of every row."""
        return Signatures(
            rcs_m2=self._rcs_m2,
            sound_power_db=self._sound_power_db,
            emitters=self._emitters,
            size_m=self._size_m,
            target_class=self._target_class,
            model=self._model,
            echoes=self._told_echoes(),
        )
