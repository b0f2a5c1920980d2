"""Node `force_torque`: the wrench, checked, in SI units, with the contract's sign; tare and test of the sensor.

A tare is subtracted from what is published and told on its own topic; the untared wrench is published beside it.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from calibration_interfaces.msg import Outcome, TareEvent
from calibration_interfaces.srv import SelfTest, Tare

from calibration.background import Background
from calibration.conversions import (
    FORCE_UNITS,
    SIGNS,
    TORQUE_UNITS,
    WRENCH_INPUTS,
    Mean,
    joint_positions,
    to_header,
    to_outcome,
    to_tare,
    to_wrench_stamped,
    wrench_sample,
)
from calibration.instruments.acquisition import AcquisitionNode, MeasuringError
from calibration.instruments.stream import Stream
from calibration.node import Declared, run
from calibration.topics import RAW_WRENCH, TARE, Quality, Topic, subscription_profile
from calibration_core.errors import InputError
from calibration_core.identification.checks.sensor_test import evaluate_sensor_test, gravity_in_sensor
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.timeseries import Float1D

WRENCH = "wrench"

PARAMETERS = (
    Declared("topic", "input/wrench", "Where the sensor's samples come from."),
    Declared("input_type", "WrenchStamped", "What the sensor sends.", choices=tuple(WRENCH_INPUTS)),
    Declared("force_unit", "N", "Unit of the forces.", choices=tuple(FORCE_UNITS)),
    Declared("torque_unit", "N*m", "Unit of the torques.", choices=tuple(TORQUE_UNITS)),
    Declared("sign", "applied_on_robot", "Whose wrench the sensor reads.", choices=tuple(SIGNS)),
    Declared("largest_force", 50000.0, "Force beyond which a sample is implausible, N.", low=0.001),
    Declared("largest_torque", 20000.0, "Torque beyond which a sample is implausible, N*m.", low=0.001),
    Declared("fastest_force", 0.0, "Change of force that counts as a jump, N/s; 0: not checked.", low=0.0),
    Declared("fastest_torque", 0.0, "Change of torque that counts as a jump, N*m/s; 0: not checked.", low=0.0),
    Declared("tolerance_force", 5.0, "Change over a window that does not matter, N.", low=0.0, read_only=False),
    Declared("tolerance_torque", 2.5, "Change over a window that does not matter, N*m.", low=0.0, read_only=False),
    Declared("publish_raw", True, "Whether the untared wrench is published as well."),
    Declared("test_mass_share", 0.05, "Share by which the tested mass may be off.", low=0.0, high=1.0),
    Declared("test_angle", 0.05, "Angle by which the tested axes may be off, rad.", low=0.0, high=3.2),
    Declared("test_force", 5.0, "Force that the test may leave unexplained, N.", low=0.0),
)


class ForceTorqueNode(AcquisitionNode):
    """Publishes `force_torque/wrench`; offers `~/measure`, `~/tare` and `~/self_test`."""

    OWNER = "force_torque"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node."""
        super().__init__("force_torque", PARAMETERS, **kwargs)

    def on_configure(self) -> None:
        """Make the one stream."""
        super().on_configure()
        self._units = FORCE_UNITS[self.value("force_unit")], TORQUE_UNITS[self.value("torque_unit")]
        self._sign = SIGNS[self.value("sign")]
        self._bias: Float1D = np.zeros(6)
        self._number, self._tares = 0, 0
        self._busy = False
        self._orientations: list[tuple[Float1D, Float1D]] = []
        self._q: Float1D | None = None
        limits = self.limits(
            (self.value("largest_force"), self.value("largest_torque")),
            (self.value("fastest_force"), self.value("fastest_torque")),
        )
        topic = self.value("topic")
        output = Topic(self.cell.topics.wrench, StreamKind.WRENCH.value, Quality.SAMPLES)
        alone = tuple({topic, output.relative})
        self._stream = self.add_stream(Stream(WRENCH, topic, limits, self.value("silent_after"), alone))
        self._forwards = self.resolve_topic_name(topic) != self.resolve_topic_name(output.relative)
        if self._forwards:
            self._publisher = self.create_publisher(output.message, output.relative, output.qos)
            self._raw = self.create_publisher(RAW_WRENCH.message, RAW_WRENCH.relative, RAW_WRENCH.qos)
        self._tare_events = self.create_publisher(TARE.message, TARE.relative, TARE.qos)
        self.add_source(topic, WRENCH_INPUTS[self.value("input_type")], self._on_wrench)
        self.create_service(Tare, "~/tare", self._on_tare, callback_group=self.group)
        self.create_service(SelfTest, "~/self_test", self._on_self_test, callback_group=self.group)

    def on_activate(self) -> None:
        """Listen to the joint states, too."""
        super().on_activate()
        joints = Topic(self.cell.topics.joint_states, StreamKind.JOINTS.value, Quality.SAMPLES)
        profile = subscription_profile(self, joints.relative, depth=1)
        self.create_subscription(joints.message, joints.relative, self._on_joints, profile)

    def outputs(self) -> Sequence[Any]:
        """Return the publisher of the wrench."""
        return (self._publisher,) if self._forwards else ()

    def tolerance(self, stream: Stream) -> Float1D:  # noqa: ARG002  # there is one stream only
        """Return the (6,) change over a window that does not matter, N and N*m."""
        return np.repeat([self.value("tolerance_force"), self.value("tolerance_torque")], 3)

    def tare_number(self) -> int:
        """Return the number of the tare in force; 0: none."""
        return self._number

    def _on_wrench(self, message: Any) -> None:
        read = wrench_sample(message, *self._units)
        raw = self.stamped(dataclasses.replace(read, values=self._sign * read.values))
        tared = dataclasses.replace(raw, values=raw.values - self._bias)
        if self._stream.take(tared, raw.stamp) and self._forwards:
            self._publisher.publish(to_wrench_stamped(self.labelled(tared)))
            if self.value("publish_raw"):
                self._raw.publish(to_wrench_stamped(self.labelled(raw)))

    def _on_joints(self, message: Any) -> None:
        self._q = joint_positions(message, self.cell.robot.joints)

    # --- tare -------------------------------------------------------------------------------------------------

    async def _on_tare(self, request: Any, response: Any) -> Any:
        if not self._forwards:
            text = "the stream comes on the contract's topic already: nothing can be subtracted from it"
            response.outcome = to_outcome(Outcome.NOT_AVAILABLE, text)
            return response
        if request.clear:
            self._set_tare(response, request, 0, np.zeros(6), None)
            return response
        mean = await self._averaged(response, request.window, request.timeout)
        if mean is not None:
            self._tares += 1
            self._set_tare(response, request, self._tares, self._bias + mean.average.mean, mean)
        return response

    def _set_tare(self, response: Any, request: Any, number: int, bias: Float1D, mean: Mean | None) -> None:
        self._bias, self._number = bias, number
        header = to_header(self.now_ns(), mean.frame if mean else self._stream.frame)
        event: TareEvent = to_tare(header, number, bias, mean, request.requested_by, request.reason)
        self._tare_events.publish(event)
        self.get_logger().info(f"tare {number}: bias {np.round(bias, 3).tolist()} ({request.requested_by})")
        response.outcome, response.event = to_outcome(Outcome.OK, ""), event

    async def _averaged(self, response: Any, window: float = 0.0, timeout: float = 0.0) -> Mean | None:
        """Average now; with None, the response says why there is nothing."""
        if self._busy:
            response.outcome = to_outcome(Outcome.BUSY, "a tare or test is under way")
            return None
        self._busy = True
        try:
            request = self.asked((), window, timeout, 0)
            (mean,) = await Background(self, lambda: self.measure(request))
        except MeasuringError as error:
            response.outcome = to_outcome(error.code, str(error))
            return None
        finally:
            self._busy = False
        return mean

    # --- test with a known mass -------------------------------------------------------------------------------

    async def _on_self_test(self, request: Any, response: Any) -> Any:
        if request.command == SelfTest.Request.CLEAR:
            self._orientations.clear()
            response.outcome = to_outcome(Outcome.OK, "")
        elif request.command == SelfTest.Request.ADD:
            await self._add_orientation(response)
        elif request.command == SelfTest.Request.EVALUATE:
            self._evaluate(request, response)
        else:
            text = f"found command {request.command}, expected ADD, EVALUATE or CLEAR"
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, text)
        response.orientations = len(self._orientations)
        return response

    async def _add_orientation(self, response: Any) -> None:
        q = self._q
        if q is None:
            text = f"no joint states with all joints of the cell on {self.cell.topics.joint_states}"
            response.outcome = to_outcome(Outcome.NO_DATA, text)
            return
        mean = await self._averaged(response)
        if mean is None:
            return
        try:
            weight = gravity_in_sensor(self.cell, q)
        except InputError as error:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, str(error))
            return
        self._orientations.append((mean.average.mean + self._bias, weight))
        response.outcome = to_outcome(Outcome.OK, "")

    def _evaluate(self, request: Any, response: Any) -> None:
        if not (np.isfinite(request.mass) and request.mass > 0.0):
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, f"found mass {request.mass}, expected a positive one")
            return
        try:
            found = evaluate_sensor_test(
                np.array([wrench for wrench, _ in self._orientations]).reshape(-1, 6),
                np.array([weight for _, weight in self._orientations]).reshape(-1, 3),
            )
        except InputError as error:
            response.outcome = to_outcome(Outcome.NOT_IDENTIFIABLE, str(error))
            return
        faults = found.faults(
            request.mass,
            mass_share=self.value("test_mass_share"),
            angle=self.value("test_angle"),
            force=self.value("test_force"),
        )
        response.sign, response.mass = float(found.sign), found.mass
        response.bias, response.centre_of_mass = found.bias, found.centre_of_mass
        response.residual_force, response.residual_torque = found.residual_force, found.residual_torque
        response.frame_error = found.frame_error
        response.outcome = to_outcome(Outcome.TEST_FAILED if faults else Outcome.OK, "; ".join(faults))
        self.diagnostics.report("self test", 2 if faults else 0, response.outcome.text or "passed")


def main(arguments: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(ForceTorqueNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
