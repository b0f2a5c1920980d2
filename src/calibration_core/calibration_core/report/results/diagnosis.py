"""result.json of a diagnosis: the fixed keys, further keys after them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import Comparison, ImprovedSimulation
from calibration_core.diagnosis.location import Located
from calibration_core.diagnosis.model_estimate import without_compliance
from calibration_core.diagnosis.result.finding import Diagnosis, Finding
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.identification.result.observability import joint_stiffness
from calibration_core.recording.source import digests_of_several
from calibration_core.report.diagnosis_summary import compared_summary, diagnosis_summary
from calibration_core.report.results.result import anomaly_record, plain, result_dict, stiffness_row, tested
from calibration_core.report.results.traffic_light import light_of, with_light
from calibration_core.report.results.verdict import ResidualVerdict, rest
from calibration_core.report.summary import summary


def diagnosis_dict(diagnosis: Diagnosis, cell: Cell) -> dict[str, Any]:
    """Return the content of result.json; numbers that are not finite are None."""
    content = result_dict(diagnosis.identification, cell, "diagnose", further_files(diagnosis))
    content["stiffness"] = [stiffness_row(joint) for joint in extended_joints(diagnosis)]
    content["fit"] = {
        "rms_before": diagnosis.rms_before,
        "rms_after": diagnosis.rms_after,
        "held_out_rms_before": diagnosis.held_out_before,
        "held_out_rms_after": diagnosis.held_out_after,
        "noise": diagnosis.noise,
        "unit": "m",
        "held_out_freedom": content["fit"]["held_out_freedom"],
        **diagnosis.further_figures,
    }
    content |= judgement(diagnosis)
    content["next_measurements"] = [
        {
            "q": list(proposal.q),
            "wrench": list(proposal.wrench),
            "why": proposal.why,
            "steps": [list(step) for step in proposal.steps],
            "gain": proposal.gain,
            "gain_at_random": proposal.gain_at_random,
            "gain_unit": proposal.gain_unit,
        }
        for proposal in diagnosis.next_measurements
    ]
    content["next_text"] = diagnosis.next_text
    content["located"] = list(diagnosis.located)
    content["where"] = None if diagnosis.where is None else where_dict(diagnosis.where)
    content["small_effects"] = {"signal_to_noise": diagnosis.level}
    content["blocks"] = {kind: {"before": b, "after": a} for kind, (b, a) in diagnosis.blocks.items()}
    content["test"] = None if diagnosis.test is None else vars(diagnosis.test)
    content["aliases"] = list(diagnosis.aliases)
    compared = [comparison_dict(one) for one in diagnosis.comparisons]
    content["comparison"] = compared[0] if compared else None
    if diagnosis.identification.together is not None:
        content["comparisons"] = compared
    content = with_light({key: plain(value) for key, value in content.items()})
    light = light_of(content).lines
    if compared and diagnosis.identification.together is None:
        return {**content, "summary": compared_summary(diagnosis, diagnosis.comparisons[0], light)}
    return {**content, "summary": [*light, *diagnosis_summary(diagnosis).splitlines()]}


def judgement(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return verdict, findings, anomalies and what stays unexplained: the same in every result that looked for them.

    Outliers alone are those of the fit that the result is about: `identify` names the readings that it did not use.
    """
    left = diagnosis.rest
    return {
        "verdict": diagnosis.verdict,
        "findings": [_finding(finding) for finding in diagnosis.findings],
        "anomalies": [anomaly_record(anomaly) for anomaly in diagnosis.anomalies],
        "unexplained": {
            "rms": left.rms if left.significant else 0.0,
            "significant": left.significant,
            "where": dict(left.where) if left.significant else {},
            "text": left.text,
        },
    }


def identified_dict(found: Identification, searched: Diagnosis | None, cell: Cell) -> dict[str, Any]:
    """Return the content of the result.json of `identify`, judged by the search for missing physics.

    Args:
        found: What was identified with the standard's model.
        searched: What the search says; None where there could be none: the residual alone then judges.
        cell: The cell.
    """
    content = result_dict(found, cell)
    if searched is not None:
        content = with_light({**content, **plain(judgement(searched))}, further=_against(found, searched))
    return {**content, "summary": [*light_of(content).lines, *summary(found).splitlines()]}


def unproven(found: Identification, searched: Diagnosis) -> ResidualVerdict | None:
    """Return what the identified model of positions leaves where it is more than noise and yet nothing is missing.

    Geometry and compliances that do not clearly improve configurations left out stay as the cell file states them.
    """
    left = rest(found)
    if found.kind != "absolute" or searched.verdict != "consistent" or not left.significant:
        return None
    return left


def _against(found: Identification, searched: Diagnosis) -> tuple[tuple[str, str], ...]:
    """Return what else speaks against using an identified model, with what to do about it."""
    left = unproven(found, searched)
    if left is None:
        return ()
    figures = f"{1e6 * left.seen:.0f} µm per coordinate, the noise is {1e6 * left.noise:.0f} µm"
    step = "measure more configurations, until they prove what is unknown"
    return ((f"the identified model leaves {figures}", step),)


def extended_joints(diagnosis: Diagnosis) -> tuple[JointStiffness, ...]:
    """Return the joints of the model that is written for use."""
    if diagnosis.model is None:
        return tuple(dataclasses.replace(joint, extended=None) for joint in diagnosis.identification.stiffness)
    return tuple(_extended(joint, diagnosis) for joint in diagnosis.identification.stiffness)


def _extended(joint: JointStiffness, diagnosis: Diagnosis) -> JointStiffness:
    loads = diagnosis.identification.kind != "absolute"
    if joint.extended is not None or (diagnosis.compliance_covariance is not None and loads):
        return joint.extended or joint
    value, std = diagnosis.stiffness.get(joint.joint, (np.inf, np.inf))
    if not (np.isfinite(value) and value > 0):
        fitted = joint.compliance > 0 and np.isfinite(joint.compliance_std) and bool(diagnosis.findings)
        return without_compliance(joint) if fitted and not loads else joint
    return joint_stiffness(
        joint.joint,
        1 / value,
        std / value**2,
        identifiable=joint.identifiable,
        reason=joint.reason,
        unit=joint.unit,
    )


def further_files(diagnosis: Diagnosis) -> dict[str, Mapping[str, str]]:
    """Return role -> file -> SHA-256 of second recording, given model and simulation, where there are any."""
    files, compared = tested(diagnosis.identification), diagnosis.comparisons
    if not compared:
        return files
    if len(compared) == 1:
        return {**files, "simulation": compared[0].sha256}
    return {**files, "simulation": digests_of_several((one.simulation, one.sha256) for one in compared)}


def comparison_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison with a simulation as plain values."""
    steps, postures = comparison.steps, comparison.postures
    further = () if postures is None else postures.by_configuration
    return {
        "recording": comparison.recording,
        "simulation": comparison.simulation,
        "readings": comparison.readings,
        "configurations": comparison.configurations,
        "reproduction": {**vars(comparison.reproduction), "unit": "m"},
        "differences": [
            {
                "kind": difference.kind,
                "location": dict(difference.location),
                "side": difference.side,
                "magnitude": difference.magnitude,
                "unit": difference.unit,
                "text": difference.text,
                "spoils": difference.spoils,
            }
            for difference in comparison.differences
        ],
        "step_by_step": None
        if steps is None
        else {
            "rms": steps.rms,
            "noise": steps.noise,
            "slope": steps.slope,
            "unit": "m",
            "by_configuration": [
                vars(part) for part in sorted((*steps.by_configuration, *further), key=lambda part: -part.rms)
            ],
            "by_step": [vars(part) for part in steps.by_step],
            "by_point": [vars(part) for part in steps.by_point],
        },
        "steps": [
            {
                "name": step.name,
                "what": step.what,
                "rms": step.rms,
                "held_out_rms": step.held_out_rms,
                "test_rms": step.test_rms,
                "unit": "m",
                "share": step.share,
                "share_first": step.share_first,
                "changed": [
                    {
                        "name": one.name,
                        "before": one.before,
                        "after": one.after,
                        "interval": [one.low, one.high],
                        "unit": one.unit,
                        "changed": one.changed,
                    }
                    for one in step.changed
                ],
            }
            for step in comparison.waterfall
        ],
        "pattern": comparison.pattern,
        "witnesses": [
            {**vars(one), "channels": [vars(channel) for channel in one.channels]} for one in comparison.witnesses
        ],
        "improved": None if comparison.improved is None else _improved(comparison.improved),
        "sentences": list(comparison.sentences),
    }


def _improved(improved: ImprovedSimulation) -> dict[str, Any]:
    losses = [{"files": list(one.files), "effects": list(one.effects), "costs": one.costs} for one in improved.losses]
    return {"rms": improved.rms, "test_rms": improved.test_rms, "unit": "m", "left_out": losses}


def where_dict(where: Located) -> dict[str, Any]:
    """Return the location without a hypothesis as plain values."""
    return {
        "rms": where.rms,
        "turn": where.turn,
        "shift": where.shift,
        "units": {"rms": "m", "turn": "rad", "shift": "m"},
        "joints": [vars(share) for share in where.shares],
        "dependences": [vars(dependence) for dependence in where.dependences],
        "levels": [vars(level) for level in where.levels],
        "memory": {"rms": where.memory, "chance": where.memory_chance, "unit": "m"},
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "effect": finding.effect,
        "family": finding.family,
        "location": dict(finding.location),
        "parameters": [
            {"name": one.name, "value": one.value, "std": one.std, "unit": one.unit} for one in finding.parameters
        ],
        "evidence": {
            "log_bayes_factor": finding.log_bayes_factor,
            "held_out_gain": finding.held_out_gain,
            "magnitude": finding.magnitude,
            "unit": "m",
        },
        "cannot_be_told_from": [
            {
                "effect": other.effect,
                "family": other.family,
                "location": dict(other.location),
                "log_bayes_factor": other.log_bayes_factor,
            }
            for other in finding.cannot_be_told_from
        ],
        "explanation": finding.explanation,
        "separate_by": finding.separate_by,
        "variant": finding.variant,
        "stiffness_change": dict(finding.stiffness_change),
        "refinements": list(finding.refinements),
        "law_settled": finding.law_settled,
        "shared_size": None if finding.shared_size is None else vars(finding.shared_size),
    }
