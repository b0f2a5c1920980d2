"""A client of an action for tests, which ask in one thread while another one spins."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.action import ActionClient


class GoalClient(ActionClient):
    """An action client that loses no answer (https://github.com/ros2/rclpy/issues/1123).

    `ActionClient` files a request only after it was sent, and ignores an answer to a request that is not filed: in a
    thread beside the executor's the answer may come first.  Here an answer is looked at once its request is filed.
    """

    def __init__(self, *args: Any, **more: Any) -> None:
        self._filing = threading.Lock()
        super().__init__(*args, **more)

    def send_goal_async(self, *args: Any, **more: Any) -> Any:
        """Send a goal."""
        with self._filing:
            return super().send_goal_async(*args, **more)

    def _cancel_goal_async(self, goal_handle: Any) -> Any:
        with self._filing:
            return super()._cancel_goal_async(goal_handle)

    def _get_result_async(self, goal_handle: Any) -> Any:
        with self._filing:
            return super()._get_result_async(goal_handle)

    async def execute(self, taken_data: Any) -> None:
        """Take answers in, not before what they answer is filed."""
        with self._filing:
            pass
        await super().execute(taken_data)
