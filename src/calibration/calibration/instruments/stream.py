"""One incoming stream: subscribed with the quality that is offered, checked sample by sample, averaged on request."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from calibration_interfaces.msg import SampleCheck
from rclpy.node import Node

from calibration.conversions import Sample
from calibration.rclpy_gaps import Waiting as Messages
from calibration.topics import (
    SAMPLES_DEPTH,
    incompatible,
    message_class,
    several_publishers,
    subscription_profile,
)
from calibration_core.errors import InputError
from calibration_core.observations.samples import Limits, Problem, StreamCheck
from calibration_core.observations.window import Averaging, SettledWindow, Waiting
from calibration_core.timeseries import Float1D

PROBLEM_STAYS = 1.0  # s for which the last problem is told after samples are fine again


class Source:
    """A subscription that adapts to what is offered: made when a publisher is there, made anew if it cannot be heard.

    Attributes:
        name: Topic, as given.
        complaint: Why publishers cannot be heard, empty if they can.
    """

    def __init__(
        self, node: Node, name: str, kind: str, callback: Callable[[Any, float], None], *, raw: bool = False
    ) -> None:
        """Prepare; `look` subscribes, once there is a publisher.

        Args:
            node: The node.
            name: Topic.
            kind: Message type, `package/msg/Name`.
            callback: What gets the messages, and when they arrived, s of the steady clock.
            raw: Whether messages stay bytes, as CDR.

        Raises:
            InputError: The package of the message is not installed.
        """
        self.name = name
        self.complaint = ""
        self._node, self._type, self._callback, self._raw = node, _installed(name, kind), callback, raw
        self._messages: Messages | None = None
        self._profile: Any = None

    def look(self) -> None:
        """Subscribe once somebody publishes; subscribe anew if a publisher cannot be heard."""
        if not self._node.get_publishers_info_by_topic(self.name):
            return
        if self._messages is not None:
            self.complaint = "; ".join(incompatible(self._node, self.name, self._profile))
            if not self.complaint:
                return
            self._node.destroy_subscription(self._messages.subscription)
        self._profile = subscription_profile(self._node, self.name)
        self._messages = Messages(self._node, self._type, self.name, self._profile, raw=self._raw)

    def take(self) -> None:
        """Hand over what has come."""
        if self._messages is not None:
            for message, arrived, _ in self._messages.arrivals(SAMPLES_DEPTH):
                self._callback(message, arrived)


def _installed(topic: str, kind: str) -> Any:
    """Import a message class; what is missing is named with the package that brings it."""
    package = kind.partition("/")[0]
    try:
        return message_class(kind)
    except ModuleNotFoundError:
        expected = f"the package ros-jazzy-{package.replace('_', '-')}, to be installed"
        raise InputError(topic, kind, f"no package {package}", expected) from None


class Stream:
    """The samples of one measurement point or of the wrench.

    Attributes:
        name: Measurement point, or `wrench`.
        topic: Where the samples come from.
        check: The checks and their counts.
        frame: Frame of the last sample that passed.
        remark: What is to be said of it besides.
        alone: Topics that only one node may publish: of two, nobody knows which one speaks of the instrument.
        outside: What is wrong with those who publish, whatever they send, and words about it.
    """

    def __init__(self, name: str, topic: str, limits: Limits, silent_after: float, alone: tuple[str, ...] = ()) -> None:
        """Start without samples.

        Args:
            name: Measurement point, or `wrench`.
            topic: Where the samples come from.
            limits: What is expected of them.
            silent_after: s without a sample after which the stream counts as silent; infinite: never.
            alone: Topics that only one node may publish.
        """
        self.name, self.topic, self.alone = name, topic, alone
        self.outside = (Problem.FINE, "")
        self.check = StreamCheck(limits)
        self.frame = self.remark = ""
        self._silent_after = silent_after
        self._arrived = -math.inf
        self._problem, self._problem_at = Problem.FINE, -math.inf
        self._averagings: list[Averaging] = []
        self._lock = threading.Lock()
        self._latest: Sample | None = None

    def take(self, sample: Sample, stamp: int, *, timed: bool = True) -> bool:
        """Check a sample and hand it to the averages under way; say whether it may be used.

        Args:
            sample: The sample, in SI units.
            stamp: Its time, ns.
            timed: Whether that is when it was taken; otherwise no average gets it.
        """
        self._arrived = time.monotonic()
        problem = self.check.add(stamp, sample.values, sample.frame, sample.rotation)
        if problem is not Problem.FINE or self.check.gap_before:
            self._problem, self._problem_at = problem or Problem.GAP, self._arrived
        with self._lock:
            for one in self._averagings:
                if problem is not Problem.FINE or self.check.break_before:
                    one.break_off()
                if problem is Problem.FINE and timed:
                    one.add(stamp, sample.values)
        if problem is Problem.FINE:
            self.frame = sample.frame
        return problem is Problem.FINE

    def restart(self) -> None:
        """Begin anew with the next sample: stamps count otherwise from there on, and no average reaches across."""
        with self._lock:
            for one in self._averagings:
                one.break_off()
        self.check.restart()

    @property
    def averaged(self) -> bool:
        """Whether an average is under way."""
        return bool(self._averagings)

    def start(self, window: float, tolerance: Float1D, min_samples: int, since: int = 0) -> Averaging:
        """Begin an average of the samples that arrive from now on, those stamped before `since`, ns, left out."""
        one = Averaging(since, window, tolerance, min_samples)
        with self._lock:
            self._averagings.append(one)
        return one

    def state(self, averaging: Averaging) -> SettledWindow | Waiting:
        """Return how an average stands."""
        with self._lock:
            return averaging.state()

    def end(self, averaging: Averaging) -> None:
        """End an average."""
        with self._lock:
            self._averagings.remove(averaging)

    def age(self) -> float:
        """Return s since the last sample arrived; NaN if none has."""
        return time.monotonic() - self._arrived if math.isfinite(self._arrived) else math.nan

    def look(self, node: Node, complaint: str) -> None:
        """See who publishes; `complaint` says why they cannot be heard, empty if they can."""
        several = "; ".join(filter(None, [several_publishers(node, topic) for topic in self.alone]))
        if several:
            self.outside = Problem.TWO_SOURCES, several
        else:
            self.outside = (Problem.INCOMPATIBLE_QOS, complaint) if complaint else (Problem.FINE, "")

    def problem(self) -> Problem:
        """Return the worst that can be said of the stream now."""
        if self.outside[0] is not Problem.FINE:
            return self.outside[0]
        if math.isfinite(self._silent_after) and not self.age() <= self._silent_after:
            return Problem.SILENT
        return self._problem if time.monotonic() - self._problem_at < PROBLEM_STAYS else Problem.FINE

    def report(self, header: Any) -> SampleCheck:
        """Return the health of the stream as a message."""
        counts, problem = self.check.counts, self.problem()
        rejected = counts.rejected
        return SampleCheck(
            header=header,
            topic=self.topic,
            name=self.name,
            problem=int(problem),
            received=counts.received,
            accepted=counts.accepted,
            not_finite=rejected.get(Problem.NOT_FINITE, 0),
            frozen=rejected.get(Problem.FROZEN, 0),
            jumps=rejected.get(Problem.JUMP, 0),
            wrong_frame=rejected.get(Problem.WRONG_FRAME, 0),
            implausible=rejected.get(Problem.IMPLAUSIBLE, 0),
            out_of_order=rejected.get(Problem.OUT_OF_ORDER, 0),
            gaps=counts.gaps,
            missing=counts.missing,
            interval=self.check.interval,
            age=self.age(),
            text="; ".join(filter(None, [self.outside[1] or problem.name.lower().replace("_", " "), self.remark])),
        )
