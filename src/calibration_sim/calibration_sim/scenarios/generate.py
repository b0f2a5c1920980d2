"""Turns a scenario into a recording, the cell file that goes with it, and the label that is kept apart."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from calibration_core.errors import EquilibriumError
from calibration_core.files.yaml_file import read_yaml
from calibration_core.timeseries import Float2D, Readings
from calibration_sim.cell.truth import Spread, draw_truth, generator
from calibration_sim.effects import GENERATORS
from calibration_sim.effects.draw import FIRST_AXIS, MAGNITUDES, Draw, robot_cell
from calibration_sim.effects.effect import Effect
from calibration_sim.scenarios.grid import CLUTTER, NEEDS_SINGLE_STEPS, SINGLES, Planned, Scenario
from calibration_sim.scenarios.influence import Background, background, signal, signal_to_noise
from calibration_sim.scenarios.look_alikes import look_alikes
from calibration_sim.scenarios.measure import Noise, lagging_sensor, look, spherical_tracker
from calibration_sim.scenarios.names import renamed
from calibration_sim.scenarios.protocols import LOADED, is_loaded, make_protocol, points_of
from calibration_sim.scenarios.world import Played, World, play
from calibration_sim.scenarios.yielding import yielding

# What every recording differs by from its cell file: stiffness by 15 percent, geometry by 0.3 mm per joint, and frames
# and points by what registration leaves.
EVERYWHERE = Spread(
    stiffness=0.15,
    joint_zero=5e-5,
    joint_shift=3e-4 / np.sqrt(3.0),
    tracker_shift=2e-3,
    tracker_turn=1e-4,
    sensor_turn=5e-4,
    point=2e-4,
)
SECOND = dataclasses.replace(EVERYWHERE, stiffness=0.3)
TRUE_ANYWAY = ("geometry_error", "joint_zero_offset", "joint_elasticity", "measurement_point_offset")
EFFECT_STREAM, CLUTTER_STREAM, LOOK_STREAM = 11, 12, 13
MOST_DRAWS, MOST_AMPLITUDE = 8, 5.0  # of an effect that shall be loud: other places before absurd sizes
MEDIAN = 0.67449  # of the size of a standard normal number
MOST_CLUTTER = 5.0  # amplitude, typical = 1, beyond which a small effect would be absurd
# What absolute positions show far better than deflections is never small: a turned tracker of SNR 3 in the deflections
# is off by millimetres.
LOUD_IN_POSITIONS = frozenset({"tracker_frame_misalignment", "measurement_point_offset"})
CLUTTER_NAMES = tuple(name for name in SINGLES if name not in NEEDS_SINGLE_STEPS | LOUD_IN_POSITIONS)


@dataclasses.dataclass(frozen=True, eq=False)
class Generated:
    """A scenario made real.

    Attributes:
        readings: The recording.
        cell: What the diagnosis may know, as written to the cell file.
        label: What it is to find, as plain values for JSON.
    """

    readings: Readings
    cell: dict[str, Any]
    label: dict[str, Any]


def generate(scenario: Scenario) -> Generated:
    """Make a recording; the same scenario gives the same one.

    Raises:
        CalibrationError: The robot cannot be read or finds no rest.
    """
    cell = robot_cell(scenario.robot)
    truth = draw_truth(cell, scenario.seed, spread=SECOND if scenario.second else EVERYWHERE)
    world = World(cell, truth, (lagging_sensor(cell),))
    protocol = make_protocol(cell, scenario.protocol, scenario.seed)
    known: Background | None = None
    if scenario.planned or scenario.clutter > 0.0:
        sigma = float(cell.instruments.tracker.sigma or 0.0)
        known = background(world, protocol, sigma, geometry=scenario.second)
    effects: list[Effect] = []
    ratios: list[float] = []
    if known is not None:
        for k, planned in enumerate(scenario.planned):
            effect, ratio = _loud_enough(scenario, planned, k, known)
            effects.append(effect)
            ratios.append(ratio)
    small = [] if known is None else _clutter(scenario, known)
    full = world.with_effects(*effects, *small)
    seed = int(generator(scenario.seed, LOOK_STREAM).integers(2**31))
    played = play(full, protocol) if known is None else known.with_effects(*effects, *small)
    points = points_of(cell, scenario.protocol)
    readings = look(full, played, points, scenario.noise, seed)
    label = {
        "group": scenario.group,
        "robot": scenario.robot,
        "protocol": scenario.protocol,
        "seed": scenario.seed,
        "number": scenario.number,
        "effects": [effect.label.as_dict() for effect in effects],
        "snr": ratios,
        "clutter": scenario.clutter,
        "noise": dataclasses.asdict(scenario.noise),
        "stiffness": full.actual.stiffness.tolist(),
        "true_anyway": list(TRUE_ANYWAY) if "A" in scenario.protocol else [],
    }
    if scenario.second:
        error = readings.position - played.points[:, : len(points)].reshape(-1, 3)
        label |= {"noise_seen": _noise_seen(error, scenario.noise), "effects": _labelled(effects, known)}
        readings = dataclasses.replace(readings, points=tuple(renamed(points, scenario.names)))
    file = renamed(_file(full, scenario, played), scenario.names)
    return Generated(readings, file, renamed(label, scenario.names))


def _noise_seen(error: Float2D, noise: Noise) -> float:
    """Return the rms per coordinate of what was measured wrong, (m, 3) m; gross errors, where there are any, apart.

    Noise of a tracker grows with the distance, so that the median says less than the rms that residuals are stated by.
    """
    if noise.outlier_rate == 0.0:
        return float(np.sqrt(np.mean(error**2)))
    return float(np.median(np.abs(error)) / MEDIAN)


def _draw(scenario: Scenario, stream: tuple[int, ...], planned: Planned, amplitude: float) -> Effect:
    """Draw an effect; the amplitude alone differs between calls for one stream."""
    rng = np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=stream))
    first = FIRST_AXIS.get(scenario.robot, 0)
    stiffness = np.array(robot_cell(scenario.robot).robot.stiffness)[first:]
    size = MAGNITUDES[scenario.robot]
    return GENERATORS[planned.name](Draw(size, stiffness, amplitude, rng, planned.place, LOADED, planned.plain, first))


def _loud_enough(scenario: Scenario, planned: Planned, k: int, known: Background) -> tuple[Effect, float]:
    """Draw an effect and scale it to the signal-to-noise ratio that is asked for.

    In the second grid, a place where that takes an absurd size is drawn again; the least absurd of a few draws is it.

    Raises:
        EquilibriumError: At no place that was drawn the robot finds rest.
    """
    drawn: list[tuple[Effect, float]] = []
    failed: EquilibriumError | None = None
    for again in range(MOST_DRAWS if scenario.second else 1):
        try:
            drawn.append(_scaled(scenario, (EFFECT_STREAM, k, again) if again else (EFFECT_STREAM, k), planned, known))
        except EquilibriumError as error:  # so much that nothing carries the robot any more
            failed = error
            continue
        if drawn[-1][0].label.amplitude <= MOST_AMPLITUDE:
            break
    if failed is not None and not drawn:
        raise failed
    return min(drawn, key=lambda one: one[0].label.amplitude)


def _scaled(scenario: Scenario, stream: tuple[int, ...], planned: Planned, known: Background) -> tuple[Effect, float]:
    """Draw an effect at one place and scale it."""
    amplitude = planned.amplitude
    effect = _draw(scenario, stream, planned, amplitude)
    ratio = signal_to_noise(known, known.with_effects(effect))
    for _ in range(3):
        enough = ratio >= planned.snr if planned.at_least else abs(ratio - planned.snr) < 0.1 * planned.snr
        if planned.snr == 0.0 or enough:
            break
        amplitude *= float(np.clip(1.05 * planned.snr / max(ratio, 1e-9), 0.05, 20.0))
        effect = _draw(scenario, stream, planned, amplitude)
        ratio = signal_to_noise(known, known.with_effects(effect))
    return effect, ratio


def _labelled(effects: list[Effect], known: Background | None) -> list[dict[str, Any]]:
    """Return the labels of effects, with what looks alike among structure and gears."""
    labels = [effect.label.as_dict() for effect in effects]
    if known is None:
        return labels
    blocks = yielding(known.world, known.protocol).blocks
    for effect, label in zip(effects, labels, strict=True):
        if label["family"] not in {"structure", "absolute"} or "kinds" in label or "all" in label["location"].values():
            continue
        shown = signal(known, known.with_effects(effect))
        alike = look_alikes(known, blocks, shown)
        known_alike = [{"effect": label["effect"], "location": label["location"]}, *label["equivalent"]]
        label["equivalent"] += [item for item in alike if item not in known_alike]
    return labels


def _clutter(scenario: Scenario, known: Background) -> list[Effect]:
    """Draw fifty small effects, each as loud as the scenario says."""
    if scenario.clutter == 0.0:
        return []
    rng = generator(scenario.seed, CLUTTER_STREAM)
    result = []
    for k, name in enumerate(rng.choice(CLUTTER_NAMES, CLUTTER)):
        planned, stream = Planned(str(name)), (CLUTTER_STREAM, k)
        effect = _draw(scenario, stream, planned, 1.0)
        ratio = signal_to_noise(known, known.with_effects(effect))
        amplitude = min(scenario.clutter / max(ratio, 1e-9), MOST_CLUTTER)
        result.append(_draw(scenario, stream, planned, amplitude))
    return result


def _file(world: World, scenario: Scenario, played: Played) -> dict[str, Any]:
    """Return the cell file that the diagnosis reads."""
    cell: dict[str, Any] = read_yaml(world.cell.path, 1 << 18, "cell file (YAML)").data
    noise: Noise = scenario.noise
    if noise.spherical_claim:
        claim = spherical_tracker(world.cell, played.points)
        cell["instruments"]["tracker"] = {"sigma_range": claim.sigma_range, "sigma_angle": claim.sigma_angle}
    if not is_loaded(scenario.protocol):
        for section, key in (("frames", "force_torque"), ("frames", "wrench_point"), ("instruments", "force_torque")):
            del cell[section][key]
    for effect in world.effects:
        cell = effect.change_file(cell)
    return cell
