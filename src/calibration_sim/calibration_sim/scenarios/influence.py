"""How loudly an effect speaks: its signal-to-noise ratio after everything that is refitted anyway.

The signal is the simulator's own difference between two played worlds.  What a load chain shows differently counts by
what a model of joint springs would predict from it.  Then what no diagnosis could hold against the model is removed:
one offset per loaded configuration and point, the six stiffnesses, and for single steps the frames and the points.
SNR^2 is the noncentrality, the sum of squares of what remains over sigma^2.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.cell.protocol import Protocol
from calibration_sim.effects.effect import Effect
from calibration_sim.scenarios.world import Played, World, play
from calibration_sim.scenarios.yielding import yielding

DEPENDENT = 1e-6  # of the largest singular value of columns of length one: below that, nothing of its own


@dataclasses.dataclass(frozen=True, eq=False)
class Background:
    """What is refitted anyway in one world under one protocol.

    Attributes:
        world: Without the effects to be judged.
        protocol: What is measured.
        played: The world played.
        sigma: m, per coordinate.
        nuisance: (r, k) orthonormal columns of what is refitted.
        compliance: (s, 3 p, 6) m/N and m/(N*m), how the points follow the shown wrench, tracker axes.
    """

    world: World
    protocol: Protocol
    played: Played
    sigma: float
    nuisance: Float2D
    compliance: Float2D

    def with_effects(self, *effects: Effect) -> Played:
        """Play the same with more in it; the robot is left as it rests where only instruments and frames differ."""
        world = self.world.with_effects(*effects)
        return play(world, self.protocol, self.played.rests if world.rests_like(self.world) else None)


def background(world: World, protocol: Protocol, sigma: float, *, geometry: bool = False) -> Background:
    """Play a world and find what is refitted anyway; with single steps, the geometry, too, where that is asked for.

    Args:
        world: Of joints that are springs alone; what the sensor shows may differ.
        protocol: What is measured.
        sigma: m, per coordinate.
        geometry: Whether the geometry is refitted.
    """
    played = play(world, protocol)
    columns = list(softer(world, protocol, played).T)
    if _singles(played).any():
        columns += _frames(played) + _points(world, played)
        if geometry:
            columns += list(yielding(world, protocol).geometry.T)
    refitted = _without_offsets(np.array(columns).T, played)
    nuisance = span(refitted) if geometry else np.linalg.qr(refitted)[0]
    return Background(world, protocol, played, sigma, nuisance, _by_wrench(world, played))


def signal(known: Background, played: Played) -> Float1D:
    """Return what remains (r,) of a played world against the background, in units of sigma."""
    moved = played.points - known.played.points
    shown = played.wrench - known.played.wrench
    predicted = np.einsum("sij,sj->si", known.compliance, shown).reshape(moved.shape)
    return beyond(known, (moved - predicted).reshape(-1, 1))[:, 0]


def beyond(known: Background, columns: Float2D) -> Float2D:
    """Return what columns (r, k) of moved points (m) show beyond all that is refitted anyway, in units of sigma."""
    rest = _without_offsets(columns, known.played) / known.sigma
    return np.asarray(rest - known.nuisance @ (known.nuisance.T @ rest))


def span(columns: Float2D) -> Float2D:
    """Return orthonormal columns (r, k) that span columns (r, m), of which some may depend on others."""
    length = np.linalg.norm(columns, axis=0)
    left, size, _ = np.linalg.svd(columns[:, length > 0.0] / length[length > 0.0], full_matrices=False)
    return np.asarray(left[:, size > DEPENDENT * size[0]]) if len(size) else np.zeros((len(columns), 0))


def signal_to_noise(known: Background, played: Played) -> float:
    """Return the SNR of a played world against the background."""
    return float(np.linalg.norm(signal(known, played)))


def softer(world: World, protocol: Protocol, played: Played) -> Float2D:
    """Return how the points (r,) move with the compliance of every joint, (r, n) m per share of it, tracker frame.

    Raises:
        ValueError: Something besides springs, weight and load holds the robot.
    """
    mechanism, truth = world.mechanism(), world.actual
    points, back = np.array(list(truth.points.values())), truth.tracker.rotation.T
    loads = [(c.q, wrench) for c in protocol.configurations for wrench in c.wrenches]
    moved = [
        back @ mechanism.softening(q, wrench, rest.rest, points)
        for (q, wrench), rest in zip(loads, played.rests, strict=True)
    ]
    return np.array(moved).reshape(played.points.size, -1)


def _singles(played: Played) -> Float1D:
    """Return which rows (s,) belong to configurations of a single step."""
    numbers, counts = np.unique(played.configuration, return_counts=True)
    return np.asarray(np.isin(played.configuration, numbers[counts == 1]))


def _without_offsets(columns: Float2D, played: Played) -> Float2D:
    """Remove the mean over the steps of every configuration of several, per point and coordinate, from (r, k)."""
    s = len(played.step)
    result = columns.reshape(s, -1, columns.shape[1]).copy()
    for number in np.unique(played.configuration):
        rows = np.flatnonzero(played.configuration == number)
        if len(rows) > 1:
            result[rows] -= result[rows].mean(axis=0)
    return np.asarray(result.reshape(columns.shape))


def _frames(played: Played) -> list[Float1D]:
    points = played.points
    shifts = [np.broadcast_to(axis, points.shape).ravel() for axis in np.eye(3)]
    middle = points.mean(axis=(0, 1))
    return shifts + [np.cross(axis, points - middle).ravel() for axis in np.eye(3)]


def _points(world: World, played: Played) -> list[Float1D]:
    """Return how the readings move with every point's coordinates in the flange frame."""
    mechanism, tracker = world.mechanism(), world.truth.tracker.rotation
    axes = np.array([tracker.T @ mechanism.forward(q).rotation for q in played.q])
    columns = []
    for point in range(played.points.shape[1]):
        for axis in range(3):
            moved = np.zeros(played.points.shape)
            moved[:, point] = axes[:, :, axis]
            columns.append(moved.ravel())
    return columns


def _by_wrench(world: World, played: Played) -> Float2D:
    """Return the compliance (s, 3 p, 6) of the points against the shown wrench, by the unloaded geometry."""
    truth, mechanism = world.truth, world.mechanism()
    compliance = np.diag(1.0 / truth.stiffness)
    result = np.empty((len(played.step), played.points.shape[1] * 3, 6))
    known: dict[int, Float2D] = {}
    for k, number in enumerate(played.configuration.tolist()):
        if number not in known:
            q = played.q[k]
            axes = mechanism.forward(q).rotation @ truth.force_torque.rotation
            carry = np.kron(np.eye(2), axes)
            at_sensor = mechanism.jacobian(q, truth.force_torque.translation)
            points = [truth.tracker.rotation.T @ mechanism.jacobian(q, p)[:3] for p in truth.points.values()]
            known[number] = np.vstack(points) @ compliance @ at_sensor.T @ carry
        result[k] = known[number]
    return result
