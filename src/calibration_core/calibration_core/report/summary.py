"""An identification in a few lines for the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from calibration_core.identification.result.estimate import Identification, JointStiffness, Stage
from calibration_core.identification.result.tested import PARTS, TestResult
from calibration_core.report.extent import configurations_text
from calibration_core.report.rounding import DASH, STIFFNESS, counted, decimals, fixed, interval_end
from calibration_core.report.sections.together import together_lines

WIDTH, MOST_LINES = 120, 11  # of an answer on a terminal, where the report's place follows


def on_a_terminal(lines: Sequence[str], recordings: int = 1) -> list[str]:
    """Return lines as wide as a terminal, and no more of a recording than are read at once: the report has the others.

    A file's path stays whole.
    """
    most = recordings * MOST_LINES
    wrap = textwrap.TextWrapper(WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    wrapped = [part for line in lines for part in wrap.wrap(line)]
    if len(wrapped) <= most:
        return wrapped
    return [*wrapped[: most - 1], f"{counted(len(wrapped) - most + 1, 'further line')} in the report"]


def summary(found: Identification) -> str:
    """Return what came out, at most a screen long: stiffness table, fit, warnings."""
    readings = found.readings
    configurations = configurations_text(readings, len(found.space.configuration))
    counts = f"{configurations}, {counted(len(readings), 'reading')}, {counted(len(readings.points), 'point')}"
    lines = [f"{found.kind} recording{'' if found.together is None else 's'}: {counts}"]
    if found.together is not None:
        lines += together_lines(found.together)
    if found.stiffness:
        lines.append(f"{'joint':<24} {'stiffness [' + STIFFNESS.name + ']':>26}   95 % interval")
        lines += [_joint(joint) for joint in found.stiffness]
    lines += [_stage(stage) for stage in found.stages]
    fit = found.fit
    used = f", {_um(fit.rms_used)} without the readings set aside" if found.exclusions else ""
    lines.append(
        f"residual {_um(fit.rms_after)} per coordinate{used} (before {_um(fit.rms_before)}), "
        f"on held-out configurations {_um(fit.held_out_rms_after)}, noise {_um(fit.noise)}"
    )
    what = "positions" if found.kind == "absolute" else "deflections"
    lines.append(
        f"error of {what} on configurations left out, as a distance: mean {1e3 * fit.held_out_mean_after:.3f} mm, "
        f"largest {1e3 * fit.held_out_max_after:.3f} mm"
    )
    lines += positions_lines(found)
    if found.test is not None:
        lines += test_lines(found.test)
    lines += [f"anomaly: {anomaly.kind}: {anomaly.text}" for anomaly in found.anomalies]
    lines += [
        f"excluded: configuration {e.configuration}, step {e.step}, {e.point}: {e.reason}"
        for e in found.exclusions[:10]
    ]
    if len(found.exclusions) > 10:
        lines.append(f"excluded: {len(found.exclusions) - 10} more, all in the report")
    lines += [note.line for note in found.notes[:10]]
    unmet = [p for p in found.preconditions if p.met is False]
    lines += [
        f"not as the standard {'demands' if p.shall else 'recommends'} ({p.clause}): {p.requirement}: {p.found}"
        + (f" (overridden by {p.override})" if p.override else "")
        for p in unmet
    ]
    return "\n".join(lines)


def positions_lines(found: Identification) -> list[str]:
    """Return how well the absolute positions of a loaded recording fit, in a line; nothing where there are none."""
    rms = found.fit.positions
    if math.isnan(rms):
        return []
    geometry = "identified" if found.model.geometry.any() else "as stated"
    fitted = f"with tracker and targets fitted and the geometry {geometry}"
    return [f"positions, {fitted}: {1e3 * rms:.3f} mm rms per coordinate"]


def test_lines(test: TestResult) -> list[str]:
    """Return what a model does on a recording that was not fitted: the whole, its parts, and what says nothing."""
    lines = [
        (
            f"test recording {test.file}: mean error {1e3 * test.mean:.3f} mm, rms {_um(test.rms)} per coordinate "
            f"(before: mean {1e3 * test.mean_before:.3f} mm)"
        )
    ]
    for part in test.parts:
        known = f", rms {_um(part.rms_before)} -> {_um(part.rms)} per coordinate" if math.isfinite(part.rms) else ""
        remark = f": {part.reason}" if part.reason else ""
        lines.append(f"   {PARTS[part.kind]}: {counted(part.configurations, 'configuration')}{known}{remark}")
    return lines


def _stage(stage: Stage) -> str:
    kept = "kept    " if stage.kept else "not kept"
    figures = f"{1e3 * stage.rms:.4f} mm rms, held out {1e3 * stage.held_out_rms:.4f} mm"
    return f"{stage.name:<12} {kept}  {figures}: {stage.reason}"


def _joint(joint: JointStiffness) -> str:
    places = decimals(STIFFNESS.factor * joint.std)
    value = fixed(STIFFNESS.factor * joint.value, places) if math.isfinite(joint.value) else DASH
    low, high = (interval_end(STIFFNESS.factor * one, places) if math.isfinite(one) else "∞" for one in joint.interval)
    reason = f"   {joint.reason}" if joint.reason else ""
    name = joint.joint if joint.unit == "N*m/rad" else f"{joint.joint} [10⁵ N/m]"
    return f"{name:<24} {value:>26}   {low} … {high}{_beside(joint)}{reason}"


def _beside(joint: JointStiffness) -> str:
    own = joint.extended
    if own is None or not math.isfinite(own.value):
        return ""
    value = fixed(STIFFNESS.factor * own.value, decimals(STIFFNESS.factor * own.std))
    return f"   extended model {value}"


def _um(value: float) -> str:
    return f"{1e6 * value:.1f} µm"
