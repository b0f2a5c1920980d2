"""The documents beside the code say what the code says."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Outcome

from calibration.node import NODE_NAMES
from calibration.process_tree import BACKENDS
from calibration.robot_state import NAMES as ADAPTERS
from calibration_core.motion.robot_status import TEXT

ROOT = Path(__file__).resolve().parents[3]
DOC = ROOT / "src" / "calibration" / "doc"


def test_the_reference_is_current() -> None:
    made = runpy.run_path(str(DOC / "reference.py"))["reference"]()
    current = (DOC / "reference.md").read_text("utf-8")
    assert current == made, "run: source install/setup.bash && .venv/bin/python src/calibration/doc/reference.py"


def test_every_reason_of_the_guard_stands_with_a_way_out() -> None:
    rows = dict(re.findall(r"^\| ([^|]+?) \| ([^|]+?) \|$", (DOC / "faults.md").read_text("utf-8"), re.MULTILINE))
    assert [text for text in TEXT.values() if len(rows.get(text, "")) < 15] == []


def test_every_outcome_stands_with_a_way_out() -> None:
    text = (DOC / "faults.md").read_text("utf-8")
    codes = [name for name in dir(Outcome) if name.isupper() and isinstance(getattr(Outcome, name), int)]
    assert [name for name in codes if f"| `{name}` |" not in text] == []


def test_every_node_back_end_and_adapter_is_described() -> None:
    text = (DOC / "nodes.md").read_text("utf-8")
    assert [name for name in (*NODE_NAMES, *BACKENDS, *ADAPTERS) if f"`{name}`" not in text] == []


@pytest.mark.parametrize("path", sorted(DOC.glob("*.md")), ids=lambda path: path.name)
def test_what_a_document_refers_to_exists(path: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text("utf-8"))
    assert [link for link in links if not (path.parent / link).exists()] == []
