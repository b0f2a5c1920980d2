"""What the nodes of the instruments share: streams, their health, and averages over a settled window."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType

from calibration.asks import wait_until
from calibration.conversions import JointReader, Mean, Sample, stamp_ns, to_average, to_header, to_outcome
from calibration.instruments.stream import Source, Stream
from calibration.motion.arrival import ArrivalRules, Joints
from calibration.node import CalibrationNode, Declared
from calibration.rclpy_gaps import Background
from calibration.topics import SAMPLE_CHECK, Quality, Topic
from calibration_core.cell import Cell, load_cell
from calibration_core.observations.samples import Limits, Problem
from calibration_core.observations.window import SettledWindow, Waiting
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.timeseries import NANOSECONDS, Float1D

LISTENERS_WAIT = 2.0  # s of wall time from the start, in which nothing is averaged that nobody hears
TICK = 0.02  # s of wall time after which what has come is taken
LOOK = 0.1  # s of wall time between looks at publishers and problems
REPORT = 10  # looks between two reports of a stream whose health has not changed
POLL = 0.005  # s of wall time between looks at an average
GIVEN_UP = 1.0  # s of wall time, averages under way have to end
CLOCK_STANDS = 10.0  # s of wall time without progress of the node's clock
SENDER, RECEIVE = "sender", "receive"

COMMON = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("frame", "", "frame_id that samples must carry; empty: any."),
    Declared("output_frame", "", "frame_id of what is published; empty: as it came."),
    Declared("stamp", SENDER, "Time of a sample.", choices=(SENDER, RECEIVE)),
    Declared("gap", 1.5, "Intervals from which samples count as missing.", low=1.01),
    Declared("frozen", 20, "Identical samples in a row from which the stream counts as frozen; 0: never.", low=0),
    Declared("silent_after", 0.5, "Wall time without a sample after which the stream counts as silent, s.", low=0.01),
    Declared("window", 1.0, "Length of an average, s.", low=0.001, read_only=False),
    Declared("timeout", 20.0, "Longest wait for a settled window, s.", low=0.01, read_only=False),
    Declared("min_samples", 20, "Samples that an average must have.", low=1, read_only=False),
)


class MeasuringError(Exception):
    """No average came about.

    Attributes:
        code: One of the constants of `Outcome`.
    """

    def __init__(self, code: int, text: str) -> None:
        """Keep the code; the text is for a person."""
        self.code = code
        super().__init__(text)


@dataclasses.dataclass(frozen=True)
class Request:
    """What is to be averaged: streams, window and timeout in s, samples at least, first stamp that counts, ns.

    In `excluded` stand points that an operator has left out meanwhile, with by whom and why.
    """

    streams: tuple[Stream, ...]
    window: float
    timeout: float
    min_samples: int
    since: int = 0
    excluded: dict[str, str] = dataclasses.field(default_factory=dict)


class AcquisitionNode(CalibrationNode):
    """Checks the samples of an instrument, publishes those that pass, and averages on request (`~/measure`).

    Attributes:
        cell: The cell.
        streams: Name -> stream.
        joints: The joint states, where the instrument needs them.
    """

    def __init__(self, name: str, parameters: Sequence[Declared], **kwargs: Any) -> None:
        """Make the node; subclasses add streams and sources in `on_start`."""
        super().__init__(name, (*COMMON, *parameters), **kwargs)

    def on_start(self) -> None:
        """Read the cell, have the streams made, look for their sources, and report how they are from now on."""
        self.cell: Cell = load_cell(self.value("cell"))
        self.streams: dict[str, Stream] = {}
        self.joints = Joints(ArrivalRules())
        self._sender_stamps = self.value("stamp") != RECEIVE
        self._sources: dict[str, Source] = {}
        self._looks = 0
        self._reported: dict[str, Problem] = {}
        self.group = ReentrantCallbackGroup()
        self._checks = self.create_publisher(SAMPLE_CHECK.message, SAMPLE_CHECK.relative, SAMPLE_CHECK.qos)
        self._measure = self.create_action_server(Measure, "~/measure", self._on_measure)
        self._averages: set[object] = set()  # under way, in threads of their own
        self.make_streams()
        self._alone_until = time.monotonic() + LISTENERS_WAIT
        for source in self._sources.values():
            source.look()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TICK, self.take, clock=steady)
        self.create_timer(LOOK, self._look, clock=steady)

    def make_streams(self) -> None:
        """Add streams and sources, and offer what is made of them."""
        raise NotImplementedError

    def on_end(self) -> None:
        """Wait until averages under way have given up: they look whether the node ends."""
        if not wait_until(lambda: not self._averages, GIVEN_UP):
            self.get_logger().error(f"an average is still being taken after {GIVEN_UP:g} s")

    def busy(self) -> str:
        """Say that an average is being taken: what it is taken with does not change meanwhile."""
        return "an average is being taken" if self._averages else ""

    def limits(self, largest: tuple[float, ...], fastest: tuple[float, ...]) -> Limits:
        """Return the limits of a stream from the parameters that all instruments share."""
        frozen = 0 if self.value("frozen") < 2 else self.value("frozen")
        return Limits(self.value("frame"), largest, fastest, frozen, gap=self.value("gap"))

    def add_stream(self, stream: Stream) -> Stream:
        """Take on a stream."""
        self.streams[stream.name] = stream
        return stream

    def add_source(self, topic: str, kind: str, callback: Callable[[Any, float], None], *, raw: bool = False) -> None:
        """Subscribe to a topic as soon as it is offered; see `Source`."""
        self._sources[topic] = Source(self, topic, kind, callback, raw=raw)

    def take(self) -> None:
        """Take what has come."""
        for source in self._sources.values():
            source.take()

    def listen_to_joints(self) -> None:
        """Subscribe to the joint states."""
        topic = Topic(self.cell.topics.joint_states, StreamKind.JOINTS.value, Quality.SAMPLES)
        reader = JointReader(self.cell.robot.joints)

        def take(payload: bytes, arrived: float) -> None:
            sample = reader.read(payload)
            if sample is not None:
                self.joints.add(sample[0] or self.arrival_ns(arrived), sample[1])

        self.add_source(topic.relative, topic.type, take, raw=True)

    def arrival_ns(self, arrived: float) -> int:
        """Return when something arrived by the node's clock, ns, given s of the steady clock."""
        return self.now_ns() - round((time.monotonic() - arrived) * NANOSECONDS)

    def stamped(self, sample: Sample, arrived: float) -> Sample:
        """Return a sample with the time that it is published with; it arrived at so many s of the steady clock."""
        usable = sample.stamp != 0 and self._sender_stamps
        return sample if usable else dataclasses.replace(sample, stamp=self.arrival_ns(arrived))

    def labelled(self, sample: Sample) -> Sample:
        """Return a sample with the frame that it is published in."""
        return dataclasses.replace(sample, frame=self.value("output_frame") or sample.frame)

    def tolerance(self, stream: Stream) -> Float1D:
        """Return the (k,) change over a window that does not matter."""
        raise NotImplementedError

    def tare_number(self) -> int:
        """Return the number of the tare in force; 0: none."""
        return 0

    def under_way(self) -> tuple[str, list[str]]:
        """Return the point that a beam is aimed at, and those that come after it."""
        return "", []

    def outputs(self) -> Sequence[Any]:
        """Return the publishers of what is measured."""
        raise NotImplementedError

    def _wait_for_listeners(self) -> None:
        """Let the recorder find a node that has just been started, or it would miss what is measured first."""
        while time.monotonic() < self._alone_until:
            if all(publisher.get_subscription_count() for publisher in self.outputs()):
                self._alone_until = -math.inf
            time.sleep(POLL)

    def _look(self) -> None:
        for source in self._sources.values():
            source.look()
        self._looks += 1
        for stream in self.streams.values():
            source_of = self._sources.get(stream.topic)
            stream.look(self, source_of.complaint if source_of else "")
            problem = stream.problem()
            if self._looks % REPORT and problem is self._reported.get(stream.name):
                continue
            self._reported[stream.name] = problem
            report = stream.report(to_header(self.now_ns()))
            self._checks.publish(report)
            level = 0 if problem is Problem.FINE else 2 if problem is not Problem.GAP else 1
            figures = {key: getattr(report, key) for key in ("received", "accepted", "gaps", "missing", "interval")}
            self.diagnostics.report(f"{stream.topic} ({stream.name})", level, report.text, figures)

    # --- averages ---------------------------------------------------------------------------------------------

    def asked(self, names: Sequence[str], window: float, timeout: float, min_samples: int) -> Request:
        """Return a request with the node's defaults where a number is zero.

        Raises:
            MeasuringError: A name is unknown or a number makes no sense.
        """
        unknown = [name for name in names if name not in self.streams]
        if unknown:
            text = f"found {unknown[0]!r}, expected one of {', '.join(self.streams)}"
            raise MeasuringError(Outcome.INPUT_UNUSABLE, text)
        if not (math.isfinite(window) and math.isfinite(timeout) and window >= 0 and timeout >= 0):
            text = f"found window {window}, timeout {timeout}, expected positive s"
            raise MeasuringError(Outcome.INPUT_UNUSABLE, text)
        return Request(
            tuple(self.streams[name] for name in names or self.streams),
            window or self.value("window"),
            timeout or self.value("timeout"),
            min_samples or self.value("min_samples"),
        )

    def measure(
        self,
        request: Request,
        cancelled: Callable[[], bool] = lambda: False,
        report: Callable[[float, str], None] = lambda _share, _text: None,
    ) -> list[Mean]:
        """Wait for a settled window of every stream; to be called beside the executor.

        Args:
            request: What to average.
            cancelled: Whether to give up.
            report: Gets the share done and what is waited for.

        Raises:
            MeasuringError: Cancelled, timed out, nothing arrived, or two publish what one alone may.
        """
        self._wait_for_listeners()
        token = object()
        self._averages.add(token)
        try:
            return self.measured(request, cancelled, report)
        finally:
            self._averages.discard(token)

    def measured(
        self, request: Request, cancelled: Callable[[], bool], report: Callable[[float, str], None]
    ) -> list[Mean]:
        """Do what `measure` says, once it is known that somebody listens."""
        running = [
            (stream, stream.start(request.window, self.tolerance(stream), request.min_samples, request.since))
            for stream in request.streams
        ]
        before = {stream.name: stream.check.counts.received for stream in request.streams}
        tare = self.tare_number()
        deadline = _Deadline(self.now_ns, request.timeout)
        try:
            while True:
                self._refuse(request, cancelled)
                states = [(stream, stream.state(averaging)) for stream, averaging in running]
                if all(isinstance(state, SettledWindow) for _, state in states):
                    break
                if deadline.passed():
                    raise _why_not(states, before)
                report(min(_share(state) for _, state in states), _waiting_for(states))
                time.sleep(POLL)
        finally:
            for stream, averaging in running:
                stream.end(averaging)
        if self.tare_number() != tare:
            raise MeasuringError(Outcome.NOT_SETTLED, "the sensor was tared meanwhile")
        return [
            Mean(stream.name, self.value("output_frame") or stream.frame, state.begin, state.end, state.average, tare)
            for stream, state in states
            if isinstance(state, SettledWindow)
        ]

    def turn(self, request: Request, cancelled: Callable[[], bool], awaited: Callable[[], str]) -> Callable[[], int]:
        """Return what waits a moment, within the request's timeout from now on, and returns the node's time, ns.

        It raises MeasuringError; `awaited` tells what is missing.
        """
        deadline = _Deadline(self.now_ns, request.timeout)

        def wait() -> int:
            self._refuse(request, cancelled)
            if deadline.passed():
                raise MeasuringError(Outcome.TIMED_OUT, f"{awaited()} (waited {request.timeout:g} s)")
            time.sleep(POLL)
            return self.now_ns()

        return wait

    def _refuse(self, request: Request, cancelled: Callable[[], bool]) -> None:
        """Raise MeasuringError where nobody wants the average any more, or nobody knows whose it would be."""
        if cancelled():
            raise MeasuringError(Outcome.CANCELLED, "cancelled")
        if self.ending.is_set():
            raise MeasuringError(Outcome.NOT_AVAILABLE, f"{self.get_name()} is being shut down")
        for stream in request.streams:
            problem, text = stream.outside
            if problem is Problem.TWO_SOURCES:
                raise MeasuringError(Outcome.NOT_AVAILABLE, f"{stream.name}: {text}")

    async def _on_measure(self, goal: Any) -> Any:
        last = (-math.inf, "")

        def report(share: float, text: str) -> None:
            nonlocal last
            if text != last[1] or time.monotonic() - last[0] >= 0.1:
                last, (point, left) = (time.monotonic(), text), self.under_way()
                known = Measure.Feedback(text=text, point=point, left=left, excluded=list(excluded))
                known.share_done = float(share)
                goal.publish_feedback(known)

        asked, excluded = goal.request, dict[str, str]()
        try:
            request = self.asked(asked.names, asked.window, asked.timeout, asked.min_samples)
            request = dataclasses.replace(request, since=stamp_ns(asked.since), excluded=excluded)
            means = await Background(
                self, lambda: self.measure(request, lambda: bool(goal.is_cancel_requested), report)
            )
        except MeasuringError as error:
            goal.canceled() if error.code == Outcome.CANCELLED else goal.abort()
            outcome, means = to_outcome(error.code, str(error)), []
        else:
            goal.succeed()
            outcome = to_outcome(Outcome.OK, "")
        return Measure.Result(
            outcome=outcome,
            averages=[to_average(mean) for mean in means],
            excluded=list(excluded),
            exclusions=list(excluded.values()),
        )


class _Deadline:
    """A timeout in the node's time that also passes if that time stands still."""

    def __init__(self, now: Callable[[], int], timeout: float) -> None:
        self._now = now
        self._end = now() + round(timeout * NANOSECONDS)
        self._seen, self._seen_at = now(), time.monotonic()

    def passed(self) -> bool:
        now = self._now()
        if now != self._seen:
            self._seen, self._seen_at = now, time.monotonic()
        return now >= self._end or time.monotonic() - self._seen_at > CLOCK_STANDS


def _share(state: SettledWindow | Waiting) -> float:
    return state.share if isinstance(state, Waiting) else 1.0


def _waiting_for(states: Sequence[tuple[Stream, SettledWindow | Waiting]]) -> str:
    words = [
        f"{stream.name} to settle" if state.moving else f"samples of {stream.name}"
        for stream, state in states
        if isinstance(state, Waiting)
    ]
    return "waiting for " + ", ".join(words)


def _why_not(states: Sequence[tuple[Stream, SettledWindow | Waiting]], before: dict[str, int]) -> MeasuringError:
    for stream, state in states:
        if not isinstance(state, Waiting):
            continue
        if stream.check.counts.received == before[stream.name]:
            return MeasuringError(Outcome.NO_DATA, f"{stream.name}: nothing arrived on {stream.topic}")
        problem = stream.problem().name.lower().replace("_", " ")
        if state.moving:
            return MeasuringError(Outcome.NOT_SETTLED, f"{stream.name}: still moves at the end of the time allowed")
        text = f"{stream.name}: {state.samples} samples without a break, {problem}"
        return MeasuringError(Outcome.TIMED_OUT, text)
    return MeasuringError(Outcome.TIMED_OUT, "not done within the time allowed")
