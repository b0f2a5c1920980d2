"""Node `force_torque`: the wrench, checked, in SI units, with the sign of recordings; tare and test of the sensor.

A tare is subtracted from what is published and reported on its own topic; the untared wrench is published beside it.
"""

from __future__ import annotations

import collections
import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from calibration_interfaces.msg import Outcome, TareEvent
from calibration_interfaces.srv import SelfTest, Tare
from geometry_msgs.msg import Wrench
from rclpy.serialization import deserialize_message, serialize_message

from calibration.conversions import (
    FORCE_UNITS,
    SIGNS,
    TORQUE_UNITS,
    WRENCH_INPUTS,
    Mean,
    Sample,
    WrenchReader,
    to_header,
    to_outcome,
    to_tare,
    to_wrench_stamped,
    wrench_sample,
)
from calibration.instruments.acquisition import POLL, AcquisitionNode, MeasuringError
from calibration.instruments.stream import Stream
from calibration.node import Declared, run
from calibration.rclpy_gaps import Background
from calibration.topics import PRESENT_WRENCH, TARE, Quality, Topic
from calibration_core.errors import InputError
from calibration_core.identification.checks.sensor_test import evaluate_sensor_test, gravity_in_sensor
from calibration_core.measurement.load_check import LoadCheck
from calibration_core.measurement.posture_check import Stood, movement_fault
from calibration_core.measurement.unloaded import LoadMemory, Unloaded, memory_file
from calibration_core.planning.plans.tolerances import DEFAULT_TOLERANCES
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.layout import Mould
from calibration_core.timeseries import NANOSECONDS, Float1D

WRENCH = "wrench"
JOINTS_WAIT = 2.0  # s of wall time, joint states of a window may come after its last sample
MASS_SHARE, AXES, UNEXPLAINED = 0.05, 0.05, 5.0  # share, rad, N: by which a tested sensor may be off
PRESENT = 0.5  # s by the samples' stamps, over which the present wrench is averaged
PRESENT_SAMPLES = 1000  # at most
LARGEST_TORQUE = 20000.0  # N*m, beyond which a sample is implausible
SETTLED_FORCE, SETTLED_TORQUE = 5.0, 2.5  # N, N*m: change over a window that does not matter
T = TypeVar("T")

PARAMETERS = (
    Declared("topic", "input/wrench", "Where the sensor's samples come from."),
    Declared("input_type", "WrenchStamped", "What the sensor sends.", choices=tuple(WRENCH_INPUTS)),
    Declared("force_unit", "N", "Unit of the forces.", choices=tuple(FORCE_UNITS)),
    Declared("torque_unit", "N*m", "Unit of the torques.", choices=tuple(TORQUE_UNITS)),
    Declared("sign", "applied_on_robot", "Whose wrench the sensor reads.", choices=tuple(SIGNS)),
    Declared("largest_force", 50000.0, "Force beyond which a sample is implausible, N.", low=0.001),
    Declared("load_memory", "", "File in which the sequencer keeps what is known of the load; empty: in $ROS_HOME."),
)


class ForceTorqueNode(AcquisitionNode):
    """Publishes `force_torque/wrench`; offers `~/measure`, `~/tare` and `~/self_test`."""

    OWNER = "force_torque"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node."""
        super().__init__("force_torque", PARAMETERS, **kwargs)

    def make_streams(self) -> None:
        """Make the one stream, and listen to the joint states, too."""
        units = FORCE_UNITS[self.value("force_unit")], TORQUE_UNITS[self.value("torque_unit")]
        self._scale = SIGNS[self.value("sign")] * np.repeat(units, 3)
        stamped = self.value("input_type") == "WrenchStamped"
        self._read = WrenchReader().read if stamped else lambda one: wrench_sample(deserialize_message(one, Wrench))
        self._mould: tuple[str, Mould | None] = "", None  # for one frame
        self._bias: Float1D = np.zeros(6)
        self._number, self._tares = 0, 0
        self._busy = False
        self._orientations: list[tuple[Float1D, Float1D]] = []
        limits = self.limits((self.value("largest_force"), LARGEST_TORQUE), (0.0, 0.0))
        topic = self.value("topic")
        output = Topic(self.cell.topics.wrench, StreamKind.WRENCH.value, Quality.SAMPLES)
        alone = tuple({topic, output.relative})
        self._stream = self.add_stream(Stream(WRENCH, topic, limits, self.value("silent_after"), alone))
        self._forwards = self.resolve_topic_name(topic) != self.resolve_topic_name(output.relative)
        if self._forwards:
            self._publisher = self.create_publisher(output.message, output.relative, output.qos)
        self._recent: collections.deque[Sample] = collections.deque(maxlen=PRESENT_SAMPLES)
        self._published = 0  # stamp of the last sample in the present wrench, ns
        self._present = self.create_publisher(PRESENT_WRENCH.message, PRESENT_WRENCH.relative, PRESENT_WRENCH.qos)
        self._tare_events = self.create_publisher(TARE.message, TARE.relative, TARE.qos)
        self.add_source(topic, WRENCH_INPUTS[self.value("input_type")], self._on_wrench, raw=True)
        self.create_service(Tare, "~/tare", self._on_tare, callback_group=self.group)
        self.create_service(SelfTest, "~/self_test", self._on_self_test, callback_group=self.group)
        self.listen_to_joints()
        if self._forwards:  # a node that was started again has forgotten the tare of before
            self._publish_tare(0, self._bias, None, self.get_name(), "the node begins without a tare")

    def outputs(self) -> Sequence[Any]:
        """Return the publisher of the wrench."""
        return (self._publisher,) if self._forwards else ()

    def tolerance(self, stream: Stream) -> Float1D:  # noqa: ARG002  # there is one stream only
        """Return the (6,) change over a window that does not matter, N and N*m."""
        return np.repeat([SETTLED_FORCE, SETTLED_TORQUE], 3)

    def tare_number(self) -> int:
        """Return the number of the tare in force; 0: none."""
        return self._number

    def take(self) -> None:
        """Take what has come, and tell what pulls now."""
        super().take()
        self._publish_present()

    def _on_wrench(self, payload: bytes, arrived: float) -> None:
        sample = self.stamped(self._read(payload), arrived)
        sample = dataclasses.replace(sample, values=self._scale * sample.values - self._bias)
        if self._stream.take(sample, sample.stamp):
            if self._recent and sample.stamp < self._recent[-1].stamp:
                self._recent.clear()  # the sensor's clock went back
            self._recent.append(sample)
            if self._forwards:
                self._publisher.publish(self._serialised(sample))

    def _serialised(self, sample: Sample) -> bytes:
        frame, mould = self._mould
        if mould is None or sample.frame != frame:
            first = serialize_message(to_wrench_stamped(self.labelled(sample)))
            mould = Mould(StreamKind.WRENCH, first)
            self._mould = sample.frame, mould
        return mould.cast(sample.stamp, sample.values.tolist())

    def _publish_present(self) -> None:
        """Tell what pulls now, where anything has come: who looks at the load needs no sample of its own."""
        if not self._recent or self._recent[-1].stamp == self._published:
            return
        last = self._recent[-1]
        self._published, since = last.stamp, last.stamp - PRESENT * NANOSECONDS
        while self._recent[0].stamp < since:
            self._recent.popleft()
        mean = dataclasses.replace(last, values=np.mean([one.values for one in self._recent], axis=0))
        self._present.publish(to_wrench_stamped(self.labelled(mean)))

    # --- tare -------------------------------------------------------------------------------------------------

    async def _on_tare(self, request: Any, response: Any) -> Any:
        if not self._forwards:
            text = "the stream comes on the topic of recordings already: nothing can be subtracted from it"
            response.outcome = to_outcome(Outcome.NOT_AVAILABLE, text)
            return response
        number, bias, mean = 0, np.zeros(6), None
        if not request.clear:
            averaged = await self._averaged(response, lambda: self._unloaded(request))
            if averaged is None:
                return response
            mean, bias = averaged
            number = self._tares = self._tares + 1
        self._bias, self._number = bias, number
        self._recent.clear()  # a mean is of one tare
        response.event = self._publish_tare(number, bias, mean, request.requested_by, request.reason)
        response.outcome = to_outcome(Outcome.OK, "")
        return response

    def _unloaded(self, request: Any) -> tuple[Mean, Float1D]:
        """Average what the sensor says; return the mean and the untared wrench, (6,) N and N*m.

        Raises:
            MeasuringError: There is no mean, or a load pulls and nobody takes it upon himself by name.
            InputError: What is kept of the load cannot be read.
        """
        (mean,) = self.measure(self.asked((), request.window, request.timeout, 0))
        untared = self._bias + mean.average.mean
        if LoadCheck.possible(self.cell) and not (request.override and request.requested_by.strip()):
            file = memory_file(self.cell, self.get_namespace(), self.value("load_memory"))
            memory = LoadMemory(file)
            stood = self._stood(mean)
            unloaded = Unloaded(LoadCheck(self.cell, DEFAULT_TOLERANCES), self.cell, memory.zeros)
            fault = f"a load may be on since {memory.left}" if memory.left else ""
            if len(stood.q):
                fault = unloaded.fault(stood.q.mean(axis=0), untared) or fault
            if fault:
                text = f"{fault}; no tare is taken under load: release it, or override with your name in requested_by"
                raise MeasuringError(Outcome.NOT_REACHED, text)
        return mean, untared

    def _publish_tare(self, number: int, bias: Float1D, mean: Mean | None, who: str, why: str) -> TareEvent:
        header = to_header(self.now_ns(), mean.frame if mean else self._stream.frame)
        event: TareEvent = to_tare(header, number, bias, mean, who, why)
        self._tare_events.publish(event)
        self.get_logger().info(f"tare {number}: bias {np.round(bias, 3).tolist()} ({who})")
        return event

    async def _averaged(self, response: Any, work: Callable[[], T]) -> T | None:
        """Do what averages, beside the executor; with None, the response says why there is nothing."""
        if self._busy:
            response.outcome = to_outcome(Outcome.BUSY, "a tare or test is under way")
            return None
        self._busy = True
        try:
            return await Background(self, work)
        except MeasuringError as error:
            response.outcome = to_outcome(error.code, str(error))
        except InputError as error:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, str(error))
        finally:
            self._busy = False
        return None

    def _stood(self, mean: Mean) -> Stood:
        """Return where the robot stood while a mean was taken; joint states of its last moment may still come."""
        end = time.monotonic() + JOINTS_WAIT
        while self.joints.until < mean.end and time.monotonic() < end:
            time.sleep(POLL)
        return Stood(mean.begin, mean.end, *self.joints.between(mean.begin, mean.end))

    # --- test with a known mass -------------------------------------------------------------------------------

    async def _on_self_test(self, request: Any, response: Any) -> Any:
        if request.command == SelfTest.Request.CLEAR:
            self._orientations.clear()
            response.outcome = to_outcome(Outcome.OK, "")
        elif request.command == SelfTest.Request.ADD:
            orientation = await self._averaged(response, self._orientation)
            if orientation is not None:
                self._orientations.append(orientation)
                response.outcome = to_outcome(Outcome.OK, "")
        elif request.command == SelfTest.Request.EVALUATE:
            self._evaluate(request, response)
        else:
            text = f"found command {request.command}, expected ADD, EVALUATE or CLEAR"
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, text)
        response.orientations = len(self._orientations)
        return response

    def _orientation(self) -> tuple[Float1D, Float1D]:
        """Average what the sensor says; return it untared, (6,) N and N*m, with gravity in its axes, (3,) m/s^2.

        Raises:
            MeasuringError: There is no mean, or the robot was not seen to stand all the time that it was taken.
            InputError: The cell file does not say how the sensor is mounted.
        """
        (mean,) = self.measure(self.asked((), 0.0, 0.0, 0))
        stood = self._stood(mean)
        fault = movement_fault(stood, self.cell.robot.joints)
        if fault:
            raise MeasuringError(Outcome.NOT_SETTLED if len(stood.q) else Outcome.NO_DATA, fault)
        return mean.average.mean + self._bias, gravity_in_sensor(self.cell, stood.q.mean(axis=0))

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
        faults = found.faults(request.mass, mass_share=MASS_SHARE, angle=AXES, force=UNEXPLAINED)
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
