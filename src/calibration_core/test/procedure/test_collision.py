"""Bodies touch where they should, a way is proven clear or is not, and beams meet what stands in them."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Box, Cell, load_cell
from calibration_core.errors import CellError, PlanError
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.space import Site, SpaceRules, joint_range, measurable, positions
from calibration_core.planning.loaded import PlanningRules, make_plan
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.route import stops

STRETCHED = np.array([0.0, 0.6, 0.3, 0.0, 0.6, 0.0])


def bodies_of(cell: Cell, *, floor: float | None = 0.0, **rules: object) -> CollisionModel:
    site = dataclasses.replace(Site.of(chain_of(cell), nominal_parameters(cell), cell), floor=floor)
    return CollisionModel.of(cell, site, SpaceRules(**rules))  # type: ignore[arg-type]


def with_box(cell: Cell, xyz: np.ndarray, size: tuple[float, float, float], rpy: tuple = (0.0, 0.0, 0.0)) -> Cell:
    box = Box(name="fixture", xyz=tuple(float(x) for x in xyz), size=size, rpy=rpy)
    return cell.model_copy(update={"boxes": (box,)})


def tool_of(cell: Cell, q: np.ndarray) -> np.ndarray:
    at = posture(chain_of(cell), q[None])
    return positions(at, nominal_parameters(cell).points["mp1"][None])[0, :, 0]


def test_a_box_at_the_tool_is_touched_and_named(demo_cell: Cell) -> None:
    free = bodies_of(demo_cell)
    assert free.clear(STRETCHED[None])[0]
    assert free.touching(STRETCHED) == ()
    at_tool = with_box(demo_cell, tool_of(demo_cell, STRETCHED), (0.2, 0.2, 0.2), (0.3, 0.2, 0.1))
    blocked = bodies_of(at_tool)
    assert not blocked.clear(STRETCHED[None])[0]
    assert any("fixture" in pair for pair in blocked.touching(STRETCHED))


@pytest.mark.parametrize(("gap", "clear"), [(0.025, False), (0.035, True)])
def test_the_safety_distance_is_kept(demo_cell: Cell, gap: float, clear: bool) -> None:
    """A plate beneath the lowest target, a given distance from its capsule."""
    points = nominal_parameters(demo_cell).points
    at = posture(chain_of(demo_cell), STRETCHED[None])
    handled = Site.of(chain_of(demo_cell), nominal_parameters(demo_cell), demo_cell).handled
    lowest = positions(at, handled)[:, 2, 0].min() - 0.02
    middle = tool_of(demo_cell, STRETCHED)
    plate = with_box(demo_cell, np.array([*middle[:2], lowest - gap - 0.05]), (0.6, 0.6, 0.1))
    assert bodies_of(plate, distance=0.03).clear(STRETCHED[None])[0] is np.bool_(clear)
    assert len(points) == 3


def test_floor_and_self(demo_cell: Cell) -> None:
    down = np.array([0.0, 1.4, 0.9, 0.0, 0.6, 0.0])
    folded = np.array([0.0, -0.8, 1.1, 0.0, 2.1, 0.0])
    assert any("floor" in pair for pair in bodies_of(demo_cell, floor=0.0).touching(down))
    assert not any("floor" in pair for pair in bodies_of(demo_cell, floor=None).touching(down))
    assert bodies_of(demo_cell, floor=None).clear(STRETCHED[None])[0]
    backwards = np.array([0.0, 0.0, -3.6, 0.0, 0.0, 0.0])  # the forearm swings back along the upper arm
    assert bodies_of(demo_cell, floor=None).touching(backwards) or bodies_of(demo_cell, floor=None).touching(folded)


def test_a_way_through_a_thin_wall_is_never_called_clear(demo_cell: Cell) -> None:
    """However thin the wall: postures are checked so densely that nothing slips through."""
    swing = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    start, end = STRETCHED - swing, STRETCHED + swing
    assert bodies_of(demo_cell).clear_way(start, end)
    wall = with_box(demo_cell, np.array([2.2, 0.0, 1.5]), (1.6, 0.001, 3.0))
    bodies = bodies_of(wall)
    assert bodies.clear(np.stack([start, end])).all()
    assert not bodies.clear_way(start, end)
    assert not bodies.clear_way(end, start)


def test_no_body_moves_farther_than_the_sweep_says(demo_cell: Cell) -> None:
    import pinocchio as pin

    bodies = bodies_of(demo_cell)
    chain, rng = bodies.site.chain, np.random.default_rng(5)
    data, found = bodies.model.createData(), bodies.geometry.createData()
    for _ in range(50):
        q = rng.uniform(*joint_range(chain, bodies.rules))
        step = 1e-4 * rng.normal(size=chain.n)
        placed = []
        for row in (q, q + step):
            pin.updateGeometryPlacements(bodies.model, data, bodies.geometry, found, row)
            placed.append([pose.act(np.array([0.05, 0.05, 0.2])) for pose in found.oMg[: len(found.oMg) - 1]])
        moved = np.linalg.norm(np.array(placed[1]) - np.array(placed[0]), axis=1)
        assert moved.max() <= np.abs(step) @ bodies.sweep + 1e-9


def test_beams(demo_cell: Cell) -> None:
    free = bodies_of(demo_cell)
    q = np.random.default_rng(1).uniform(*joint_range(free.site.chain, free.rules), (200, 6))
    q = q[measurable(free.site, q, free.rules)]
    q = q[free.clear(q)]
    seen = q[free.seen(q)][:5]
    assert len(seen) == 5
    for one in seen:
        between = 0.5 * (np.array(demo_cell.frames.tracker.xyz) + tool_of(demo_cell, one))
        screen = bodies_of(with_box(demo_cell, between, (0.1, 0.1, 0.1)))
        assert not screen.seen(one[None])[0]
        assert not measurable(screen.site, one[None], screen.rules)[0]
    turned = seen + np.array([np.pi, 0, 0, 0, 0, 0])
    assert not free.seen(turned[np.cos(turned[:, 0] - 0.24) < -0.9]).any()  # hidden behind the robot's own column


def test_targets_open_towards_the_tracker(demo_cell: Cell) -> None:
    """Acceptance angle and range, and that a plan keeps both."""
    points = dict.fromkeys(demo_cell.points, (0.0, 0.0, 1.0))
    tracker = demo_cell.instruments.tracker.model_copy(update={"acceptance_angle": 0.8, "range": (1.0, 4.5)})
    changes = {
        "frames": demo_cell.frames.model_copy(update={"target_normals": points}),
        "instruments": demo_cell.instruments.model_copy(update={"tracker": tracker}),
    }
    cell = demo_cell.model_copy(update=changes)
    plan = make_plan(cell, configurations=12, spares=0.5, rules=PlanningRules(postures=400))
    at = posture(chain_of(cell), plan.table1()[1])
    where = np.array(cell.frames.tracker.xyz)
    for point in nominal_parameters(cell).points.values():
        beam = where[:, None] - at.point(point)
        distance = np.linalg.norm(beam, axis=0)
        assert distance.max() <= 4.5
        assert np.all(np.einsum("am,am->m", at.flange[2], beam) / distance >= np.cos(0.8) - 1e-9)


def test_a_plan_keeps_clear_of_the_cell_all_the_way(demo_cell: Cell) -> None:
    boxes = (
        Box(name="table", xyz=(1.6, 0.0, 0.3), size=(0.8, 0.8, 0.6)),
        Box(name="pillar", xyz=(1.2, -1.6, 1.2), size=(0.3, 0.3, 2.4)),
    )
    cell = demo_cell.model_copy(update={"boxes": boxes})
    plan = make_plan(cell, configurations=12, rules=PlanningRules(postures=600))
    bodies = bodies_of(cell)
    assert plan.expected is not None
    assert plan.expected.unclear_moves == 0
    assert plan.expected.unjudged == bodies.unjudged
    assert bodies.clear(plan.table1()[1]).all()
    assert plan.reference is not None
    for one in plan.configurations:  # spares, too, can be driven to from the reference
        assert bodies.clear_way(plan.reference.q, one.q)
    way = [item.q for item in stops(plan, SequenceRules())]
    assert all(bodies.clear_way(a, b) for a, b in itertools.pairwise(way))


def test_walled_in_is_said(demo_cell: Cell) -> None:
    cell = with_box(demo_cell, np.array([0.35, 0.0, 0.95]), (1.0, 1.0, 0.5))
    with pytest.raises(PlanError, match=r"free of collision.*; .+ and fixture touch in \d+ %\)"):
        make_plan(cell, configurations=12, rules=PlanningRules(batches=1))


URDF = """<robot name="r"><link name="base"/>
<link name="a"><collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
<link name="b"><collision><origin xyz="0.4 0 0"/><geometry>{shape}</geometry></collision></link><link name="c"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.8 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""
TETRAHEDRON = "v -0.3 -0.05 0\nv 0.3 -0.05 0\nv 0 0.05 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"


def urdf_cell(folder: Path, cell: Cell, shape: str) -> Cell:
    (folder / "robot.urdf").write_text(URDF.format(shape=shape))
    (folder / "part.obj").write_text(TETRAHEDRON)
    changes = {
        "urdf": "robot.urdf", "base_link": "base", "flange": "c", "dh": None, "joint_limits": None, "inertials": None,
        "joints": ("j1", "j2", "j3"), "stiffness": (1e5,) * 3,
    }  # fmt: skip
    return cell.model_copy(
        update={"robot": cell.robot.model_copy(update=changes), "path": folder / "cell.yaml"},
    )


@pytest.mark.parametrize("shape", ['<sphere radius="0.1"/>', '<mesh filename="package://part.obj"/>'])
def test_bodies_of_a_urdf(tmp_path: Path, small_cell: Cell, shape: str) -> None:
    cell = urdf_cell(tmp_path, small_cell, shape)
    box = Box(name="post", xyz=(0.7, 1.1, 0.0), size=(0.1, 0.1, 0.5))
    bodies = bodies_of(cell.model_copy(update={"boxes": (box,)}), floor=None)
    assert bodies.clear(np.zeros((1, 3)))[0]
    hit = np.array([np.pi / 2, np.pi / 4 + 0.6, 0.0])  # link b reaches over to the post
    touched = bodies.touching(hit)
    assert [pair for pair in touched if "post" in pair] or bodies.clear(hit[None])[0]
    on_it = np.array([np.arctan2(1.1, 0.7) - 0.1, 0.1, 0.0])
    assert any("post" in pair for pair in bodies.touching(on_it))


def test_a_capsule_stands_for_a_mesh_that_is_missing(tmp_path: Path, small_cell: Cell) -> None:
    cell = urdf_cell(tmp_path, small_cell, '<mesh filename="package://nowhere.obj"/>')
    names = [str(one.name) for one in bodies_of(cell).geometry.geometryObjects]
    assert [name for name in names if name.startswith("link ")] != []


def test_new_keys_of_the_cell_file(tmp_path: Path, demo_cell: Cell) -> None:
    text = demo_cell.path.read_text()
    text = text.replace("tracker: {sigma: 2.0e-5,", "tracker: {acceptance_angle: 0.52, range: [1, 20], sigma: 2.0e-5,")
    path = tmp_path / "cell.yaml"
    boxes = "\nboxes:\n  - {name: table, xyz: [1, 0, 0.2], size: [0.5, 0.5, 0.4]}\n"
    path.write_text(text + boxes)
    cell = load_cell(path)
    assert cell.boxes[0].rpy == (0.0, 0.0, 0.0)
    assert cell.instruments.tracker.range == (1.0, 20.0)
    for old, new, place in (
        ("size: [0.5, 0.5, 0.4]", "size: [0.5, 0, 0.4]", "boxes.0.size.1"),
        ("range: [1, 20]", "range: [20, 1]", "instruments.tracker.range"),
        ("acceptance_angle: 0.52", "acceptance_angle: -1", "instruments.tracker.acceptance_angle"),
        ("frames:\n", "frames:\n  target_normals: {mp9: [0, 0, 1]}\n", "frames.target_normals"),
        ("frames:\n", "frames:\n  target_normals: {mp1: [0, 0, 0]}\n", "frames.target_normals.mp1"),
    ):
        path.write_text(
            (text + "\nboxes:\n  - {name: table, xyz: [1, 0, 0.2], size: [0.5, 0.5, 0.4]}\n").replace(old, new)
        )
        with pytest.raises(CellError) as caught:
            load_cell(path)
        assert caught.value.place == place


def test_k_csm_is_what_the_equilibrium_adds(demo_cell: Cell) -> None:
    """Against the equilibrium on the deformed geometry, less its linear part; gravity is left out of both."""
    from calibration_core.identification.checks import space
    from calibration_core.model.equilibrium import solve_equilibrium
    from calibration_core.model.kinematics import linear_jacobian
    from calibration_core.model.statics import Load, load_torque
    from calibration_core.planning.feasible.loads import complementary_share

    parameters = nominal_parameters(demo_cell)
    chain = dataclasses.replace(chain_of(demo_cell), mass=None, com=None)
    q = np.random.default_rng(3).uniform(*joint_range(chain, SpaceRules()), (20, 6))
    force = np.tile([900.0, -600.0, -1800.0], (20, 1))
    share = complementary_share(chain, parameters, q, force[:, None])[:, 0]
    load = Load(force.T, np.zeros((3, 20)), parameters.wrench_point, None)
    at = posture(chain, q)
    linear = parameters.compliance[:, None] * load_torque(at, load)
    rest = solve_equilibrium(chain, q, parameters.compliance, load)
    largest = np.zeros(20)
    for point in parameters.points.values():
        jacobian = linear_jacobian(at, at.point(point))
        extra = rest.deflection - linear
        largest = np.maximum(largest, np.linalg.norm(np.einsum("nam,nm->ma", jacobian, extra), axis=1))
    np.testing.assert_allclose(share, largest, rtol=0.05, atol=2e-8)
    inside = Load(np.einsum("abm,bm->am", at.flange, load.force), load.torque, load.point, np.eye(3))  # sensor axes
    for recorded in (load, inside):  # a plan and an identification mean the same by it
        said = space.complementary_share(parameters.compliance, at, recorded, list(parameters.points.values()))
        np.testing.assert_allclose(said, share, rtol=1e-9)
