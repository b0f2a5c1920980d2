"""The figures of a diagnosis show the numbers they are given, in the units that their axes name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex

from calibration_core.diagnosis.comparison.result import PartDifference, StepByStep
from calibration_core.diagnosis.location import Dependence, JointShare, Level, Located
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.figures import diagnosis as diagnosis_figures
from calibration_core.report.figures.diagnosis import before_after_figure, comparison_figure, where_figure
from calibration_core.report.figures.style import ACCENT, INK, panels

Drawn = Callable[[], list[Axes]]


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Drawn:
    """Return the axes of the figure that was drawn last."""
    figures: list[list[Axes]] = []

    @contextmanager
    def kept(*rows: tuple[float, Sequence[float]]) -> Iterator[object]:
        with panels(*rows) as (axes, buffer):
            figures.append(axes)
            yield axes, buffer

    monkeypatch.setattr(diagnosis_figures, "panels", kept)

    def last() -> list[Axes]:
        return figures[-1]

    return last


def located(levels: int, shares: bool = True) -> Located:
    joints = (("joint_4", 0.8, 0.1), ("joint_1", 0.3, 0.3), ("joint_2", 0.2, 0.0), ("joint_3", 0.1, 0.05))
    steps = (0.0, 0.5, 1.0, 0.5, 0.0)[:levels]
    return Located(
        rms=4e-5,
        turn=1e-5,
        shift=2e-5,
        shares=tuple(JointShare(*joint) for joint in joints) if shares else (),
        dependences=tuple(Dependence(f"quantity {k}", 0.9 - 0.08 * k, 0.001 if k < 2 else 0.4) for k in range(10)),
        levels=tuple(Level(k, level, 6e-5 * level) for k, level in enumerate(steps)),
        memory=float("nan"),
        memory_chance=1.0,
        sentences=("One.",),
    )


@pytest.mark.parametrize("shares", [True, False], ids=["two diagrams", "one diagram"])
@pytest.mark.parametrize("levels", [2, 5])
def test_every_word_of_where_is_inside_and_apart(levels: int, shares: bool, drawn: Drawn) -> None:
    where_figure(located(levels, shares))
    for axes in drawn():
        figure = axes.get_figure(root=True)
        assert figure is not None
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
        legend, title = axes.get_legend(), axes._left_title  # type: ignore[attr-defined]
        for label in (one for one in (axes.xaxis.label, axes.yaxis.label, title) if one.get_text()):
            box = label.get_window_extent(renderer)
            assert box.x0 >= -1
            assert box.y0 >= -1
            assert box.x1 <= figure.bbox.width + 1
            assert box.y1 <= figure.bbox.height + 1
        if legend is not None and title.get_text():
            assert not legend.get_window_extent(renderer).overlaps(title.get_window_extent(renderer))


def test_before_and_after_are_drawn_for_every_configuration(loaded: Identification, drawn: Drawn) -> None:
    readings = loaded.readings
    numbers = np.unique(readings.configuration)
    size = 1e-5 * (1 + np.searchsorted(numbers, readings.configuration))
    before = np.column_stack([size, size, size])
    assert before_after_figure(readings, before, 0.1 * before, 2e-5).startswith(b"<?xml")
    left, right = drawn()
    first, second, noise = left.lines
    unit = 1e6 if "µm" in left.get_ylabel() else 1e3
    assert left.get_ylabel() == f"rms residual [{'µm' if unit == 1e6 else 'mm'}]"
    assert np.allclose(first.get_ydata(), unit * 1e-5 * np.arange(1, len(numbers) + 1))
    assert np.allclose(second.get_ydata(), 0.1 * np.asarray(first.get_ydata()))
    assert np.allclose(noise.get_ydata(), unit * 2e-5)
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["without findings", "with findings", "noise"]
    assert len(right.lines) == 2
    assert right.get_xlabel().startswith("length of residual [")
    assert right.get_ylabel() == "readings below [%]"
    longest, shortened = (float(np.max(line.get_xdata())) for line in right.lines)
    assert longest == pytest.approx(unit * np.sqrt(3) * size.max())
    assert shortened == pytest.approx(0.1 * longest)


def test_many_configurations_are_drawn_in_blocks(loaded: Identification, drawn: Drawn) -> None:
    rows = len(loaded.readings)
    many = loaded.readings.select(np.arange(1500) % rows)
    object.__setattr__(many, "configuration", np.arange(1500))
    before_after_figure(many, np.full((1500, 3), 2e-3), np.full((1500, 3), 1e-3), 1e-4)
    left, _ = drawn()
    assert left.get_ylabel() == "rms residual [mm]"
    assert "blocks of" in left.get_xlabel()
    assert len(left.lines[0].get_ydata()) == diagnosis_figures.MOST_CONFIGURATIONS
    assert np.allclose(left.lines[0].get_ydata(), 2.0)


def test_the_joint_that_explains_most_is_framed_and_bold(drawn: Drawn) -> None:
    where_figure(located(levels=5))
    left, right = drawn()
    names = [label.get_text() for label in left.get_yticklabels()]
    assert names == ["joint_1", "joint_2", "joint_3", "joint_4"]
    assert [label.get_fontweight() == "bold" for label in left.get_yticklabels()] == [False, False, False, True]
    widths = [bar.get_width() for bar in left.patches]
    assert widths == pytest.approx([30, 20, 10, 80, 30, 0, 5, 10, 80])
    framed = left.patches[-1]
    assert to_hex(framed.get_edgecolor()) == ACCENT
    assert framed.get_y() + framed.get_height() / 2 == pytest.approx(names.index("joint_4"))
    assert "[%]" in left.get_xlabel()
    assert right.get_xlabel() == "load [% of the full pull]"
    assert right.get_ylabel().endswith("[µm]")


def test_the_level_curve_parts_loading_from_what_follows(drawn: Drawn) -> None:
    where_figure(located(levels=5))
    _, right = drawn()
    loading, afterwards, proportional = right.lines
    assert np.allclose(loading.get_xdata(), [0, 50, 100])
    assert np.allclose(loading.get_ydata(), [0, 30, 60])
    assert np.allclose(afterwards.get_xdata(), [100, 50, 0])
    assert np.allclose(proportional.get_ydata(), [0, 60])


def test_without_load_levels_the_dependences_are_drawn_those_not_by_chance_filled(drawn: Drawn) -> None:
    where_figure(located(levels=2, shares=False))
    (only,) = drawn()
    assert len(only.patches) == diagnosis_figures.SHOWN_DEPENDENCES
    assert [to_hex(bar.get_facecolor()) == INK for bar in only.patches] == [True] * 2 + [False] * 6
    assert only.get_yticklabels()[0].get_text() == "quantity 0"
    assert only.patches[0].get_width() == pytest.approx(90)
    assert "[%]" in only.get_xlabel()


def test_the_comparison_stands_in_the_order_of_configurations_and_of_steps(drawn: Drawn) -> None:
    parts = tuple(PartDifference(str(k), 1e-5 * k, 2e-5 * k, 1e-4) for k in (12, 3, 2, 1))
    steps = tuple(PartDifference(str(k), 2e-5, 3e-5, 1e-4) for k in range(3))
    comparison_figure(StepByStep(3e-5, 1.5e-5, 1.0, parts, steps, ()))
    left, right = drawn()
    assert np.allclose(left.lines[0].get_ydata(), [10, 20, 30, 120])
    assert [label.get_text() for label in left.get_xticklabels()] == ["1", "2", "3", "12"]
    assert left.get_ylabel() == "recording − simulation, rms [µm]"
    assert np.allclose(right.lines[0].get_ydata(), 20)
    assert [axes.get_xlabel() for axes in (left, right)] == ["configuration", "step"]
    for axes in (left, right):
        assert np.allclose(axes.lines[-1].get_ydata(), 15)
