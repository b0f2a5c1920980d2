"""The calibrated robot as every format starts from it: one chain, its springs, and what no chain can hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import InputError, ModelFileError
from calibration_core.model.chain import Chain
from calibration_core.model.effects.absolute import geometry_error, joint_zero_offset
from calibration_core.model.effects.absolute.geometry_error import AXES
from calibration_core.model.effects.words import listed_location
from calibration_core.model.kinematics import Posture, posture
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float2D, Float3D, Note

POSTURES = 1000  # at which what is written is compared with the model
SEED = 1
MOST_CORRECTION = 10.0  # m and rad: beyond, formats lose the digits that a calibration is about
GEOMETRY = (*AXES, *(f"r{axis}" for axis in AXES))


@dataclasses.dataclass(frozen=True, eq=False)
class ExportedRobot:
    """What is exported.

    Attributes:
        nominal: The chain of the cell file.
        chain: The calibrated chain: geometry, zero offsets and frame errors of the model are in it.
        folded: Effects of the model that became part of the chain.
        further: Its other effects.
        notes: What must be stated of the model.
    """

    cell: Cell
    nominal: Chain
    chain: Chain
    parameters: ModelParameters
    folded: tuple[AppliedEffect, ...]
    further: tuple[AppliedEffect, ...]
    notes: tuple[Note, ...] = ()


@dataclasses.dataclass(frozen=True)
class Deviation:
    """How far what was written, read again, is from the model.

    Attributes:
        what: Of what, in words.
        postures: Number of random postures within the joint limits.
        largest: m.
        rms: m.
    """

    what: str
    postures: int
    largest: float
    rms: float


@dataclasses.dataclass(frozen=True, eq=False)
class Exported:
    """One format.

    Attributes:
        held: Effects of the model that the format holds beside those that were folded into the chain.
        deviations: What was written against the model.
        notes: What its reader has to know, a sentence each.
    """

    files: Mapping[str, bytes]
    held: tuple[AppliedEffect, ...] = ()
    deviations: tuple[Deviation, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Freeze the mapping."""
        object.__setattr__(self, "files", MappingProxyType(dict(self.files)))


def calibrated_robot(cell: Cell, parameters: ModelParameters, notes: Sequence[Note] = ()) -> ExportedRobot:
    """Return the robot with the model's geometry, and with its zero offsets and frame errors folded into the chain.

    Raises:
        CellError: The robot cannot be read.
        ModelFileError: The model's geometry is that of no robot.
    """
    nominal = chain_of(cell)
    chain = nominal.corrected(_possible(parameters))
    folded, further = [], []
    for effect in parameters.effects:
        after = _with_effect(chain, effect)
        if after is None:
            further.append(effect)
        else:
            chain = after
            folded.append(effect)
    return ExportedRobot(cell, nominal, chain, parameters, tuple(folded), tuple(further), tuple(notes))


def _possible(parameters: ModelParameters) -> Float2D:
    """Return the model's geometry, (n, 6); refuse corrections that no robot has."""
    largest = float(np.abs(parameters.geometry).max(initial=0.0))
    if largest > MOST_CORRECTION:
        expected = f"corrections of at most {MOST_CORRECTION:g} m or rad"
        raise ModelFileError("model", "geometry", f"{largest:g}", expected)
    return parameters.geometry


def _with_effect(chain: Chain, effect: AppliedEffect) -> Chain | None:
    """Return the chain with an effect that is one of geometry; None for all others."""
    is_frame = effect.effect == geometry_error.EFFECT.name
    if not is_frame and effect.effect != joint_zero_offset.EFFECT.name:
        return None
    joint = chain.joints.index(str(effect.location["joint"]))
    row = np.zeros((chain.n, 6))
    if not is_frame and chain.mimics:  # what mimics the joint goes with its zero
        offset = effect.parameters["offset"]
        led = [(one, one.multiplier * offset if one.driver == joint else 0.0) for one in chain.mimics]
        moved = tuple(dataclasses.replace(one, offset=one.offset + change) for one, change in led)
        chain = dataclasses.replace(chain, mimics=moved)
    if is_frame:
        row[joint] = [effect.parameters.get(name, 0.0) for name in GEOMETRY]
    elif chain.prismatic[joint]:
        row[joint, 2] = effect.parameters["offset"]
    else:
        row[joint, 5] = effect.parameters["offset"]
    return chain.corrected(row)


def refuse_mimics(robot: ExportedRobot, form: str) -> None:
    """Refuse a robot with mimic joints, for a format that has no word for them.

    Raises:
        InputError: There are some.
    """
    if robot.chain.mimics:
        found = f"mimic joints: {', '.join(one.name for one in robot.chain.mimics)}"
        expected = f"a robot whose joints all have drives of their own, for {form}; --format urdf keeps mimic joints"
        raise InputError(robot.cell.urdf_path or robot.cell.path, "joints", found, expected)


def joint_frames(chain: Chain) -> Float3D:
    """Return the (n + 1, 4, 4) poses of every joint's frame in the link before it, and of the flange in the last link.

    Offsets are folded in: T_base_flange(q) = prod_i [ P_i J_i(q_i) ] P_flange with J_i a turn by q_i about z, or a
    movement by q_i along z.
    """
    poses = np.tile(np.eye(4), (chain.n + 1, 1, 1))
    for i, offset in enumerate(chain.offset):
        c, s = np.cos(offset), np.sin(offset)
        poses[i, :3, :3] = chain.rotation[i] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        poses[i, :3, 3] = chain.translation[i]
    poses[-1, :3, :3], poses[-1, :3, 3] = chain.flange_rotation, chain.flange_translation
    return poses


def random_postures(chain: Chain, count: int = POSTURES, seed: int = SEED) -> Float2D:
    """Return (count, n) joint positions within the limits, rad (m where a joint slides)."""
    return np.random.default_rng(seed).uniform(chain.limits[:, 0], chain.limits[:, 1], (count, chain.n))


def flange_poses(at: Posture) -> Float3D:
    """Return the (m, 4, 4) poses of the flange in the base frame."""
    poses = np.tile(np.eye(4), (at.flange_origin.shape[1], 1, 1))
    poses[:, :3, :3] = np.moveaxis(at.flange, (0, 1), (2, 1))
    poses[:, :3, 3] = at.flange_origin.T
    return poses


def deviation(what: str, chain: Chain, q: Float2D, rebuilt: Float3D) -> Deviation:
    """Compare flange poses (m, 4, 4) with the chain's at q, (m, n).

    A turned flange counts by what it moves a point at the robot's reach from the flange.
    """
    expected = flange_poses(posture(chain, q))
    moved = np.linalg.norm(rebuilt[:, :3, 3] - expected[:, :3, 3], axis=1)
    turned = np.linalg.norm(rebuilt[:, :3, :3] - expected[:, :3, :3], axis=(1, 2)) * chain.reach
    error = np.maximum(moved, turned)
    return Deviation(what, len(q), float(error.max()), float(np.sqrt(np.mean(error**2))))


def named(effects: tuple[AppliedEffect, ...]) -> list[str]:
    """Return effects with their places, in words."""
    return [f"{effect.effect} at {listed_location(effect.location)}" for effect in effects]
