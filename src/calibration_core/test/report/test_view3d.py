"""A cell in space: what the program is handed, what it makes of it in a real browser, and the picture without it."""

from __future__ import annotations

import base64
import dataclasses
import html
import io
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from browser import dumped
from matplotlib.image import imread

import calibration_core as cal
from calibration_core.cell import load_cell
from calibration_core.model.chain import Mimic, rotation_x
from calibration_core.model.kinematics import posture
from calibration_core.report.figures.operating_space import deflection_scale
from calibration_core.report.view3d import Arrow, View, cell_view, page, script, script_safe
from calibration_core.report.view3d.picture import png
from calibration_core.report.view3d.solids import Solid, mesh_of, simplified
from calibration_core.report.view3d.space import space_view
from calibration_core.report.view3d.view import FORCE, ArrowKind

ROOT = Path(__file__).resolve().parents[4]
CELLS, BAG = ROOT / "config" / "cells", ROOT / "bags" / "small_loaded"
SMALL = CELLS / "small.cell.yaml"
RAIL = """
name: rail
robot:
  name: on a rail
  dh: [{a: 0.0, alpha: -1.57, d: 0.2}, {a: 0.3, alpha: 0.4, d: 0.1, theta: 0.3}, {a: 0.4, alpha: 0.0, d: 0.0}]
  joint_types: [prismatic, revolute, revolute]
  joints: [rail, a, b]
  joint_limits: [[0, 3], [-2, 2], [-2, 2]]
  rated_load: 5.0
frames: {tracker: {xyz: [3, 0, 1]}, measurement_points: {"<b>": [0.1, 0, 0], mp2: [0, 0.1, 0]}}
boxes: [{name: table, xyz: [1, 1, 0.4], size: [0.5, 0.4, 0.8]}]
instruments: {tracker: {sigma: 1.0e-5}}
"""


@pytest.fixture
def rail(tmp_path: Path) -> View:
    (tmp_path / "rail.yaml").write_text(RAIL)
    postures = [("1", np.array([0.5, 0.2, -0.4])), ("2", np.array([2.0, -1.0, 1.3]))]
    view = cell_view(load_cell(tmp_path / "rail.yaml"), postures)
    arrows = (Arrow("force", 0, np.zeros(3), np.array([0.0, 0.0, -0.2])),)
    kinds = (dataclasses.replace(FORCE, note="largest 50 N"), ArrowKind("left over", (1.0, 0.0, 0.0), shown=False))
    more = (Arrow("left over", 0, np.zeros(3), np.array([0.1, 0.0, 0.0])),)
    return dataclasses.replace(view, arrows=(*arrows, *more), kinds=kinds)


def test_the_program_is_small() -> None:
    assert len(script().encode()) <= 60_000
    assert "</" not in script()


def test_everything_of_the_cell_is_handed_over(rail: View) -> None:
    content = json.loads(json.dumps(rail.json(), allow_nan=False))
    assert [joint["prismatic"] for joint in content["joints"]] == [True, False, False]
    assert [one["q"] for one in content["postures"]] == [[0.5, 0.2, -0.4], [2.0, -1.0, 1.3]]
    assert content["tracker"] == [3, 0, 1]
    assert [box["name"] for box in content["boxes"]] == ["table"]
    assert [frame["name"] for frame in content["frames"]] == ["base", "flange", "tracker"]
    assert content["arrows"][0]["vector"] == [0, 0, -0.2]
    assert {solid["link"] for solid in content["solids"]} == {1, 2, 3}
    assert "<" not in script_safe(content)
    assert json.loads(script_safe(content)) == content


@pytest.fixture
def mimicking(rail: View) -> View:
    """Return the same view with a joint that mimics the second one, and one that mimics the third, behind it."""
    pose = {"rotation": rotation_x(0.3), "translation": np.array([0.1, 0.0, 0.2])}
    slides = Mimic("slides", 1, 1, 0.2, 0.05, **pose, prismatic=True)
    turns = Mimic("turns", 3, 2, -1.5, 0.4, **pose, prismatic=False)
    return dataclasses.replace(rail, chain=dataclasses.replace(rail.chain, mimics=(slides, turns)), solids=())


@pytest.mark.parametrize("kind", ["rail", "mimicking"])
def test_a_browser_places_the_robot_as_the_model_does(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    rail = request.getfixturevalue(kind)
    probe = """<script>
    const data = JSON.parse(document.getElementById("scene-data").textContent), places = [];
    const view = calibrationScene(document.createElement("div"), data);
    if (view) { for (const q of Q) { view.posture(q); places.push(view.flange()); } }
    document.title = view ? JSON.stringify(places) : "no WebGL";
    </script></body>"""
    q = [posture_[1] for posture_ in rail.postures]
    whole = page(rail).decode().replace("</body>", probe.replace("Q)", f"{[list(map(float, one)) for one in q]})"))
    (tmp_path / "page.html").write_text(whole, encoding="utf-8")
    body = dumped(tmp_path / "page.html", tmp_path)
    title = html.unescape(re.search(r"<title>(.*?)</title>", body, re.DOTALL).group(1))  # type: ignore[union-attr]
    if title == "no WebGL":
        pytest.skip("this Chromium has no WebGL")
    at = posture(rail.chain, np.array(q))
    for k, columns in enumerate(np.array(json.loads(title)).reshape(-1, 4, 4)):
        np.testing.assert_allclose(columns[:3, :3], at.flange[:, :, k], atol=2e-6)
        np.testing.assert_allclose(columns[3, :3], at.flange_origin[:, k], atol=2e-6)
    assert 'role="img"' in body
    assert "arrow keys" in body
    assert "&lt;b&gt;" in body  # a target's name stays a name
    for layer in ("robot", "tracker", "boxes", "force (largest 50 N)", "left over", "reset the view"):
        assert layer in body


def test_a_browser_draws_every_layer(rail: View, tmp_path: Path) -> None:
    """Hiding a layer changes the picture: what each colour stands for has been drawn."""
    probe = """<script>
    const data = JSON.parse(document.getElementById("scene-data").textContent), out = {};
    const place = document.body.appendChild(document.createElement("div")), view = calibrationScene(place, data);
    function ink() { view.paint(); return place.querySelector("canvas").toDataURL(); }
    if (view) {
      const whole = ink();
      for (const label of place.querySelectorAll("label")) {
        const tick = label.querySelector("input[type=checkbox]");
        if (!tick) { continue; }
        tick.click();
        out[label.textContent] = ink() !== whole;
        tick.click();
      }
      document.title = JSON.stringify([out, ink() === whole]);
    } else { document.title = "no WebGL"; }
    </script></body>"""
    (tmp_path / "page.html").write_text(page(rail).decode().replace("</body>", probe), encoding="utf-8")
    body = dumped(tmp_path / "page.html", tmp_path)
    title = html.unescape(re.search(r"<title>(.*?)</title>", body, re.DOTALL).group(1))  # type: ignore[union-attr]
    if title == "no WebGL":
        pytest.skip("this Chromium has no WebGL")
    changed, again = json.loads(title)
    assert again
    changed.pop("names")  # words, which are no part of the canvas
    expected = {"robot", "targets", "frames", "tracker", "boxes", "force (largest 50 N)", "left over"}
    assert changed == dict.fromkeys(expected, True)


def test_the_picture_shows_what_the_view_holds(rail: View) -> None:
    first = png(rail)
    assert first == png(rail)
    bare = imread(io.BytesIO(png(dataclasses.replace(rail, boxes=(), tracker=None))))
    whole = imread(io.BytesIO(first))
    assert np.mean(whole < 0.98) > 0.02
    assert whole.shape != bare.shape or np.any(whole != bare)


def test_a_tracker_far_away_is_named_and_not_drawn_to_scale(rail: View) -> None:
    near = imread(io.BytesIO(png(rail)))
    far = imread(io.BytesIO(png(dataclasses.replace(rail, tracker=np.array([4000.0, 0, 0])))))
    assert np.mean(far < 0.98) > 0.5 * np.mean(near < 0.98)


def test_meshes_are_made_simple_and_keep_their_shape() -> None:
    vertices, faces = mesh_of(Solid(0, "sphere", np.array([0.3]), np.eye(4)), sides=200)
    assert len(faces) > 3000
    kept, rows = simplified(vertices, faces, most=500)
    assert 100 < len(rows) <= 500
    np.testing.assert_allclose(np.ptp(kept, axis=0), 0.6, rtol=0.1)
    assert rows.max() < len(kept)
    same, all_rows = simplified(vertices, faces, most=len(faces))
    assert len(all_rows) == len(faces)
    np.testing.assert_array_equal(same, vertices)


def test_a_mesh_is_packed_to_a_grid_of_its_size(rail: View) -> None:
    vertices = np.array([[0.1, 0.2, 0.3], [1.1, 0.2, 0.3], [0.1, 1.7, 0.3], [0.1, 0.2, 0.9]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    solid = Solid(1, "mesh", np.zeros(0), np.eye(4), vertices, faces)
    content = dataclasses.replace(rail, solids=(solid,)).json()
    mesh = content["meshes"][content["solids"][0]["mesh"]]
    raw = base64.b64decode(mesh["vertices"])
    grid = np.array(struct.unpack(f"<{len(raw) // 2}H", raw)).reshape(-1, 3)
    np.testing.assert_allclose(np.array(mesh["low"]) + mesh["step"] * grid, vertices, atol=2e-5)
    assert base64.b64decode(mesh["faces"]) == struct.pack("<6H", 0, 1, 2, 0, 1, 3)


def test_a_urdf_without_its_meshes_is_drawn_all_the_same(tmp_path: Path) -> None:
    urdf = (CELLS.parent / "robots" / "kr240.urdf").read_text()
    shape = '<visual><geometry><mesh filename="package://x/meshes/gone.stl"/></geometry></visual>'
    (tmp_path / "robot.urdf").write_text(urdf.replace('<link name="link_2">', f'<link name="link_2">{shape}'))
    cell = (CELLS / "demo.cell.yaml").read_text().replace("../robots/kr240.urdf", "robot.urdf")
    (tmp_path / "cell.yaml").write_text(cell)
    view = cell_view(load_cell(tmp_path / "cell.yaml"))
    assert "gone.stl" in view.plain or "no bodies" in view.plain
    assert view.solids


def test_the_makers_bodies_are_drawn_where_there_are_some(tmp_path: Path) -> None:
    urdf = (CELLS.parent / "robots" / "kr240.urdf").read_text()
    shape = '<visual><origin xyz="0 0 0.5"/><geometry><box size="0.3 0.2 1.0"/></geometry></visual>'
    (tmp_path / "robot.urdf").write_text(urdf.replace('<link name="link_2">', f'<link name="link_2">{shape}'))
    cell = (CELLS / "demo.cell.yaml").read_text().replace("../robots/kr240.urdf", "robot.urdf")
    (tmp_path / "cell.yaml").write_text(cell)
    view = cell_view(load_cell(tmp_path / "cell.yaml"))
    assert view.plain == ""
    (solid,) = view.solids
    assert (solid.link, solid.form, solid.size.tolist()) == (2, "box", [0.3, 0.2, 1.0])


def test_the_robot_is_drawn_under_its_load_too(tmp_path: Path) -> None:
    """With the deflections the robot is shown a second time, its joints as far off as the arrows are long."""
    recording = cal.load_recording(BAG, cal.load_cell(SMALL))
    space = cal.identify(recording).identification.space
    assert space.joint_deflection is not None
    view = space_view(space, load_cell(SMALL))
    factor = deflection_scale(space)
    at = posture(view.chain, np.array(view.bent))
    first = next(iter(view.targets.values()))
    for k, (_, q) in enumerate(view.postures):
        np.testing.assert_allclose(view.bent[k] - q, factor * space.joint_deflection[k])
        arrow = next(one for one in view.arrows if one.kind == "deflection" and one.posture == k)
        way = at.point(first)[:, k] - arrow.start
        assert np.dot(way, arrow.vector) > 0.9 * np.linalg.norm(way) * np.linalg.norm(arrow.vector)
    probe = """<script>
    const data = JSON.parse(document.getElementById("scene-data").textContent), bare = structuredClone(data);
    bare.postures.forEach((one) => { delete one.bent; });
    const place = document.body.appendChild(document.createElement("div")), view = calibrationScene(place, data);
    function ink() { view.paint(); return place.querySelector("canvas").toDataURL(); }
    if (view) {
      const both = ink();
      view.scene(bare);
      document.title = JSON.stringify(ink() !== both);
    } else { document.title = "no WebGL"; }
    </script></body>"""
    (tmp_path / "page.html").write_text(page(view).decode().replace("</body>", probe), encoding="utf-8")
    body = dumped(tmp_path / "page.html", tmp_path)
    title = html.unescape(re.search(r"<title>(.*?)</title>", body, re.DOTALL).group(1))  # type: ignore[union-attr]
    if title == "no WebGL":
        pytest.skip("this Chromium has no WebGL")
    assert title == "true"
