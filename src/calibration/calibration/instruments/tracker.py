"""Node `tracker`: points of a laser tracker or a camera system, checked, in metres, on the topics of recordings.

With the driver `stream`, all points come by themselves, all the time; the others aim at one point after the other.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from calibration_interfaces.msg import Outcome, SessionEvent
from calibration_interfaces.srv import PointRequest

from calibration.conversions import (
    LENGTH_UNITS,
    POINT_INPUTS,
    TF_TYPE,
    Mean,
    Sample,
    to_header,
    to_outcome,
    to_point_stamped,
    transforms,
)
from calibration.instruments.acquisition import RECEIVE, SENDER, AcquisitionNode, MeasuringError, Request
from calibration.instruments.drivers import Driver
from calibration.instruments.drivers.emscon import Emscon
from calibration.instruments.drivers.line import Line, load_template
from calibration.instruments.drivers.written import Table, Typed
from calibration.instruments.one_beam import IDLE, OneBeam
from calibration.instruments.stream import Stream
from calibration.node import Declared, ParameterError, run
from calibration.topics import EVENT, TYPED, Topic, contract_topics
from calibration_core.measurement.aim import Aim
from calibration_core.measurement.sender_clock import ClockFromMotion
from calibration_core.recording.definitions.own import TRACKER_CLOCK
from calibration_core.timeseries import NANOSECONDS, Float1D

TF, STREAM, LINE, EMSCON, FILE, MANUAL = "tf", "stream", "line", "emscon", "file", "manual"
TF_TOPIC = "/tf"
SENDER_OFFSET = "sender_offset"
BEFORE, LONGEST = 1.0, 50.0  # s before a motion that belong to it, and after which it is looked at while it lasts
FASTEST = 6.0  # m/s, beyond which a sample is a jump: more than any robot's flange moves

PARAMETERS = (
    Declared("driver", STREAM, "How the tracker is asked.", choices=(STREAM, LINE, EMSCON, FILE, MANUAL)),
    Declared(
        "address", "127.0.0.1:7000", "Host and port: of the tracker's program, for line; of the tracker, for emscon."
    ),
    Declared("template", "plain", "How it speaks, for line: one of config/trackers, or a file."),
    Declared("table", "tracker.csv", "File to which the tracker's program appends, for file."),
    Declared(
        "stamp",
        SENDER,
        "Time of a sample; sender_offset: the sender's, corrected to the robot's clock, for stream.",
        choices=(SENDER, RECEIVE, SENDER_OFFSET),
    ),
    Declared("points", [], "Measurement points; empty: all of the cell."),
    Declared("topics", [], "Topic of each point, of `/tf` the child frame; empty: input/POINT."),
    Declared("input_type", "PointStamped", "What the tracker sends.", choices=(*POINT_INPUTS, TF)),
    Declared("units", "m", "Unit of the samples.", choices=tuple(LENGTH_UNITS)),
    Declared("largest", 80.0, "Distance from the tracker beyond which a sample is implausible, m.", low=0.001),
    Declared("tolerance", 6.0e-5, "Change over a window that does not matter, m.", low=0.0, read_only=False),
)


class TrackerNode(AcquisitionNode):
    """Publishes `tracker/POINT` for each point; a topic that is that one already is only checked."""

    OWNER = "tracker"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node."""
        super().__init__("tracker", PARAMETERS, **kwargs)

    def make_streams(self) -> None:
        """Make one stream per point."""
        names: list[str] = self.value("points") or list(self.cell.points)
        topics: list[str] = self.value("topics") or [f"input/{name}" for name in names]
        self._check_names(names, topics)
        self._unit = LENGTH_UNITS[self.value("units")]
        self._outputs: dict[str, Any] = {}
        contract = {topic.name: topic for topic in contract_topics(self.cell)}
        outputs = {name: contract[self.cell.topics.point(name)] for name in names}
        self._alone: dict[str, tuple[str, ...]] = {name: (output.relative,) for name, output in outputs.items()}
        self.beam: OneBeam | None = None
        self._own_clock = ClockFromMotion(self.cell) if self.value("stamp") == SENDER_OFFSET else None
        self._begun = 0  # stamp of the joint states, ns, at which the present motion was seen first; 0: none
        self._published, self._floor = dict[str, int](), dict[str, int]()  # stamps, ns: the last, and before a change
        self._timed = self._unstamped = False
        self._clock_reported = True  # there is nothing to report
        self.create_service(PointRequest, "~/point", self._on_point)
        if self.value("driver") != STREAM:
            if self._own_clock is not None:
                raise ParameterError(self.get_name(), "stamp", repr(SENDER_OFFSET), f"that with driver {STREAM} alone")
            self._aim_at(outputs)
            return
        if self._own_clock is not None:
            self.listen_to_joints()
            self._events = self.create_publisher(EVENT.message, EVENT.relative, EVENT.qos)
        if self.value("input_type") == TF:
            self._listen_to_transforms(names, topics)
        else:
            for name, topic in zip(names, topics, strict=True):
                self._listen(name, topic)
        for name, output in outputs.items():
            self._publish_on(name, output)

    def _check_names(self, names: Sequence[str], topics: Sequence[str]) -> None:
        unknown = [name for name in names if name not in self.cell.points]
        if unknown or len(set(names)) != len(names):
            found = repr(unknown[0]) if unknown else "a point twice"
            raise ParameterError(self.get_name(), "points", found, f"of {', '.join(self.cell.points)}, each once")
        if len(topics) != len(names):
            raise ParameterError(self.get_name(), "topics", f"{len(topics)} topics", f"{len(names)}, one per point")

    def _listen(self, name: str, topic: str) -> None:
        kind, read = POINT_INPUTS[self.value("input_type")]
        self._alone[name] = tuple({topic, *self._alone[name]})
        stream = self._stream(name, topic)
        self.add_source(topic, kind, lambda message, arrived: self._take(stream, read(message, self._unit), arrived))

    def _listen_to_transforms(self, names: Sequence[str], frames: Sequence[str]) -> None:
        targets = dict(zip(frames, names, strict=True))
        for name in names:
            self._stream(name, TF_TOPIC)
        self.add_source(TF_TOPIC, TF_TYPE, partial(self._on_transforms, targets))

    def _on_transforms(self, targets: dict[str, str], message: Any, arrived: float) -> None:
        for name, sample in transforms(message, targets, self._unit).items():
            self._take(self.streams[name], sample, arrived)

    def _stream(self, name: str, topic: str) -> Stream:
        limits = self.limits((self.value("largest"),), (FASTEST,))
        return self.add_stream(Stream(name, topic, limits, self.value("silent_after"), self._alone[name]))

    def _publish_on(self, name: str, output: Topic) -> None:
        if self.resolve_topic_name(self.streams[name].topic) != self.resolve_topic_name(output.relative):
            self._outputs[name] = self.create_publisher(output.message, output.relative, output.qos)
        elif self._own_clock is not None:
            expected = f"another, for what is corrected is published on {output.relative}"
            raise ParameterError(self.get_name(), "topics", repr(output.relative), expected)

    def _take(self, stream: Stream, sample: Sample, arrived: float) -> None:
        own, now, timed = sample.stamp, self.arrival_ns(arrived), True
        sample, self._unstamped = self.stamped(sample, arrived), not own
        clock = self._own_clock if own else None
        if clock is not None:
            stamp = clock.by_robot(own, now)
            timed = stamp is not None
            if timed != self._timed:
                self._time_anew(timed=timed)
            if stamp is not None and stamp <= self._floor.get(stream.name, 0):
                return  # before the clock was corrected otherwise, samples of that time were published
            sample = dataclasses.replace(sample, stamp=own if stamp is None else stamp)
        if not stream.take(sample, sample.stamp, timed=timed):
            return
        if clock is not None:
            clock.add(stream.name, own, now, sample.values)
        if timed and stream.name in self._outputs:
            self._published[stream.name] = sample.stamp
            self._outputs[stream.name].publish(to_point_stamped(self.labelled(sample)))

    # --- the tracker's own clock --------------------------------------------------------------------------------------

    def _look(self) -> None:
        if self._own_clock is not None:
            self._learn(self._own_clock)
            text, missing = self._own_clock.figures(self.now_ns()), self._clock_missing()
            self.diagnostics.report("clock", 1 if missing else 0, missing or "known", {"figures": text})
            for stream in self.streams.values():
                stream.remark = missing or text
        super()._look()

    def _learn(self, clock: ClockFromMotion) -> None:
        """Look whether a motion has ended that shows the clock; nothing changes while an average is taken."""
        joints = self.joints
        moving = joints.moving()
        if moving and not self._begun:
            self._begun = joints.until
        lasts = moving and joints.until - self._begun < LONGEST * NANOSECONDS
        if not self._begun or lasts or any(stream.averaged for stream in self.streams.values()):
            return
        begun, self._begun = self._begun - round(BEFORE * NANOSECONDS), 0
        if clock.learn(*joints.between(begun, joints.until)):
            self._time_anew(timed=True)
            self._clock_reported = False

    def _report_clock(self) -> None:
        """Have session and bag know how far the clock is off, with the first reading after it was learnt anew."""
        if self._own_clock is None or self._clock_reported:
            return
        self._clock_reported, now = True, self.now_ns()
        text = self._own_clock.figures(now)
        self._events.publish(SessionEvent(header=to_header(now), kind=TRACKER_CLOCK, source=self.get_name(), text=text))

    def _time_anew(self, *, timed: bool) -> None:
        """Have what comes from now on follow what was published: stamps are corrected otherwise, or not at all."""
        self._timed, self._floor = timed, dict(self._published)
        for stream in self.streams.values():
            stream.restart()

    def _clock_missing(self) -> str:
        return "" if self._own_clock is None or self._unstamped else self._own_clock.missing(self.now_ns())

    # --- one beam ---------------------------------------------------------------------------------------------

    def _aim_at(self, outputs: dict[str, Topic]) -> None:
        """Make the driver, and a stream per point that has no rate: it is measured when somebody asks for it."""
        self._driver = self._made_driver()
        limits = dataclasses.replace(self.limits((self.value("largest"),), (FASTEST,)), frame="", gap=1e9)
        for name, output in outputs.items():
            self.add_stream(Stream(name, self._driver.name, limits, math.inf, self._alone[name]))
            self._outputs[name] = self.create_publisher(output.message, output.relative, output.qos)
        frame = self.value("output_frame") or self.value("frame") or self.get_name()
        self.diagnostics.report("beam", 0, "")
        self.beam = OneBeam(Aim(self.cell), self._driver, self.joints, self.value("tolerance"), frame)
        self.listen_to_joints()
        if isinstance(self._driver, Typed):
            take = partial(self._on_typed, self._driver)
            self.create_subscription(TYPED.message, TYPED.relative, take, TYPED.qos)

    def _made_driver(self) -> Driver:
        kind, unit = self.value("driver"), LENGTH_UNITS[self.value("units")]
        if kind == FILE:
            return Table(Path(self.value("table")), unit)
        if kind == MANUAL:
            return Typed(self.resolve_topic_name(TYPED.relative), unit)
        host, _, port = self.value("address").rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise ParameterError(self.get_name(), "address", repr(self.value("address")), "host:port")
        if kind == EMSCON:
            return Emscon((host, int(port)))
        return Line((host, int(port)), load_template(self.value("template")))

    def on_end(self) -> None:
        """End averages under way, and close the driver."""
        super().on_end()
        if self.beam is not None:
            self.beam.close()

    def _on_typed(self, driver: Typed, message: Any) -> None:
        fault = driver.type(message.data)
        self.diagnostics.report("typed", 2 if fault else 0, fault)

    def _on_point(self, request: Any, response: Any) -> Any:
        """Take what an operator wants of a point, by name, and for a reason where it is left out."""
        who, reason, excludes = request.operator_name.strip(), request.reason.strip(), request.what == request.EXCLUDE
        if request.what not in (request.SKIP, request.REPEAT, request.EXCLUDE):
            fault = f"what: found {request.what}, expected one of the constants of PointRequest"
        elif not who:
            fault = "the name of who answers for it is missing"
        elif excludes and not reason:
            fault = "the reason is missing: say why the point is left out"
        else:
            fault = IDLE if self.beam is None else self.beam.ask(request.what, request.point, f"by {who}: {reason}")
        response.outcome = to_outcome(Outcome.INPUT_UNUSABLE if fault else Outcome.OK, fault)
        return response

    def under_way(self) -> tuple[str, list[str]]:
        """Return the point that the beam is aimed at, and those that come after it."""
        return super().under_way() if self.beam is None else self.beam.under_way

    def measured(
        self, request: Request, cancelled: Callable[[], bool], report: Callable[[float, str], None]
    ) -> list[Mean]:
        """Measure one point after the other where the beam has to be aimed."""
        beam = self.beam
        if beam is None:
            wait = self.turn(request, cancelled, self._clock_missing)
            while missing := self._clock_missing():
                report(0.0, missing)
                wait()
            means = super().measured(request, cancelled, report)
            self._report_clock()
            return means

        def report_progress(share: float, text: str) -> None:
            report(share, text)
            self.diagnostics.report("beam", 1 if self._driver.by_hand else 0, text)

        turn = partial(self.turn, request, cancelled, lambda: beam.awaited)
        try:
            means, samples = beam.measure(
                request.streams, request.window, request.since, turn, report_progress, request.excluded
            )
        except MeasuringError as error:
            self.diagnostics.report("beam", 0 if error.code == Outcome.CANCELLED else 2, str(error))
            raise
        self.diagnostics.report("beam", 0, "")
        for stream, sample in samples:
            self._outputs[stream.name].publish(to_point_stamped(sample))
        return means

    def outputs(self) -> Sequence[Any]:
        """Return the publishers of the points."""
        return tuple(self._outputs.values())

    def tolerance(self, stream: Stream) -> Float1D:  # noqa: ARG002  # the same for every point
        """Return the (3,) change over a window that does not matter, m."""
        return np.full(3, self.value("tolerance"))


def main(arguments: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(TrackerNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
