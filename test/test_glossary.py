"""Names in the code are the field's: a word that nobody's textbook has is not added anew."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("calibration_core", "calibration_sim", "calibration")
# Word -> what the field says.  Looked for among the words that identifiers are made of.
INSTEAD = {
    "agenda": "measurement_queue",
    "carried": "acting_torque, fit_with_prior",
    "climb": "advance; staged model selection",
    "doubt": "standard_uncertainty",
    "doubts": "unusual",
    "itinerary": "route",
    "kin": "are_confounded",
    "ladder": "staged_model_selection",
    "nuisances": "structured_discrepancy",
    "promise": "expected_uncertainty",
    "promised": "expected",
    "realise": "generate",
    "realised": "generated",
    "rung": "stage",
    "rungs": "stages",
    "said": "describe",
    "screened": "outlier_rejection",
    "screening": "outlier_rejection",
    "sharpened": "fit_compensator_geometry",
    "tell": "report_progress, describe",
    "told": "describe, reported",
    "withheld": "rejected_candidates",
}
CONTRACT = {"cannot_be_told_from"}  # keys of result.json, which keep their names


def words(identifier: str) -> set[str]:
    """The words of an identifier: `StopLadder` and `_stop_ladder` give stop and ladder."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+", identifier)}


def identifiers(code: str) -> set[str]:
    """Every name in a file, within f-strings too, whichever Python reads it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(code)):
        named = (getattr(node, key, None) for key in ("id", "attr", "arg", "name", "asname", "module", "rest"))
        several = getattr(node, "names", ()) if isinstance(node, ast.Global | ast.Nonlocal) else ()
        for name in (*named, *several):
            found |= set(name.split(".")) if isinstance(name, str) else set()
    return found


def files() -> list[Path]:
    """The product code of all packages."""
    return [path for package in PACKAGES for path in sorted((ROOT / "src" / package / package).rglob("*.py"))]


def found() -> dict[str, dict[str, str]]:
    """File -> words of the list in its name and its identifiers, each with what the field says."""
    there = {}
    for path in files():
        names = {*identifiers(path.read_text(encoding="utf-8")), path.stem}
        if hits := {word for name in names - CONTRACT for word in words(name)} & set(INSTEAD):
            there[path.relative_to(ROOT / "src").as_posix()] = {word: INSTEAD[word] for word in sorted(hits)}
    return there


def test_no_word_of_our_own_is_added() -> None:
    assert len(files()) > 500
    assert found() == {}


def test_a_type_names_one_thing() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    core = ROOT / "src" / "calibration_core" / "calibration_core"
    for path in sorted(core.rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(path.relative_to(core).as_posix())
    assert len(homes) > 300
    assert {name: places for name, places in homes.items() if len(places) > 1} == {}
