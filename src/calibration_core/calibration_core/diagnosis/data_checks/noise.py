"""How noisy the readings are, seen where no smooth physics can hide it.

Within one configuration every effect of the robot follows the load; what jumps from step to step does not.  Residuals
are therefore freed of an offset, of the level of the load (to third order) and of the branch of loading; what is left
is noise, with or without a right model.  It has two parts: one of every reading's own, in range and across the line of
sight, and one that all points of a step share (air, vibration, the tracker's own motion), to which the shape of the
points is blind and which may outlast a step.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from calibration_core.identification.statistics import Rows, chi2_limit, deleted, deletion_limit
from calibration_core.identification.stiffness.fit import worst_of_each
from calibration_core.identification.stiffness.problem import LoadedProblem
from calibration_core.model.effects.state import State
from calibration_core.observations.average import sight_axes
from calibration_core.policy import MOST_EXCLUDED
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Int2D, Readings

SHARE = 0.8  # of the steps of a configuration that smooth functions may take up
TRUSTED = 30  # degrees of freedom from which on the scatter sets the noise
CONVINCING = 3.0  # nats by which a shared part must be more likely than none
NEARLY = 2.0  # nats by which what explains the readings nearly as well is less likely: one chance in twenty
LEAST, MOST = 0.2, 20.0  # bounds of the factor on the claim
SHARED = (0.0, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.6, 2.5, 4.0, 8.0)  # shared over own variance
MEMORY = (0.0, 0.3, 0.6, 0.8)  # of the shared part from one step to the next


@dataclasses.dataclass(frozen=True)
class Scatter:
    """Noise in units of the claimed standard deviations.

    Attributes:
        own: Of every reading: in range and twice across the line of sight (three times the same without a tracker).
        shared: Common to the points of a step, over `own`.
        memory: Correlation of the shared part from one step to the next.
        freedom: Degrees of freedom on which this rests; 0 where steps are too few to tell.
        least_shared: The smallest shared part, over `own`, that explains what is seen nearly as well: most of a part
            that lasts over the steps is a smooth function of the load, of which nothing is seen.
    """

    own: tuple[float, float, float]
    shared: float
    memory: float
    freedom: int
    least_shared: float = 0.0

    @property
    def total(self) -> float:
        """Standard deviation of one coordinate of one reading over the claimed one (root mean square)."""
        return float(np.sqrt(np.mean(np.square(self.own)) * (1 + self.shared**2)))

    @property
    def least(self) -> float:
        """The smallest `total` that explains what is seen nearly as well."""
        return dataclasses.replace(self, shared=self.least_shared).total


def claimed(factor: float = 1.0) -> Scatter:
    """Return the claim times a factor, where nothing can be seen."""
    return Scatter((factor, factor, factor), 0.0, 0.0, 0)


def directions(readings: Readings, tracker: Float2D | None) -> Float3D:
    """Return (m, 3, 3) rows: line of sight and two across it, base axes; the base axes without a tracker."""
    if tracker is None:
        return np.tile(np.eye(3), (len(readings), 1, 1))
    seen_from = 0.0 if readings.viewpoint is None else readings.viewpoint
    return np.asarray(sight_axes(readings.position - seen_from) @ tracker[:3, :3].T)


def scatter(rows: Rows, residual: Float2D, readings: Readings, axes: Float3D) -> Scatter:
    """See the noise in residuals of any model that is right up to smooth functions of the load.

    Args:
        rows: Grouping and claimed noise of the m readings.
        residual: (m, 3) m.
        readings: The same readings.
        axes: (m, 3, 3) directions in which the tracker errs independently.
    """
    groups = list(step_groups(rows, residual, readings, axes).values())
    freedom = sum(3 * group.points * group.left for group in groups)
    if freedom < TRUSTED:
        return claimed()
    if all(group.points == 1 for group in groups):
        alone = claimed(float(np.sqrt(np.clip(_alone(groups), LEAST**2, MOST**2))))
        return dataclasses.replace(alone, freedom=freedom)
    within = np.sum([group.within for group in groups], axis=0) / sum((g.points - 1) * g.left for g in groups)
    if np.allclose(axes, np.eye(3)):
        within = np.full(3, within.mean())
    within = np.array([within[0], *[within[1:].mean()] * 2])
    own = np.sqrt(np.clip(within, LEAST**2, MOST**2))
    shared, memory, least = _shared(groups, own)
    first, second, third = (float(value) for value in own)
    return Scatter((first, second, third), shared, memory, freedom, least)


def with_noise(rows: Rows, readings: Readings, seen: Scatter, axes: Float3D) -> Rows:
    """Return the rows with the noise that was seen; readings of a configuration share what they have in common."""
    sigma = claimed_along(rows, axes) * np.array(seen.own)
    noise = np.einsum("mi,mia,mib->mab", sigma**2, axes, axes)
    if seen.shared == 0:
        return dataclasses.replace(rows, noise=noise)
    step = _ranks(readings.step, rows.configuration)
    steps = int(step.max()) + 1
    m, width = len(readings), rows.shared.shape[2]
    load = _ranks(rows.load, rows.configuration)
    own_load = np.zeros((m, 3, int(load.max()) + 1, width))
    own_load[np.arange(m), :, load] = rows.shared
    root = np.linalg.cholesky(seen.memory ** np.abs(np.subtract.outer(np.arange(steps), np.arange(steps))))
    size = np.sqrt(np.einsum("mii->m", noise) / 3) * seen.shared
    common = np.einsum("m,mk,ab->makb", size, root[step], np.eye(3))
    shared = np.concatenate([own_load.reshape(m, 3, -1), common.reshape(m, 3, -1)], axis=2)
    return dataclasses.replace(rows, noise=noise, load=rows.configuration, shared=shared)


@dataclasses.dataclass(frozen=True, eq=False)
class StepGroup:
    """One configuration without smooth functions of its load, in units of the claimed noise along each axis.

    Attributes:
        mean: (l, 3) means over the points.
        basis: (s, l) directions that are left of the steps.
        within: (3,) sum of squares about those means.
        known: (3,) variance that the wrench's noise gives every point.
        points: Number of points.
    """

    mean: Float2D
    basis: Float2D
    within: Float1D
    known: Float1D
    points: int

    @property
    def left(self) -> int:
        """Number of directions left."""
        return self.basis.shape[1]


def step_groups(rows: Rows, residual: Float2D, readings: Readings, axes: Float3D) -> dict[int, StepGroup]:
    """Return what jumps from step to step, by configuration; arguments as `scatter`."""
    sigma = claimed_along(rows, axes)
    along = np.einsum("mia,ma->mi", axes, residual)
    known = np.einsum("mia,mak->mik", axes, rows.shared) / sigma[:, :, None]
    several = {int(n): _group(along, sigma, known, rows, readings, n) for n in np.unique(rows.configuration)}
    return {number: group for number, group in several.items() if group is not None}


def claimed_along(rows: Rows, axes: Float3D) -> Float2D:
    """Return the (m, 3) m claimed standard deviations along the axes of every reading."""
    return np.asarray(np.sqrt(np.einsum("mia,mab,mib->mi", axes, rows.noise, axes)))


def _group(
    along: Float2D, sigma: Float2D, known: Float3D, rows: Rows, readings: Readings, number: int
) -> StepGroup | None:
    """Return what jumps from step to step in one configuration; None with fewer than three whole steps.

    The claim may differ from step to step.  Smooth functions of the load, of which an offset may be a hundred times the
    noise, are therefore taken out in units in which they still are what they are: each step has one size of its claim,
    by which data and functions alike are divided.

    Args:
        along: (m, 3) m, residuals along the axes.
        sigma: (m, 3) m, claimed standard deviations.
        known: (m, 3, k) what the wrench's noise moves, in units of the claim.
        rows: Grouping.
        readings: The same readings.
        number: Of the configuration.
    """
    inside = np.flatnonzero(rows.configuration == number)
    recording = readings.recording
    point = readings.point if recording is None else readings.point[recording == recording[inside[0]]]
    several = _steps(readings, inside, np.unique(point))
    if several is None:
        return None
    index, smooth = several
    of_point = np.sqrt(np.mean(sigma[index] ** 2, axis=0))
    of_step = np.sqrt(np.mean((sigma[index] / of_point) ** 2, axis=(1, 2)))
    basis = _free_of(smooth / of_step[:, None])
    rest = np.einsum("sl,spi->lpi", basis, along[index] / (of_point * of_step[:, None, None]))
    mean = rest.mean(axis=1)
    within = ((rest - mean[:, None]) ** 2).sum(axis=(0, 1))
    return StepGroup(mean, basis, within, (known[inside] ** 2).sum(axis=2).mean(axis=0), index.shape[1])


def _steps(readings: Readings, inside: Int1D, points: Int1D) -> tuple[Int2D, Float2D] | None:
    """Return the whole steps of one configuration and what physics may do along them; None with fewer than three.

    Returns:
        index: (s, p) readings of the steps at which all points were read.
        smooth: (s, q) smooth functions of the load along these steps.
    """
    steps = np.unique(readings.step[inside])
    index = np.full((len(steps), len(points)), -1)
    index[np.searchsorted(steps, readings.step[inside]), np.searchsorted(points, readings.point[inside])] = inside
    index = index[(index >= 0).all(axis=1)]
    if len(index) < 3:
        return None
    return index, _smooth(_load(readings, index[:, 0]))


def _free_of(smooth: Float2D) -> Float2D:
    """Return (s, l) orthonormal directions of the steps that are free of functions, (s, q) independent ones."""
    return np.asarray(np.linalg.svd(smooth, full_matrices=True)[0][:, smooth.shape[1] :], dtype=np.float64)


def _alone(groups: list[StepGroup]) -> float:
    """Return the variance of one coordinate from configurations with one point."""
    squares = sum(float((group.mean**2).sum()) for group in groups)
    known = float(np.mean([group.known.mean() for group in groups]))
    return squares / sum(3 * group.left for group in groups) - known


def _shared(groups: list[StepGroup], own: Float1D) -> tuple[float, float, float]:
    """Return size (over own) and memory of the shared part by maximum likelihood; zeros if it convinces too little.

    Last, the smallest size that is nearly as likely.
    """
    sizes = np.sqrt(SHARED)
    several = [(memory, sum((_log_likelihoods(group, own, memory) for group in groups), np.zeros(len(SHARED))))
               for memory in MEMORY]  # fmt: skip
    likely = np.array([values for _, values in several])
    row, most = np.unravel_index(int(np.argmax(likely)), likely.shape)
    best = float(likely[row, most])
    if best <= float(likely[0, 0]) + CONVINCING:
        return 0.0, 0.0, 0.0
    least = float(sizes[np.flatnonzero((likely > best - NEARLY).any(axis=0))[0]])
    return float(sizes[most]), several[row][0], least


def _log_likelihoods(group: StepGroup, own: Float1D, memory: float) -> Float1D:
    """Return the log likelihood of a group for every size in `SHARED`; one eigenbasis serves all sizes."""
    steps = len(group.basis)
    chain = memory ** np.abs(np.subtract.outer(np.arange(steps), np.arange(steps)))
    values, vectors = np.linalg.eigh(group.basis.T @ chain @ group.basis)
    white = 1 / group.points + group.known / own**2
    variance = np.array(SHARED)[:, None, None] * values[:, None] + white  # (sizes, l, 3)
    return np.asarray(-0.5 * ((vectors.T @ (group.mean / own)) ** 2 / variance + np.log(variance)).sum(axis=(1, 2)))


def _ranks(values: Int1D, configuration: Int1D) -> Int1D:
    """Number the distinct values within every configuration, from 0."""
    result = np.empty(len(values), dtype=np.int64)
    for number in np.unique(configuration):
        inside = configuration == number
        result[inside] = np.unique(values[inside], return_inverse=True)[1]
    return result


def _load(readings: Readings, index: Int1D) -> Float1D:
    """Return the signed level of the load at every step, (s,), the largest being one."""
    if readings.wrench is None:
        return np.zeros(len(index))
    wrench = readings.wrench[index]
    largest = wrench[int(np.argmax(np.linalg.norm(wrench[:, :3], axis=1)))]
    return np.asarray(wrench @ largest / max(float(largest @ largest), 1e-30))


def _smooth(level: Float1D) -> Float2D:
    """Return an orthonormal basis of what physics may do along the steps: level, branch, and their products.

    The first step belongs to the branch that it begins, so that loading alone shows no branch.
    """
    steps = len(level)
    branch = np.sign(np.round(np.diff(level), 2))
    branch = np.concatenate([branch[:1], branch])
    shapes = [np.ones(steps), level, level**2, branch, branch * level, level**3]
    basis, count = np.zeros((steps, len(shapes))), 0
    most = max(2, int(SHARE * steps))
    for shape in shapes:
        rest = shape - basis @ (shape @ basis)
        length = math.sqrt(rest @ rest)
        if length > 0.05 * max(math.sqrt(shape @ shape), 1e-12) and count < most:
            basis[:, count] = rest / length
            count += 1
    return basis[:, :count]


def left_over(problem: LoadedProblem, state: State, used: Bool1D) -> dict[int, Float3D]:
    """Return what jumps from step to step under the state's compliances, by number of the configuration.

    Args:
        problem: All readings.
        state: Their state.
        used: (m,) readings to look at; steps at which not all of their points are left do not count.

    Returns:
        (l, p, 3) m, flange axes: independent combinations of steps, free of smooth functions of the load.
    """
    readings = problem.readings.select(used)
    residual = problem.linearise(state.compliance).residual[used]
    axes = np.moveaxis(state.at.flange, -1, 0)[used]
    local = np.einsum("mia,ma->mi", axes, residual)
    points = np.unique(readings.point)
    found = {}
    for number in np.unique(readings.configuration):
        several = _steps(readings, np.flatnonzero(readings.configuration == number), points)
        if several is not None and len(several[1]) > several[1].shape[1]:
            index, smooth = several
            found[int(number)] = np.einsum("sl,spi->lpi", _free_of(smooth), local[index])
    return found


# --- gross errors, judged by the extended model, so that a missing effect neither makes nor hides them ----------------


ROUNDS = 12
SHAPE = 3  # points, of which the shape is known
OUT_OF_SHAPE = 0.01  # probability that noise alone changes the shape of any step of a recording more


def readings_to_use(rows: Rows, residual: Float2D, step: Int1D) -> Int1D:
    """Return the indices of the readings that are no gross errors.

    Every reading is predicted from the others of its configuration and the model; the worst of every configuration
    and point goes first, and the others are judged again without it.

    Args:
        rows: Grouping and noise of all m readings.
        residual: (m, 3) m, measured - model.
        step: (m,) number of each reading's step.
    """
    m = len(residual)
    used, some = np.arange(m), rows
    for _ in range(ROUNDS):
        squared, _, _ = deleted(some, residual[used])
        groups = np.column_stack([some.configuration, some.offset])
        room = int(MOST_EXCLUDED * m) - (m - len(used))
        worst = worst_of_each(squared, deletion_limit(squared, m), groups, step[used])[: max(room, 0)]
        if not len(worst):
            break
        used, some = np.delete(used, worst), some.without(worst)
    return used


def whole_steps(
    readings: Readings, place: Float2D, residual: Float2D, noise: Float3D, used: Int1D, sound: Int1D
) -> Int1D:
    """Return the readings of steps that were set aside whole, although the tool kept its shape.

    A tracker errs at one point or another; where all points of a step moved as one rigid body, the robot did, or the
    load was another.

    Args:
        readings: All m readings.
        place: (m, 3) m, where their points are, in the axes of the residuals.
        residual: (m, 3) m, measured - model.
        noise: (m, 3, 3) m^2, covariance that each reading has of its own.
        used: Indices of those that are no gross errors.
        sound: Indices of those that may be used at all.
    """
    aside = np.setdiff1d(sound, used)
    found = [
        rows
        for rows in _steps_of(readings, aside, sound)
        if len(rows) >= SHAPE
        and np.isin(rows, aside).all()
        and _moved_rigidly(readings, place, residual, noise, used, rows)
    ]
    return np.concatenate([np.zeros(0, dtype=np.int64), *found])


def moved_with_their_step(
    readings: Readings, place: Float2D, residual: Float2D, noise: Float3D, used: Int1D, aside: Int1D
) -> Int1D:
    """Return those of the readings set aside whose step moved as one rigid body: no gross errors of a tracker.

    An error at one of three points across their plane is a turn of all of them.  So the others must have moved, too.

    Args:
        readings: All m readings.
        place: (m, 3) m, where their points are, in the axes of the residuals.
        residual: (m, 3) m, measured - model.
        noise: (m, 3, 3) m^2, covariance that each reading has of its own.
        used: Indices of those that are no gross errors.
        aside: Indices of those set aside.
    """
    found = [np.zeros(0, dtype=np.int64)]
    for rows in _steps_of(readings, aside, np.union1d(used, aside)):
        elsewhere = np.setdiff1d(used, rows)
        if (
            len(rows) >= SHAPE
            and _moved(readings, residual, noise, elsewhere, np.setdiff1d(rows, aside))
            and _moved_rigidly(readings, place, residual, noise, elsewhere, rows)
        ):
            found.append(np.intersect1d(rows, aside))
    return np.concatenate(found)


def _steps_of(readings: Readings, some: Int1D, among: Int1D) -> Iterator[Int1D]:
    """Yield for each step that some readings are of all its readings among others, as indices."""
    keys = np.column_stack([readings.configuration, readings.step])
    for key in np.unique(keys[some], axis=0):
        yield among[(keys[among] == key).all(axis=1)]


def _moved(readings: Readings, residual: Float2D, noise: Float3D, used: Int1D, rows: Int1D) -> bool:
    """Say whether readings of one step, none of them gross by itself, moved by more than noise; of no readings: yes."""
    if not len(rows):
        return True
    against = _against_others(readings, residual, noise, used, rows)
    if against is None:
        return False
    moved, variance = against
    return bool((moved**2).sum() > variance * chi2_limit(OUT_OF_SHAPE / len(residual), moved.size))


def _against_others(
    readings: Readings, residual: Float2D, noise: Float3D, used: Int1D, rows: Int1D
) -> tuple[Float2D, float] | None:
    """Return how far readings of a step moved against used steps of their configuration, (k, 3) m, and its variance.

    None where a point was read at no other step.
    """
    same = readings.configuration[used] == readings.configuration[rows[0]]
    others = [used[same & (readings.point[used] == readings.point[row])] for row in rows]
    if not all(len(each) for each in others):
        return None
    moved = residual[rows] - np.stack([residual[each].mean(axis=0) for each in others])
    variance = float(np.mean(np.trace(noise[rows], axis1=1, axis2=2))) / 3
    return moved, variance * (1 + float(np.mean([1 / len(each) for each in others])))


def _moved_rigidly(
    readings: Readings, place: Float2D, residual: Float2D, noise: Float3D, used: Int1D, rows: Int1D
) -> bool:
    """Say whether the points of a step moved as a rigid body against the used steps of their configuration."""
    against = _against_others(readings, residual, noise, used, rows)
    if against is None:
        return False
    moved, variance = against
    lever = place[rows] - place[rows].mean(axis=0)
    turns = np.cross(np.eye(3)[None], lever[:, None, :])  # (k, 3, 3): turn about every axis, what it moves
    rigid = np.concatenate([np.tile(np.eye(3), (len(rows), 1)), turns.transpose(0, 2, 1).reshape(-1, 3)], axis=1)
    motion, _, rank, _ = np.linalg.lstsq(rigid, moved.reshape(-1), rcond=1e-6)
    left = moved.reshape(-1) - rigid @ motion
    return bool(left @ left < variance * chi2_limit(OUT_OF_SHAPE / len(residual), len(left) - int(rank)))
