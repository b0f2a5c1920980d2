"""What effects depend on, for the readings of a recording."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain
from calibration_core.model.effects.state import State, setups_of, state_of
from calibration_core.model.equilibrium import Equilibrium
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load
from calibration_core.timeseries import Readings, in_time


def recorded_state(
    readings: Readings,
    cell: Cell,
    chain: Chain,
    parameters: ModelParameters,
    load: Load | None,
    rest: Equilibrium | None = None,
) -> State:
    """Return the state of all m readings, in their order.

    Args:
        readings: The recording.
        cell: For the rated load.
        chain: The robot, geometry corrected.
        parameters: Compliances, points and tracker.
        load: External load of every reading; None without one.
        rest: The equilibrium, where it is known already; None: it is solved here.

    Raises:
        EquilibriumError: The compliances do not carry the loads.
    """
    return state_of(
        chain,
        readings.q,
        parameters.compliance,
        load,
        np.stack([parameters.points[name] for name in readings.points])[readings.point].T,
        point_index=readings.point,
        wrench=None if load is None else readings.wrench,
        configuration=in_time(readings.configuration),
        step=readings.step,
        time=readings.time,
        temperature=readings.temperature,
        tracker=parameters.tracker,
        rated_load=cell.robot.rated_load,
        rest=rest,
        setups=setups_of(readings, parameters),
    )
