"""The catalogue of effects, made from the registry: law, source, usual size, and one picture each."""

from __future__ import annotations

import dataclasses
import functools
import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calibration_core.cell import Cell, load_cell
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.candidate import Candidate, Effect, typical
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.model.statics import load_of
from calibration_core.planning.plans.plan import PlannedConfiguration
from calibration_core.timeseries import Float2D, Readings

HEAD = """# Catalogue of effects

What `calibration diagnose` can find beyond one linear spring per joint. Effects stand by family in
`calibration_core/model/effects`, and this page is made from these files. The pictures show what an effect of
**typical size** does to the first measurement point of the example robot ({robot}). Under load: left along the load
steps of one configuration, right the size of its motion in every configuration. Without load: left while one joint
turns to and fro, right the size for every joint that turns. Typical sizes stand in
[config/priors.yaml](../../../config/priors.yaml), each with its source; the prior of a size is a normal distribution
about zero with three times the typical value. [Adding an effect](extending.md) tells how to write one.
"""
LEVELS = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0])
CONFIGURATIONS = 12
SWEEP = np.concatenate([np.linspace(-1, 1, 41), np.linspace(1, -1, 41)[1:]])  # of half the joint's range
SECONDS = 40.0  # between readings
WARMING = 1.5e-3  # K/s


def page(root: Path, pictures: Path) -> str:
    """Return the page, Markdown, and draw its pictures.

    Args:
        root: Folder of the project.
        pictures: Folder for the pictures, made if missing.
    """
    cell = load_cell(root / "config" / "cells" / "demo.cell.yaml")
    pictures.mkdir(parents=True, exist_ok=True)
    lines = [HEAD.format(robot=cell.robot.name)]
    for family in dict.fromkeys(effect.family for effect in sorted(catalogue(), key=lambda one: one.family)):
        lines.append(f"## Family: {family}\n")
        for effect in (one for one in catalogue() if one.family == family):
            (pictures / f"{effect.name}.svg").write_bytes(picture(effect, cell))
            lines.append(_section(effect, cell))
    return "\n".join(lines)


def _section(effect: Effect, cell: Cell) -> str:
    drawn = shown(effect, cell)
    where = "the clocks of the instruments" if drawn is None else ", ".join(sorted(drawn[0].location)) or "robot"
    kinds = [
        word
        for word, flag in (("loaded recordings", effect.loaded), ("postures without load", effect.absolute))
        if flag
    ]
    parameters = () if drawn is None else drawn[0].parameters
    sizes = ", ".join(f"`{p.name}` {p.typical:.2g} {p.unit}" for p in parameters) or f"{_offset(cell):.2g} s"
    rows = [
        ("Law", f"`{effect.equation}`"),
        ("Source", effect.source),
        ("Place", where),
        ("Typical size", sizes),
        ("Shows in", " and ".join(kinds) or "postures without load, where geometry is fitted"),
        ("Best revealed by", effect.reveal),
    ]
    table = "\n".join(f"| {name} | {text.replace('|', '&#124;')} |" for name, text in rows)
    words = effect.name.replace("_", " ")
    drawing = f"![What {words} does to a point](pictures/effects/{effect.name}.svg)"
    return f"### {effect.name}\n\n| | |\n|---|---|\n{table}\n\n{drawing}\n"


@functools.cache
def _states(path: Path) -> tuple[State, State]:
    """Return the example robot under load steps, and in postures without load."""
    cell = load_cell(path)
    parameters = nominal_parameters(cell)
    rng = np.random.default_rng(7)
    limits = np.array(chain_of(cell).limits)
    middle, half = limits.mean(axis=1), 0.35 * np.ptp(limits, axis=1)
    pull = 0.5 * cell.robot.rated_load * 9.81
    loaded = []
    for number in range(1, CONFIGURATIONS + 1):
        q = middle + half * rng.uniform(-1.0, 1.0, len(middle))
        direction = rng.normal(size=3)
        wrench = np.zeros((len(LEVELS), 6))
        wrench[:, :3] = LEVELS[:, None] * pull * direction / np.linalg.norm(direction)
        loaded.append(PlannedConfiguration(number, q, wrench))
    swept = middle + np.einsum("ji,k->jki", np.diag(2 * half), SWEEP).reshape(-1, len(middle))
    unloaded = [PlannedConfiguration(number, q, np.zeros((1, 6))) for number, q in enumerate(swept, 1)]
    return _state(tuple(loaded), cell, parameters), _state(tuple(unloaded), cell, parameters)


def _state(plan: tuple[PlannedConfiguration, ...], cell: Cell, parameters: ModelParameters) -> State:
    readings = simulate_plan(plan, cell, parameters, None)
    time = SECONDS * np.arange(len(readings), dtype=np.float64)
    readings = dataclasses.replace(readings, time=time, temperature=20.0 + WARMING * time)
    return _of(readings, cell, parameters)


def _of(readings: Readings, cell: Cell, parameters: ModelParameters) -> State:
    points = np.stack([parameters.points[name] for name in readings.points])[readings.point].T
    return state_of(
        chain_of(cell),
        readings.q,
        parameters.compliance,
        None if readings.wrench is None else load_of(readings, cell, parameters),
        points,
        point_index=readings.point,
        wrench=readings.wrench,
        configuration=readings.configuration,
        step=readings.step,
        time=readings.time,
        temperature=readings.temperature,
        tracker=parameters.tracker,
        rated_load=cell.robot.rated_load,
    )


def shown(effect: Effect, cell: Cell) -> tuple[Candidate, State] | None:
    """Return the hypothesis that is drawn, the one that moves the points most, and the robot's state for it.

    None for what robots at rest cannot show: it is found in streams, before anything is averaged.
    """
    loaded, unloaded = _states(cell.path)
    for state, usable in ((loaded, effect.loaded), (unloaded, True)):
        offered = list(effect.candidates(state)) if usable else []
        if offered:
            return max(offered, key=lambda one: float(np.sum(shift(one, state) ** 2))), state
    return None


def shift(candidate: Candidate, state: State) -> Float2D:
    """Return the (m, 3) m that an effect of typical size moves the points."""
    return candidate.columns(state) @ np.array([p.typical for p in candidate.parameters])


def picture(effect: Effect, cell: Cell) -> bytes:
    """Draw what an effect does, SVG."""
    drawn = shown(effect, cell)
    if drawn is None:
        return _moving(_offset(cell))
    candidate, state = drawn
    first = state.point_index == 0
    moved, q = 1e6 * shift(candidate, state), state.q[first]
    moved = (state.since_step_zero(moved) if state.loaded else moved)[first]
    series = (
        len(LEVELS) if state.loaded else len(SWEEP)
    )  # readings of the point that belong together, one after another
    parts = moved.reshape(-1, series, 3)
    size = np.sqrt(np.mean(np.sum(parts**2, axis=2), axis=1))
    best = int(np.argmax(np.ptp(parts, axis=1).max(axis=1)))
    figure = Figure(figsize=(6.7, 2.3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1))
    against, label = 100 * LEVELS, "load [% of the full pull]"
    if not state.loaded:
        against, label = q.reshape(len(parts), series, -1)[best, :, best], f"angle of joint {best + 1} [rad]"
    for axis, marker, colour in (("x", "o", "#111111"), ("y", "^", "#1f4e79"), ("z", "s", "#8a8a8a")):
        values = parts[best, :, "xyz".index(axis)]
        left.plot(against, values, marker=marker, markersize=2.5, linewidth=0.9, color=colour, label=axis)
    left.set(xlabel=label, ylabel="motion of the point [µm]")
    left.legend(frameon=False, fontsize=8, ncols=3)
    right.bar(np.arange(1, len(size) + 1), size, color="#c9c9c9", edgecolor="#111111", linewidth=0.6)
    right.set(xlabel="configuration" if state.loaded else "joint that turns", ylabel="rms [µm]")
    return _svg(figure)


def _svg(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _offset(cell: Cell) -> float:
    return typical("clock_offset", cell.robot.rated_load)


def _moving(offset: float) -> bytes:
    """Draw a point that moves by 1 mm in 2 s under a load ramp, as two clocks see it, and the difference."""
    time = np.linspace(-1.0, 3.0, 400)
    true, seen = (np.interp(time + shift, [0.0, 2.0], [0.0, 1000.0]) for shift in (0.0, offset))
    figure = Figure(figsize=(6.7, 2.3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1))
    left.plot(time, true, color="#111111", label="clock of the sensor")
    left.plot(time, seen, "--", color="#1f4e79", label="clock of the tracker")
    left.set(xlabel="time [s]", ylabel="motion of the point [µm]")
    left.legend(frameon=False, fontsize=8)
    right.plot(time, seen - true, color="#111111")
    right.set(xlabel="time [s]", ylabel="difference [µm]")
    return _svg(figure)
