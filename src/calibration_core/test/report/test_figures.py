"""Figures are well-formed, the same for the same data, small for large data, and show what they claim."""

from __future__ import annotations

import dataclasses
import itertools
import json
from xml.etree import ElementTree as ET

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.document import Document
from calibration_core.report.figures import style
from calibration_core.report.figures.application import LEAST, errors_figure
from calibration_core.report.figures.identification import (
    grouped,
    grouped_rms,
    normality_figure,
    prediction_figure,
    residual_figure,
)
from calibration_core.report.figures.operating_space import (
    FLAT,
    deflection_scale,
    evenly,
    force_scale,
    hull_outline,
    reach,
)
from calibration_core.report.figures.style import STYLE, WIDTH, drawable, drawing, panels, parts, thinned
from calibration_core.report.sections.residuals import reach_of_rows
from calibration_core.report.view3d import script_safe
from calibration_core.report.view3d.space import space_view
from calibration_core.timeseries import Float2D

Case = tuple[Identification, Cell]


@pytest.mark.parametrize("name", ["loaded", "absolute", "hostile"])
def test_well_formed_without_scripts_dates_or_outside_references(name: str, documents: dict[str, Document]) -> None:
    figures = documents[name].figures()
    assert {figure.key for figure in figures} >= {"residuals", "prediction", "normality", "correlation", "space"}
    for svg in (figure.svg for figure in figures):
        root = ET.fromstring(svg)
        assert b"$" not in svg  # a formula that the fonts of the report do not set
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert not [element for element in root.iter() if element.tag.endswith(("script", "foreignObject"))]
        images = [element for element in root.iter() if element.tag.endswith("}image")]
        assert all(one.get("{http://www.w3.org/1999/xlink}href", "").startswith("data:image/png") for one in images)
        assert b"dc:date" not in svg


def test_large_recordings_give_small_figures(large_document: Document) -> None:
    sizes = {figure.key: len(figure.svg) for figure in large_document.figures()}
    assert max(sizes.values()) < 1_000_000, sizes


def test_residuals_can_all_be_excluded_but_one(loaded: Identification) -> None:
    excluded = np.ones(len(loaded.readings), dtype=bool)
    excluded[0] = False
    rows = dataclasses.replace(loaded.residuals, excluded=excluded)
    assert residual_figure(loaded.readings, rows, reach_of_rows(loaded)).startswith(b"<?xml")
    assert prediction_figure(rows, True).startswith(b"<?xml")
    assert normality_figure(rows).startswith(b"<?xml")


def test_grouped_rms_is_the_plain_one() -> None:
    rng = np.random.default_rng(4)
    configuration, values = rng.integers(3, 9, 200), rng.normal(size=(200, 3))
    numbers, level, largest = grouped_rms(configuration, values)
    for no, a, b in zip(numbers, level, largest, strict=True):
        mine = values[configuration == no]
        assert a == pytest.approx(np.sqrt(np.mean(mine**2)))
        assert b == pytest.approx(np.linalg.norm(mine, axis=1).max())


def test_thinning_keeps_the_largest() -> None:
    size = np.random.default_rng(5).normal(size=40_000) ** 2
    rows = thinned(size, 500)
    assert len(rows) <= 500
    assert set(np.argsort(-size)[:50]) <= set(rows.tolist())
    np.testing.assert_array_equal(thinned(size[:500], 500), np.arange(500))


def test_loads_are_grouped_by_level() -> None:
    load = np.array([600.0, 0.0, 1200.5, 0.3, 601.0, 2400.0, 1199.0])
    np.testing.assert_array_equal(grouped(load), [1, 0, 2, 0, 1, 3, 2])


def test_a_continuum_of_loads_is_cut_into_equal_numbers() -> None:
    load = np.random.default_rng(6).uniform(0, 1000, 800)
    group = grouped(load)
    np.testing.assert_array_equal(np.bincount(group), [100] * 8)
    assert all(load[group == k].max() <= load[group == k + 1].min() for k in range(7))
    assert len(grouped(np.zeros(0))) == 0
    np.testing.assert_array_equal(grouped(np.array([990.0, 1000.0, 995.0])), [0, 0, 0])


def test_arrows_have_sensible_lengths(loaded: Identification) -> None:
    space = loaded.space
    largest = np.linalg.norm(space.force, axis=1).max() * force_scale(space)
    assert largest == pytest.approx(0.2 * reach(space))
    factor = deflection_scale(space)
    assert f"{factor:.0e}"[0] in "125"
    drawn = np.linalg.norm(space.deflection, axis=1).max() * factor / reach(space)
    assert 0.06 < drawn <= 1 / 6 + 1e-12


def test_points_on_a_line_have_no_outline() -> None:
    assert len(hull_outline(np.outer(np.arange(5.0), [1.0, 2.0]))) == 0
    assert len(hull_outline(np.zeros((1, 2)))) == 0
    square = hull_outline(np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]]))
    assert len(square) == 5
    assert len(hull_outline(np.zeros((0, 2)))) == 0
    assert len(hull_outline(np.array([[0.0, 0.0], [1.0, 1e-12], [2.0, 0.0]]))) == 0


@given(arrays(np.float64, st.tuples(st.integers(3, 60), st.just(2)), elements=st.floats(-3.0, 3.0, width=16)))
def test_an_outline_is_the_convex_hull(points: Float2D) -> None:
    """As scipy finds it: the same area, closed, and nothing outside; what is as thin as a line has none."""
    outline, square = hull_outline(points), float(np.ptp(points, axis=0).max()) ** 2
    try:
        hull = ConvexHull(points)
    except QhullError:  # all on a line
        assert len(outline) == 0
        return
    if len(outline) == 0:
        assert hull.volume <= 2 * FLAT * square
        return
    assert np.array_equal(outline[0], outline[-1])
    x, y = (outline - outline[0]).T
    area = np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) / 2
    assert area == pytest.approx(hull.volume, rel=1e-9, abs=1e-14 * square)
    assert set(map(tuple, outline.tolist())) <= set(map(tuple, points.tolist()))
    for start, end in itertools.pairwise(outline):
        along, seen = end - start, points - start
        assert np.min(along[0] * seen[:, 1] - along[1] * seen[:, 0]) >= -1e-14 * square


def test_evenly_spaced_rows_include_both_ends() -> None:
    rows = evenly(11_911, 60)
    assert len(rows) == 60
    assert (rows[0], rows[-1]) == (0, 11_910)
    np.testing.assert_array_equal(evenly(3, 60), [0, 1, 2])


def test_the_view_holds_every_configuration_and_point(loaded: Identification, cell: Cell) -> None:
    view = space_view(loaded.space, cell)
    factor = deflection_scale(loaded.space)
    assert [name for name, _ in view.postures] == [str(number) for number in loaded.space.configuration]
    np.testing.assert_array_equal([q for _, q in view.postures], loaded.space.q)
    assert list(view.places) == ["mp1", "mp2", "mp3"]
    np.testing.assert_array_equal(view.places["mp1"], loaded.space.points["mp1"])
    assert [(kind.name, kind.note) for kind in view.kinds][1:] == [("deflection", f"× {factor:g}")]
    assert loaded.space.deflection is not None
    drawn = {arrow.posture: arrow.vector for arrow in view.arrows if arrow.kind == "deflection"}
    np.testing.assert_allclose([drawn[i] for i in range(18)], loaded.space.deflection * factor)


def test_the_view_shows_a_part_of_very_many_configurations(absolute: Identification, absolute_cell: Cell) -> None:
    rows = np.arange(5000) % len(absolute.space.q)
    many = dataclasses.replace(
        absolute.space, configuration=np.arange(5000), q=absolute.space.q[rows],
        points={name: places[rows] for name, places in absolute.space.points.items()},
    )  # fmt: skip
    view = space_view(many, absolute_cell)
    assert (len(view.postures), view.postures[-1][0], view.arrows) == (200, "4999", ())
    assert sum(len(places) for places in view.places.values()) <= 2000


def test_the_view_cannot_leave_its_script(hostile: Case) -> None:
    text = script_safe(space_view(hostile[0].space, hostile[1]).json())
    assert not set("<>&") & set(text)
    assert "</script>" in "".join(json.loads(text)["places"])


def test_names_are_drawn_with_the_glyphs_there_are() -> None:
    assert drawable("joint_1") == "joint_1"
    assert drawable("θ \U0001f916 \x07") == "θ □ □"
    assert drawable("a" * 30) == "a" * 21 + "…"


@settings(max_examples=25, deadline=None)
@given(
    size=st.tuples(st.floats(2.0, 6.7), st.floats(1.5, 4.0)),
    span=st.floats(1e-9, 1e9),
    name=st.text(st.characters(codec="ascii", categories=("L", "N")), max_size=22),
    legend=st.booleans(),
)
@example(size=(2.5, 2.0), span=727272728.0, name="00", legend=False)  # in another style its ticks are others
@example(size=(2.0, 2.0), span=0.029296875, name="00000", legend=False)  # where it comes to lie its ticks are others
def test_all_labels_of_a_diagram_lie_inside_its_figure(
    size: tuple[float, float], span: float, name: str, legend: bool
) -> None:
    width, height = size
    with drawing(height, width) as (figure, _):
        axes = figure.subplots()
        axes.plot([0.0, span], [-span, span], label="measured")
        axes.set(xlabel="x [m]", ylabel="y [m]", title="a)")
        axes.set_yticks([-span, 0.0, span], [name, "", name])
        if legend:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1))
    renderer = FigureCanvasAgg(figure).get_renderer()
    with mpl.rc_context(STYLE):  # the number of ticks follows the style's size of letters
        outer = axes.get_tightbbox(renderer, for_layout_only=True)
    room = np.array([outer.x0, outer.y0, figure.bbox.x1 - outer.x1, figure.bbox.y1 - outer.y1]) / figure.dpi
    assert np.all(room > 0.0), room  # inches
    assert np.all(room < 0.2), room


def test_diagrams_beside_each_other_are_one_drawing_and_can_be_shown_one_by_one() -> None:
    with panels((1.0, (-1, 3, -1)), (1.5, (2, 1))) as (axes, buffer):
        for diagram, name in zip(axes, ("first", "second", "third"), strict=True):
            diagram.set_title(name)
    whole = ET.fromstring(buffer.getvalue())
    assert whole.attrib["width"] == f"{72 * WIDTH:g}pt"
    assert whole.attrib["height"] == "180pt"
    places = [tuple(float(one.attrib[name]) for name in ("x", "y", "width", "height")) for one in whole]
    third = 72 * WIDTH / 3
    expected = [(0.6 * third, 0, 1.8 * third, 72), (0, 72, 2 * third, 108), (2 * third, 72, third, 108)]
    assert places == [pytest.approx(place, abs=0.01) for place in expected]
    found = parts(buffer.getvalue())
    assert [share for _, share in found] == pytest.approx([0.6, 2 / 3, 1 / 3], abs=1e-4)
    for (svg, _), name in zip(found, ("first", "second", "third"), strict=True):
        assert ET.fromstring(svg).tag.endswith("svg")
        assert f"<!-- {name} -->".encode() in svg
    with drawing(1.0, 3.0) as (_, single):
        pass
    assert parts(single.getvalue()) == [(single.getvalue(), pytest.approx(3.0 / WIDTH))]


def test_errors_stand_on_plain_numbers_and_whole_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """What iteration leaves, 1e-9 mm, stretches no axis, and powers of ten are written in full."""
    drawn: list[Figure] = []
    monkeypatch.setattr(style, "Figure", lambda **sizes: drawn.append(Figure(**sizes)) or drawn[-1])
    svg = errors_figure(np.full(3, 0.6), np.full(3, 1e-9), np.full(3, 0.006), ("row", "predicted with"))
    assert b"$" not in svg
    (axes,) = drawn[0].axes
    assert axes.get_ylim()[0] > LEAST / 10
    assert {label.get_text() for label in axes.get_yticklabels()} >= {"0.01", "0.1"}
    assert all(float(at).is_integer() for at in axes.get_xticks())
