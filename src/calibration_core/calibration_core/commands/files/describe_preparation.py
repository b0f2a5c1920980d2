"""What the results of `init`, `check`, `import`, `plan`, `simulate`, `export` and `fleet` say."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from calibration_core.commands.files.result_parts import (
    FEW,
    Content,
    finite,
    known,
    mm,
    number,
    numbers,
    part,
    records,
    texts,
)
from calibration_core.errors import rounded_up
from calibration_core.report.rounding import counted, fixed, length_in_words, listed, phrase, significant, spread

CONSPICUOUS = "conspicuous"


def _init(result: Content) -> Iterable[str]:
    joints, rated, guessed = texts(result, "joints"), number(result, "rated_load"), texts(result, "guessed")
    if joints and known(rated):
        yield f"The cell file is {result.get('cell')}: {counted(len(joints), 'joint')}, rated load {rated:g} kg."
    if guessed:
        yield f"Usual values, which have to be measured, stand for: {', '.join(guessed)}."
    yield "Next step: calibration check says what the cell file means and what is wrong with it."


def _check(result: Content) -> Iterable[str]:
    yield f"The cell file {result.get('cell')} can be used."
    yield from (f"{one.get('what')}: {one.get('text')}" for one in records(result, "meaning"))
    for one in records(result, "unusual"):
        yield f"Unusual: {one.get('place')}: found {one.get('found')}, expected {one.get('expected')}"
    yield from (f"{one.get('role')} ({one.get('topic')}): {one.get('text')}" for one in records(result, "topics"))
    yield from texts(result, "readings")
    if result.get("recording"):
        yield f"Next step: calibration identify {result['recording']} with this cell file."
    else:
        yield "Next step: calibration plan chooses what to measure; or calibration identify evaluates a recording."


def _import(result: Content) -> Iterable[str]:
    for one in records(result, "sources"):
        taken = listed([str(column.get("meaning")) for column in records(one, "columns")], limit=20)
        what = f": taken as {taken}" if taken else ""
        yield f"{one.get('file')}, {one.get('rows')} rows, {one.get('form')}{what}."
        if texts(one, "ignored"):
            yield f"Not used of it: {', '.join(texts(one, 'ignored'))}."
    yield from texts(result, "account")
    yield "Next step: calibration identify evaluates the measurement table with the cell file of the robot."


def _plan(result: Content) -> Iterable[str]:
    spares, force = number(result, "spares"), number(result, "largest_force")
    if known(spares) and spares:
        yield f"{counted(int(spares), 'spare configuration')} may take the place of others."
    if known(force) and force:
        yield f"The largest force is {force:,.0f} N."
    phases = [f"{name.replace('_', ' ')} {count}" for name, count in part(result, "preparation").items()]
    if phases:
        yield f"Postures of the phases before: {', '.join(phases)}."
    judged, geometry = part(result, "verify"), part(result, "geometry")
    if judged:
        yield from _verified(judged)
    elif geometry:
        yield from _geometry(geometry)
    else:
        yield from _expected(part(result, "expected"), texts(result, "joints"))
    yield from _population(part(result, "population"))
    yield from (f"{one.get('place')}: {one.get('text')}." for one in records(result, "notes"))
    if judged:
        tolerance = number(judged, "tolerance")
        stated = f"--tolerance {tolerance:g}" if known(tolerance) else "tolerance"
        options = f"the same model, {stated} and --fit-tracker"
        yield f"Next step: measure the plan, then run calibration verify with {options}."
    elif part(result, "population"):
        yield "Next step: measure the plan, then run calibration diagnose with the same --population."
    else:
        yield "Next step: measure the plan, then run calibration identify."


def _expected(expected: Content, joints: list[str]) -> Iterable[str]:
    """Say what a plan for stiffness is expected to give."""
    deviations = numbers(expected, "stiffness_std")
    if joints and len(deviations) == len(joints):
        shares = [
            f"{joint} {f'{spread(100 * std)} %' if known(std) else 'not at all'}"
            for joint, std in zip(joints, deviations, strict=True)
        ]
        yield f"Expected standard deviation of the stiffness: {', '.join(shares)}."
    yield _quality(expected, number(expected, "condition"))
    yield _duration(expected)


def _geometry(found: Content) -> Iterable[str]:
    """Say what a plan for frames and geometry is expected to give."""
    parameters, hidden = part(found, "std"), texts(found, "not_identifiable")
    if parameters:
        yield f"{counted(len(parameters), 'parameter')} of frames and geometry are found; report and result name each."
    yield f"Parameters that stay nominal: {', '.join(hidden)}." if hidden else ""
    yield _quality(found, number(part(found, "observability"), "condition"))
    yield _duration(found)


def _quality(of: Content, condition: float) -> str:
    """Say how good a choice is, as far as that is known."""
    efficiency = number(of, "efficiency")
    parts = [f"reaches at least {fixed(100 * efficiency, 1)} % of what any choice could" if known(efficiency) else ""]
    parts += [f"has the condition number {significant(condition, 3)}" if known(condition) else ""]
    stated = [text for text in parts if text]
    return f"By criterion {of.get('criterion')} the choice {phrase(stated)}." if stated else ""


def _duration(of: Content) -> str:
    total = number(part(of, "duration"), "total")
    return f"It takes about {fixed(total / 60, 0)} minutes without spares." if known(total) else ""


def _verified(judged: Content) -> Iterable[str]:
    """Say what the poses of a re-check decide."""
    tolerance, risk = number(judged, "tolerance"), number(judged, "risk")
    least, uncertainty = number(judged, "least_tolerance"), number(judged, "standard_uncertainty")
    missed = texts(judged, "missed")
    if known(tolerance, risk):
        yield (
            f"The poses decide whether a calibration holds within the tolerance of {mm(tolerance)}, with a risk of "
            f"either wrong answer of {100 * risk:g} %."
        )
    if missed:
        yield f"They do not decide on changes of {listed(missed)}."
    elif judged.get("decides") is True:
        yield "Any single change that reaches the tolerance in 5 % of the operating space is seen."
    if known(least):
        smallest = significant(1e3 * rounded_up(least), 3)
        yield f"The smallest tolerance with these poses and instruments is {smallest} mm."
    if known(uncertainty):
        yield f"The standard uncertainty of the least certain reading is {mm(uncertainty)}."


def _population(found: Content) -> Iterable[str]:
    """Say what robots of the same type are worth to a plan."""
    accuracy, count = number(found, "accuracy"), number(found, "configurations")
    if known(accuracy):
        needed = counted(int(count), "configuration") if known(count) else "more configurations than can be planned"
        wanted = f"A standard deviation of {100 * accuracy:g} % of every stiffness"
        yield f"{wanted} takes {needed} with the population of type {found.get('type')}."


def _simulate(result: Content) -> Iterable[str]:
    model, moved, seed = part(result, "model"), part(result, "deflection"), result.get("noise_seed")
    kind = "an identified model" if model.get("identified") is True else "the cell file's model"
    noise = "without noise" if seed is None else f"with noise of seed {seed}"
    yield f"The readings are those that {kind} predicts, {noise}."
    if known(largest := number(moved, "largest")):
        yield f"The loads move {moved.get('point')} by {mm(largest)} at most."
    yield from (f"{one.get('place')}: {one.get('text')}." for one in records(result, "notes"))
    yield "Next step: calibration identify evaluates the recording."


def _export(result: Content) -> Iterable[str]:
    files, left = texts(result, "files"), texts(result, "effects_left_out")
    yield f"The calibrated robot is written in the format {result.get('format')}: {', '.join(files)}."
    for one in records(result, "deviations"):
        sizes = number(one, "largest"), number(one, "rms")
        if known(*sizes):
            largest, rms = map(length_in_words, sizes)
            postures = f"{finite(one.get('postures')):,.0f} postures"
            yield f"Deviation of {one.get('what')}: largest {largest}, root mean square {rms}, at {postures}."
    for key, what in (("effects_folded", "in the geometry that is written"), ("effects_held", "written beside it")):
        yield f"Effects {what}: {'; '.join(texts(result, key))}." if texts(result, key) else ""
    yield f"Effects that this format does not hold: {'; '.join(left)}." if left else ""
    yield from texts(result, "notes")
    if left:
        yield "Next step: correct the targets by calibration compensate, which takes all effects into account."
    else:
        yield "Next step: give the files to the program that takes them in place of the nominal robot."


def _fleet(result: Content) -> Iterable[str]:
    counts, robots, types = part(result, "recordings"), records(result, "robots"), part(result, "types")
    every, failed = number(counts, "all"), number(counts, "failed")
    if known(every, failed):
        yield f"{counted(int(every), 'recording')}, of which {fixed(failed, 0)} cannot be used."
    standing_out = [one for one in robots if one.get("state") == CONSPICUOUS]
    kinds = f"{counted(len(robots), 'robot')} of {counted(len(types), 'type')}"
    yield f"Of {kinds}, {len(standing_out)} are conspicuous."
    for one in standing_out[:FEW]:
        reasons = "; ".join(str(reason.get("text")) for reason in records(one, "reasons"))
        yield f"Robot {_robot(one)}: {reasons}."
    failures = records(result, "failures")
    yield from (f"Cannot be used: {one.get('recording')}: {one.get('error')}" for one in failures[:FEW])
    proposals = records(result, "next_measurements")
    if proposals:
        first = proposals[0]
        yield f"Proposed next measurements: {len(proposals)}; the first, {_robot(first)}: {first.get('why')}."
    if standing_out:
        yield f"Next step: look at the robot {_robot(standing_out[0])} first; report.html shows its history."
    elif failures:
        yield "Next step: put right the recordings that cannot be used, and run calibration fleet again."
    elif proposals:
        yield f"Next step: measure the robot {_robot(proposals[0])}."
    else:
        yield "Next step: none is needed."


def _robot(of: Content) -> str:
    return f"{of.get('type')} {of.get('robot')}"


OF_PREPARATION: Mapping[str, Callable[[Content], Iterable[str]]] = {
    "init": _init,
    "check": _check,
    "import": _import,
    "plan": _plan,
    "simulate": _simulate,
    "export": _export,
    "fleet": _fleet,
}
