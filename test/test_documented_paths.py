"""Every file and folder that the documents of the code name is there."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted(
    ROOT / "src" / name
    for name in (
        *(f"calibration_core/doc/{name}.md" for name in ("architecture", "clauses", "estimation", "extending")),
        "calibration/doc/nodes.md",
    )
)
QUOTED = re.compile(r"`([\w.]+(?:/[\w.]+)+|\w+\.(?:py|md))`")
ELSEWHERE = re.compile(
    r"share/.*|calibration/(state|event|step|conditions|permission|health|wrench)|calibration_interfaces/(msg|srv|action)/.*"
)


def files() -> list[PurePosixPath]:
    """Files of the project, without their package's folders before them and as they stand."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout: which files belong to the project is not known")
    return [PurePosixPath(line) for line in listed.stdout.splitlines()]


def stands(name: str, paths: set[str]) -> bool:
    """Whether a name is the end of a path, of a file with or without its ending or of a folder, at a path's joint."""
    return any(path == name or path.endswith(f"/{name}") for path in paths)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.stem)
def test_named_paths_are_there(document: Path) -> None:
    there = {str(part) for path in files() for part in (path, path.with_suffix(""), *path.parents)}
    named = [name for name in QUOTED.findall(document.read_text("utf-8")) if not ELSEWHERE.fullmatch(name)]
    assert [name for name in named if not stands(name, there)] == []
    assert named or document.stem not in {"architecture", "clauses", "extending"}
