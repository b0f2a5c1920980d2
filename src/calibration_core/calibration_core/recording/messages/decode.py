"""Messages of one topic to arrays: the fixed layouts first, the typed reader for whatever they do not fit."""

from __future__ import annotations

import numpy as np

from calibration_core.recording.messages.kinds import Samples, StreamKind, join
from calibration_core.recording.messages.layout import Layout, MessageRows, extract, layout_of
from calibration_core.recording.messages.typed import deserializer, is_standard, read_typed
from calibration_core.recording.storage.batch import Batch
from calibration_core.timeseries import Bool1D, Int1D

LAYOUTS_PER_BATCH = 8
LAYOUTS_KEPT = 8


class Decoder:
    """Collects the samples of one topic, batch by batch.

    Args:
        file: Name for error messages.
        kind: What the messages are.
        joints: For joint states: names of the joints wanted, in order.
        fast: Whether fixed layouts are used; without, the typed reader reads everything.
    """

    def __init__(self, file: str, kind: StreamKind, joints: tuple[str, ...] = (), *, fast: bool = True) -> None:
        self._file, self._kind, self._joints, self._fast = file, kind, joints, fast
        self._layouts: list[Layout] = []
        self._parts: list[Samples] = []

    def add(self, batch: Batch) -> None:
        """Read a batch; file order is kept.

        Raises:
            RecordingError: The bag's own definition of the type cannot be read.
        """
        deserializer(self._file, batch.channel)
        joints = self._kind is StreamKind.JOINTS
        groups = self._groups(batch) if self._fast and is_standard(batch.channel) else []
        parts = [extract(batch, index, rows, layout, efforts=joints) for index, rows, layout in groups]
        if sum(len(index) for index, _, _ in groups) < len(batch):
            rest = np.ones(len(batch), np.bool_)
            for index, _, _ in groups:
                rest[index] = False
            parts.append(read_typed(self._file, self._kind, batch, np.flatnonzero(rest), self._joints))
        self._parts.append(parts[0] if len(parts) == 1 else self._join(parts, sort=True))

    def _join(self, parts: list[Samples], *, sort: bool = False) -> Samples:
        joints = self._kind is StreamKind.JOINTS
        return join(parts, len(self._joints) if joints else self._kind.columns, efforts=joints, sort=sort)

    def samples(self) -> Samples:
        """Return everything read so far."""
        return self._join(self._parts)

    def _groups(self, batch: Batch) -> list[tuple[Int1D, MessageRows, Layout]]:
        """Rows of the batch by layout; what fits none is in no group."""
        rest = np.arange(len(batch), dtype=np.int64)
        groups: list[tuple[Int1D, MessageRows, Layout]] = []
        for layout in list(self._layouts):
            rest = self._claim(batch, rest, layout, groups)
            if not len(rest):
                return groups
        for _ in range(LAYOUTS_PER_BATCH):
            found = layout_of(self._kind, batch.payload(int(rest[0])), self._joints)
            if found is None:
                break
            self._layouts = [found, *self._layouts][:LAYOUTS_KEPT]
            rest = self._claim(batch, rest, found, groups)
            if not len(rest):
                break
        return groups

    @staticmethod
    def _claim(batch: Batch, rest: Int1D, layout: Layout, groups: list[tuple[Int1D, MessageRows, Layout]]) -> Int1D:
        """Move the rows that have the layout from `rest` to `groups`; return what remains."""
        right = batch.length[rest] == layout.length
        index = rest if right.all() else rest[right]
        if not len(index):
            return rest
        rows = MessageRows(batch.buffer, batch.start[index], layout.length)
        same: Bool1D = rows.match(layout)
        if not same.all():
            index = index[same]
            if not len(index):
                return rest
            rows = MessageRows(batch.buffer, batch.start[index], layout.length)
        groups.append((index, rows, layout))
        return np.empty(0, np.int64) if len(index) == len(rest) else np.setdiff1d(rest, index, assume_unique=True)
