"""Sag of a robot whose masses nobody knows: compliance times first moments, and sizes that are relative."""

from __future__ import annotations

import dataclasses

import numpy as np
from states import TIP, state_at

from calibration_core.model.chain import Chain
from calibration_core.model.effects import candidates, sizes_are_relative
from calibration_core.model.effects.state import State
from calibration_core.model.equilibrium import solve_equilibrium

M = 60
SOFT = 1e-9


def resting(chain: Chain) -> State:
    return state_at(chain, np.random.default_rng(5).uniform(-1.5, 1.5, (M, chain.n)), 0.0)


def test_moments_carry_the_sag_of_any_masses(chain: Chain) -> None:
    mass = np.array(chain.mass)
    mass[max(chain.n - 3, 0) + 1 :] = 0.0  # a wrist without weight: what is lumped with the forearm
    chain = dataclasses.replace(chain, mass=mass)
    bare = resting(dataclasses.replace(chain, mass=None, com=None))
    offered = {c.location["joint"]: c for c in candidates(bare) if c.effect == "joint_elasticity"}
    assert set(offered) == {chain.joints[j] for j in chain.revolute}
    for joint in chain.revolute[:2]:
        if any(chain.prismatic[joint:]) or not mass[joint:].any():
            continue  # a moment beyond a slide is not constant
        compliance = SOFT * np.eye(chain.n)[joint]
        q = bare.q
        sag = solve_equilibrium(chain, q, compliance, None).at.point(TIP).T - bare.point.T
        columns = offered[chain.joints[joint]].columns(bare)
        wide = columns.reshape(3 * M, -1)
        left = sag.ravel() - wide @ np.linalg.lstsq(wide, sag.ravel(), rcond=1e-12)[0]
        assert np.abs(left).max() < 1e-4 * np.abs(sag).max()


def test_sizes_are_relative_where_masses_are_guesses(chain: Chain) -> None:
    concerned = {"joint_elasticity", "off_axis_compliance"}

    def relative(one: Chain) -> set[bool]:
        here = resting(one)
        return {sizes_are_relative(c, here) for c in candidates(here) if c.effect in concerned}

    assert relative(chain) == {False}
    assert relative(dataclasses.replace(chain, inertials_known=False)) == {True}
    assert relative(dataclasses.replace(chain, mass=None, com=None)) == {True}
    waves = [c for c in candidates(resting(chain)) if c.effect == "transmission_error"]
    assert not any(sizes_are_relative(c, resting(dataclasses.replace(chain, mass=None, com=None))) for c in waves)
