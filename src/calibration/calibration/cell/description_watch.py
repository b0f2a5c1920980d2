"""The robot that its driver describes, held against the cell file: another one is not moved.

Comparing takes some tenths of a second, in a thread of its own: the sequencer's sign of life goes on meanwhile.
"""

from __future__ import annotations

import threading
from typing import Any

from calibration.topics import Quality, message_class, profile
from calibration_core.errors import CellError
from calibration_core.planning.plans.described_robot import description_fault
from calibration_core.recording.definitions.own import TEXT_TYPE

PATIENCE = 10.0  # s of wall time, that a comparison may take


class DescriptionWatch:
    """Listens to the robot description.

    Attributes:
        fault: Why it is not the cell's robot; empty: it is, or nothing is known yet.
    """

    def __init__(self, node: Any) -> None:
        """Prepare; `listen` begins.  `node` is the sequencer, with its cell."""
        self._node, self.topic = node, node.cell.topics.robot_description
        self.fault = ""
        self._text: str | None = None
        self._thread: threading.Thread | None = None

    def listen(self) -> None:
        """Listen; who comes late gets the last description."""
        kind, quality = message_class(TEXT_TYPE), profile(Quality.STATE)
        self._text, self.fault = None, ""
        self._node.create_subscription(kind, self.topic.lstrip("/"), self._on_description, quality)

    def _on_description(self, message: Any) -> None:
        if message.data == self._text:
            return
        self._text = str(message.data)
        self._thread = threading.Thread(target=self._compare, args=(self._text,), daemon=True)
        self._thread.start()

    def _compare(self, text: str) -> None:
        try:
            different = description_fault(text, self._node.cell)
        except CellError as error:
            different = str(error)
        if text == self._text:  # no other one has come meanwhile
            self.fault = f"{self.topic} is another robot than {self._node.cell.path}: {different}" if different else ""

    def judged(self) -> str:
        """Wait until what came is compared, and return the fault; where nothing came, say that, and find no fault."""
        thread, name = self._thread, "robot description"
        if thread is not None:
            thread.join(PATIENCE)
        if self._text is None:
            text = f"nothing comes on {self.topic}: nobody has held the robot against {self._node.cell.path}"
            self._node.get_logger().warning(text)
            self._node.diagnostics.report(name, 1, text)
        else:
            self._node.diagnostics.report(name, 2 if self.fault else 0, self.fault or "as the cell file says")
        return self.fault
