"""Effects in people's words."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.diagnosis.result.finding import FoundParameter, found_parameters
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.words import effect_sentence, effect_words, people_unit, plain_name
from calibration_core.report.sections.diagnosis import parameter_row


def test_every_effect_of_the_catalogue_has_a_sentence() -> None:
    assert all(effect.sentence for effect in catalogue())


@pytest.mark.parametrize(
    ("effect", "location", "sentence"),
    [
        ("link_bending", {"link": "link_2"}, "link 2 bends"),
        ("joint_coupling", {"joints": ["joint_2", "joint_3"]}, "joint 2 and joint 3 are coupled elastically"),
        ("backlash", {"joint": "joint_a1"}, "joint_a1 has backlash"),
        ("tool_compliance", {"tool": "tool"}, "the tool gives way"),
        ("joint_zero_offset", {"joints": "all"}, "the zero of every joint is off"),
        ("thermal_growth", {}, "the robot grows with its temperature"),
        ("measurement_point_offset", {"point": "mp1"}, "target mp1 is at another place than stated"),
        ("empirical_law", {"joint": "joint_4"}, "joint 4 follows a law that fits, without a known cause"),
        ("something_new", {"joint": "joint_4"}, "something new at joint 4"),
    ],
)
def test_sentences(effect: str, location: dict[str, str | list[str]], sentence: str) -> None:
    assert effect_sentence(effect, location) == sentence


def test_names_and_units() -> None:
    assert plain_name("shoulder_pan_joint") == "shoulder_pan_joint"
    assert people_unit("N*m/rad") == "N·m/rad"


def test_names_of_effects_are_written_as_words() -> None:
    assert effect_words("off_axis_compliance") == "off-axis compliance"
    assert effect_words("pose_dependent_stiffness") == "pose-dependent stiffness"
    assert effect_words("link_bending") == "link bending"


def test_a_harmonic_is_a_number_of_waves_without_an_interval() -> None:
    assert parameter_row(FoundParameter("harmonic", 4.0, 0.0, "1")) == ("harmonic", "4", "–", "per revolution")


def test_a_compliance_is_printed_as_the_stiffness_that_it_is() -> None:
    name, value, interval, unit = parameter_row(FoundParameter("compliance_x", 2.0e-7, 1.0e-8, "rad/(N*m)"))
    assert (name, value, unit) == ("stiffness x", "5.00·10⁶", "N·m/rad")
    assert interval == "4.55·10⁶ to 5.54·10⁶"
    assert parameter_row(FoundParameter("compliance_x", 2.0e-8, 2.0e-8, "rad/(N*m)"))[2].startswith("above ")
    assert parameter_row(FoundParameter("gain", 0.02, 0.001, "1"))[1] == "0.0200"


def test_an_interval_ends_where_physics_does() -> None:
    name, value, interval, unit = parameter_row(FoundParameter("translation_x", 0.0, 1.0e-9, "m/N", least=0.0))
    assert (name, value, interval, unit) == ("translation x", "0", "0 to 1.96·10⁻⁹", "m/N")
    assert parameter_row(FoundParameter("gain", 0.001, 0.001, "1"))[2] == "−9.60·10⁻⁴ to 0.00296"
    free, positive = (Parameter(name, "1", 1.0, positive=name == "size") for name in ("shift", "size"))
    one = Candidate("any", "structure", {}, "", (free, positive), lambda state: np.zeros((state.m, 3, 2)))
    found = found_parameters(one, np.array([0.1, 0.1]), np.eye(2))
    assert [round(low, 2) for low, _ in (parameter.interval for parameter in found)] == [-1.86, 0.0]
