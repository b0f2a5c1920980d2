"""Node `tracker`: points of a laser tracker or a camera system, checked, in metres, on the topics of recordings."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from calibration.conversions import LENGTH_UNITS, POINT_INPUTS, TF_TYPE, Sample, to_point_stamped, transforms
from calibration.instruments.acquisition import AcquisitionNode
from calibration.instruments.stream import Stream
from calibration.node import Declared, ParameterError, run
from calibration.topics import Topic, contract_topics
from calibration_core.timeseries import Float1D

TF = "tf"

PARAMETERS = (
    Declared("points", [], "Measurement points; empty: all of the cell."),
    Declared("topics", [], "Topic of each point, for tf the child frame; empty: input/POINT."),
    Declared("input_type", "PointStamped", "What the tracker sends.", choices=(*POINT_INPUTS, TF)),
    Declared("tf_topic", "/tf", "Where transforms come from, for tf."),
    Declared("units", "m", "Unit of the samples.", choices=tuple(LENGTH_UNITS)),
    Declared("largest", 80.0, "Distance from the tracker beyond which a sample is implausible, m.", low=0.001),
    Declared("fastest", 6.0, "Speed beyond which a sample is a jump, m/s; 0: not checked.", low=0.0),
    Declared("tolerance", 6.0e-5, "Change over a window that does not matter, m.", low=0.0, read_only=False),
)


class TrackerNode(AcquisitionNode):
    """Publishes `tracker/POINT` for each point; a topic that is that one already is only checked."""

    OWNER = "tracker"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node."""
        super().__init__("tracker", PARAMETERS, **kwargs)

    def on_configure(self) -> None:
        """Make one stream per point."""
        super().on_configure()
        names: list[str] = self.value("points") or list(self.cell.points)
        topics: list[str] = self.value("topics") or [f"input/{name}" for name in names]
        self._check_names(names, topics)
        self._unit = LENGTH_UNITS[self.value("units")]
        self._outputs: dict[str, Any] = {}
        contract = {topic.name: topic for topic in contract_topics(self.cell)}
        outputs = {name: contract[self.cell.topics.point(name)] for name in names}
        self._alone: dict[str, tuple[str, ...]] = {name: (output.relative,) for name, output in outputs.items()}
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
        self.add_source(topic, kind, lambda message: self._take(stream, read(message, self._unit)))

    def _listen_to_transforms(self, names: Sequence[str], frames: Sequence[str]) -> None:
        topic = self.value("tf_topic")
        targets = dict(zip(frames, names, strict=True))
        for name in names:
            self._stream(name, topic)
        self.add_source(topic, TF_TYPE, partial(self._on_transforms, targets))

    def _on_transforms(self, targets: dict[str, str], message: Any) -> None:
        for name, sample in transforms(message, targets, self._unit).items():
            self._take(self.streams[name], sample)

    def _stream(self, name: str, topic: str) -> Stream:
        limits = self.limits((self.value("largest"),), (self.value("fastest"),))
        return self.add_stream(Stream(name, topic, limits, self.value("silent_after"), self._alone[name]))

    def _publish_on(self, name: str, output: Topic) -> None:
        if self.resolve_topic_name(self.streams[name].topic) != self.resolve_topic_name(output.relative):
            self._outputs[name] = self.create_publisher(output.message, output.relative, output.qos)

    def _take(self, stream: Stream, sample: Sample) -> None:
        sample = self.stamped(sample)
        if stream.take(sample, sample.stamp) and stream.name in self._outputs:
            self._outputs[stream.name].publish(to_point_stamped(self.labelled(sample)))

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
