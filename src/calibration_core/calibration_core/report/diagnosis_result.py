"""result.json of a diagnosis: the contract's keys (section 5), further keys after them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison import Comparison
from calibration_core.diagnosis.finding import Diagnosis, Finding
from calibration_core.diagnosis.locate import Located
from calibration_core.report.light import with_light
from calibration_core.report.result import plain, result_dict, tested


def diagnosis_dict(diagnosis: Diagnosis, cell: Cell) -> dict[str, Any]:
    """Return the content of result.json; numbers that are not finite are None."""
    content = result_dict(diagnosis.identification, cell, "diagnose", further_files(diagnosis))
    content["stiffness"] = [
        {**row, **_stiffness(*diagnosis.stiffness[row["joint"]])} if row["joint"] in diagnosis.stiffness else row
        for row in content["stiffness"]
    ]
    content["fit"] = {
        "rms_before": diagnosis.rms_before,
        "rms_after": diagnosis.rms_after,
        "held_out_rms_before": diagnosis.held_out_before,
        "held_out_rms_after": diagnosis.held_out_after,
        "noise": diagnosis.noise,
        "unit": "m",
        **diagnosis.further_figures,
    }
    content["verdict"] = diagnosis.verdict
    content["findings"] = [_finding(finding) for finding in diagnosis.findings]
    content["anomalies"] = [
        {
            "kind": anomaly.kind,
            "location": dict(anomaly.location),
            "configurations": None if anomaly.configurations is None else list(anomaly.configurations),
            "magnitude": anomaly.magnitude,
            "unit": anomaly.unit,
            "text": anomaly.text,
            **({"remedy": anomaly.remedy} if anomaly.remedy else {}),
        }
        for anomaly in diagnosis.anomalies
    ]
    rest = diagnosis.rest
    content["unexplained"] = {
        "rms": rest.rms if rest.significant else 0.0,
        "significant": rest.significant,
        "where": dict(rest.where) if rest.significant else {},
        "text": rest.text,
    }
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
    content["comparison"] = None if diagnosis.comparison is None else comparison_dict(diagnosis.comparison)
    return with_light({key: plain(value) for key, value in content.items()})


def further_files(diagnosis: Diagnosis) -> dict[str, Mapping[str, str]]:
    """Return role -> file -> SHA-256 of second recording, given model and simulation, where there are any."""
    files = tested(diagnosis.identification)
    return files if diagnosis.comparison is None else {**files, "simulation": diagnosis.comparison.sha256}


def comparison_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison with a simulation as plain values."""
    steps = comparison.steps
    return {
        "simulation": comparison.simulation,
        "readings": comparison.readings,
        "configurations": comparison.configurations,
        "reproduction": {**vars(comparison.reproduction), "unit": "m"},
        "differences": [vars(difference) for difference in comparison.differences],
        "step_by_step": None
        if steps is None
        else {
            "rms": steps.rms,
            "noise": steps.noise,
            "slope": steps.slope,
            "unit": "m",
            "by_configuration": [vars(part) for part in steps.by_configuration],
            "by_step": [vars(part) for part in steps.by_step],
            "by_point": [vars(part) for part in steps.by_point],
        },
        "sentences": list(comparison.sentences),
    }


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


def _stiffness(value: float, std: float) -> dict[str, Any]:
    return {
        "value": value,
        "std": std,
        "interval_95": [value - 1.96 * std, value + 1.96 * std],
        "compliance": 1 / value if value else None,
        "compliance_std": std / value**2 if value else None,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "effect": finding.effect,
        "family": finding.family,
        "location": dict(finding.location),
        "parameters": [vars(parameter) for parameter in finding.parameters],
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
    }
