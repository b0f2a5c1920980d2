"""What could be missing: every effect at every place, and every effect at all joints with one shared size."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from calibration_core.estimation.rows import NullModel
from calibration_core.estimation.shifts import FAMILY
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.absolute import joint_elasticity, transmission_error
from calibration_core.model.effects.absolute.joint_elasticity import AXIAL
from calibration_core.model.effects.candidate import Candidate, Trait, number_of
from calibration_core.model.effects.recordings import in_each_recording
from calibration_core.model.effects.state import State
from calibration_core.model.effects.words import effect_sentence
from calibration_core.timeseries import Float1D, Float2D, Int1D

WAVE, SAG = transmission_error.EFFECT.name, joint_elasticity.EFFECT.name
LAW = "joint law"  # family
SINGLE_ORDERS = 64  # of transmission errors, offered one by one; of higher ones
STRONGEST = 6  # at each joint are: a gear ratio, its half and double, and what leaks beside the strongest of them
BANDS = ((1, 4), (1, 8), (1, 16), (1, 32), (33, 64))  # orders of transmissions that share one size
ALL = "all"
FEWEST = 3  # joints that make a family


def is_axial(candidate: Candidate) -> bool:
    """Say whether a candidate is the compliance of a joint itself, not its product with masses that are not known."""
    return candidate.effect == SAG and candidate.variant == AXIAL


@dataclasses.dataclass(frozen=True, eq=False)
class Hypothesis:
    """Candidates that share one size.

    Attributes:
        family: Family in the catalogue of effects.
        location: Where; `{"joints": "all"}` for every joint.
        members: Indices of its candidates.
        columns: Indices of their columns, those of chance among them.
        chance: Indices of the columns of what they leave to chance in each configuration.
        shape: As of its candidate, where it is one alone (`Candidate.shape`).
    """

    effect: str
    family: str
    location: Mapping[str, str | tuple[str, ...]]
    variant: str
    members: tuple[int, ...]
    columns: Int1D
    chance: Int1D = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    shape: object = None

    @property
    def everywhere(self) -> bool:
        """Whether it is about all joints."""
        return self.location.get("joints") == ALL

    @property
    def is_law_of_a_joint(self) -> bool:
        """Whether it is a law of one joint."""
        return self.family == LAW and "joint" in self.location

    def is_law_of(self, location: Mapping[str, object]) -> bool:
        """Whether it is a law of the joint at a location."""
        return self.family == LAW and self.location == location

    @property
    def words(self) -> str:
        """Effect and place as a sentence without full stop."""
        return effect_sentence(self.effect, self.location)

    @property
    def place(self) -> tuple[str, tuple[tuple[str, str | tuple[str, ...]], ...]]:
        """Effect and location, whatever the variant."""
        return self.effect, tuple(sorted(self.location.items()))


@dataclasses.dataclass(frozen=True, eq=False)
class Offered:
    """Candidates, the hypotheses made of them, and where their columns stand.

    Attributes:
        blocks: Their columns.
    """

    candidates: tuple[Candidate, ...]
    blocks: tuple[slice, ...]
    hypotheses: tuple[Hypothesis, ...]

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.blocks[-1].stop if self.blocks else 0

    def columns(self, model: NullModel, rows: Int1D, before: Float2D | None = None, below: int = 0) -> Float2D:
        """Return all columns for some readings, per typical size, (3 r, p), in units of the claimed noise.

        `before` and `below` are as in `NullModel.moves`.
        """
        result = model.moves(self.candidates, rows, before, below)
        own = result if before is None else result[:, before.shape[1] :]
        own *= np.concatenate([np.zeros(0), *map(typical_sizes, self.candidates)])
        return result


def typical_sizes(candidate: Candidate) -> Float1D:
    """Return the (k,) typical sizes of a candidate's parameters."""
    return np.array([parameter.typical for parameter in candidate.parameters])


def offer(candidates: Sequence[Candidate]) -> Offered:
    """Return every candidate as a hypothesis of its own, and the families that they make."""
    ends = list(itertools.accumulate((len(c.parameters) for c in candidates), initial=0))
    blocks = tuple(slice(first, last) for first, last in itertools.pairwise(ends))
    single = [_hypothesis(candidates, blocks, (i,), c.location, c.variant) for i, c in enumerate(candidates)]
    return Offered(tuple(candidates), blocks, (*single, *_families(candidates, blocks)))


def physics(state: State, *, sag: bool) -> tuple[Candidate, ...]:
    """Return what the catalogue offers for a recording, frames and geometry apart, which are refitted anyway.

    Args:
        state: Of the recording.
        sag: Whether compliances of joints are hypotheses; they are not where the null model refits them.
    """
    still = dataclasses.replace(
        state,
        force=np.zeros_like(state.force),
        moment=np.zeros_like(state.moment),
        load_torque=np.zeros_like(state.load_torque),
    )
    found: dict[object, Candidate] = {}
    for effect in catalogue():
        refitted = effect.has(Trait.FRAMES) or effect.has(Trait.GEOMETRY)
        if refitted or (effect.name == SAG and not sag):
            continue
        offered: list[Candidate] = []
        if effect.absolute:
            offered += effect.candidates(still)
        if effect.loaded and state.loaded:
            offered += effect.candidates(state)
        for candidate in offered:
            if candidate.location.get("robot") == "all joints":
                continue  # a family
            if effect.name == WAVE and number_of(candidate) > SINGLE_ORDERS:
                continue
            found.setdefault(candidate.key, candidate)
    return in_each_recording(tuple(found.values()), state)


def high_orders(model: NullModel, rows: Int1D) -> tuple[Candidate, ...]:
    """Return the transmission errors of more than `SINGLE_ORDERS` cycles a turn that a recording may show.

    A strain-wave gear errs once and twice a turn of its wave generator: 50 to 320 times a turn of the joint.  All that
    the angles resolve would be thousands of columns: those are offered that take most off the squares that the null
    model leaves (the periodogram of Lomb 1976 and Scargle 1982, through the null model).
    """
    state, found = model.state, list[Candidate]()
    top = {j: transmission_error.distinguishable_orders(state.q[rows, j]) for j in state.chain.revolute}
    if max(top.values(), default=0) <= SINGLE_ORDERS:
        return ()
    flat, residual = model.flat(rows)
    basis = np.linalg.qr(flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300))[0]
    residual = residual - basis @ (basis.T @ residual)
    for joint, highest in top.items():
        orders = range(SINGLE_ORDERS + 1, highest + 1)
        waves = [transmission_error.harmonic(joint, state.chain.joints[joint], k, state.rated_load) for k in orders]
        columns = model.moves(waves, rows)
        columns -= basis @ (basis.T @ columns)
        pairs = columns.reshape(len(residual), -1, 2)  # sine and cosine
        square, shown = np.einsum("rka,rkb->kab", pairs, pairs), np.einsum("rka,r->ka", pairs, residual)
        taken = np.einsum("ka,ka->k", shown, np.linalg.solve(square, shown[:, :, None])[:, :, 0])
        found += [waves[k] for k in np.argsort(-taken)[:STRONGEST]]
    return tuple(found)


def _families(candidates: Sequence[Candidate], blocks: Sequence[slice]) -> Iterable[Hypothesis]:
    laws: dict[tuple[str, str], list[int]] = {}
    waves: dict[str, list[int]] = {}
    for index, candidate in enumerate(candidates):
        if set(candidate.location) != {"joint"} or candidate.family == FAMILY:  # a zero is lost at one joint
            continue
        if candidate.effect == WAVE:
            waves.setdefault(str(candidate.location["joint"]), []).append(index)
        else:
            laws.setdefault((candidate.effect, candidate.variant), []).append(index)
    for (_, variant), members in laws.items():
        if len(members) >= FEWEST:
            yield _hypothesis(candidates, blocks, members, {"joints": ALL}, variant)
    for low, high in BANDS:
        within = {
            joint: [i for i in several if low <= number_of(candidates[i]) <= high] for joint, several in waves.items()
        }
        variant = f"orders {low} to {high}"
        if not any(len(members) > 1 for members in within.values()):
            continue  # the recording carries none of these orders
        for joint, members in within.items():
            if len(members) > 1:
                yield _hypothesis(candidates, blocks, members, {"joint": joint}, variant)
        if len(within) >= FEWEST:
            yield _hypothesis(candidates, blocks, list(itertools.chain(*within.values())), {"joints": ALL}, variant)


def _hypothesis(
    candidates: Sequence[Candidate],
    blocks: Sequence[slice],
    members: Sequence[int],
    location: Mapping[str, str | tuple[str, ...]],
    variant: str,
) -> Hypothesis:
    first = candidates[members[0]]
    columns = np.concatenate([np.arange(blocks[i].start, blocks[i].stop) for i in members])
    shape = first.shape if len(members) == 1 else None
    return Hypothesis(first.effect, first.family, dict(location), variant, tuple(members), columns, shape=shape)
