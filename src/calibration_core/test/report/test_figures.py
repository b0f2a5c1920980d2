"""Figures are well-formed, the same for the same data, small for large data, and show what they claim."""

from __future__ import annotations

import dataclasses
import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.identification.estimate import Identification
from calibration_core.report.document import Document
from calibration_core.report.figures import (
    grouped,
    grouped_rms,
    normality_figure,
    prediction_figure,
    residual_figure,
)
from calibration_core.report.sections.residuals import reach_of_rows
from calibration_core.report.space import plotly_script, space_scene
from calibration_core.report.space_figure import (
    deflection_scale,
    evenly,
    force_scale,
    hull_outline,
    reach,
)
from calibration_core.report.style import drawable, thinned

Case = tuple[Identification, Cell]


@pytest.mark.parametrize("name", ["loaded", "absolute", "hostile"])
def test_well_formed_without_scripts_dates_or_outside_references(name: str, documents: dict[str, Document]) -> None:
    figures = documents[name].figures()
    assert {figure.key for figure in figures} >= {"residuals", "prediction", "normality", "correlation", "space"}
    for svg in (figure.svg for figure in figures):
        root = ET.fromstring(svg)
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert not [element for element in root.iter() if element.tag.endswith(("script", "image", "foreignObject"))]
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


def test_evenly_spaced_rows_include_both_ends() -> None:
    rows = evenly(11_911, 60)
    assert len(rows) == 60
    assert (rows[0], rows[-1]) == (0, 11_910)
    np.testing.assert_array_equal(evenly(3, 60), [0, 1, 2])


def test_scene_holds_every_configuration_and_point(loaded: Identification) -> None:
    scene = json.loads(space_scene(loaded.space))
    names = [trace["name"] for trace in scene["data"]]
    factor = deflection_scale(loaded.space)
    assert names[:6] == ["robot", "point mp1", "point mp2", "point mp3", "force", f"deflection × {factor:g}"]
    arms = scene["data"][0]
    assert len(arms["x"]) == 18 * (loaded.space.joint_origins.shape[1] + 1)
    np.testing.assert_allclose(scene["data"][1]["z"], loaded.space.points["mp1"][:, 2], atol=1e-4)


def test_scene_shows_tracker_beams_and_boxes_where_they_are_known(loaded: Identification) -> None:
    bare = {trace["name"] for trace in json.loads(space_scene(loaded.space))["data"]}
    assert not bare & {"tracker", "beams", "boxes"}
    corners = np.array([[(x, y, z) for z in (0.0, 1.0) for y in (0.0, 2.0) for x in (0.0, 3.0)]])
    space = dataclasses.replace(loaded.space, tracker=np.array([4.0, 1.0, 1.2]), boxes=corners)
    traces = {trace["name"]: trace for trace in json.loads(space_scene(space))["data"]}
    assert [traces["tracker"][axis] for axis in "xyz"] == [[4.0], [1.0], [1.2]]
    assert traces["beams"]["x"][0] == 4.0
    assert traces["beams"]["x"].count(4.0) == 18 * 3
    assert len(traces["boxes"]["i"]) == 12  # two triangles per face


def test_scene_cannot_leave_its_script(hostile: Case) -> None:
    scene = space_scene(hostile[0].space)
    assert not set("<>&") & set(scene)
    names = [trace["name"] for trace in json.loads(scene)["data"]]
    assert any("&lt;/script&gt;" in name for name in names)


def test_scene_of_coplanar_points_has_no_outline(absolute: Identification) -> None:
    flat = {"target": np.asarray(absolute.space.points["target"]) * [1, 1, 0]}
    scene = json.loads(space_scene(dataclasses.replace(absolute.space, points=flat)))
    assert "mesh3d" not in [trace["type"] for trace in scene["data"]]


def test_plotly_is_the_installed_one() -> None:
    assert "Plotly" in plotly_script()
    assert "</script" not in plotly_script()


def test_names_are_drawn_with_the_glyphs_there_are() -> None:
    assert drawable("joint_1") == "joint_1"
    assert drawable("θ \U0001f916 \x07") == "θ □ □"
    assert drawable("a" * 30) == "a" * 21 + "…"
