"""The reference of result.json, made from its schema."""

from __future__ import annotations

from typing import Any

from calibration_core.report.results.schema import ResultFile

HEAD = """# result.json

What `identify`, `diagnose`, `predict`, `plan` and `simulate` write for programs. Values are in SI units. Numbers that
are not finite are `null`. Further keys may follow; a program should pass over what it does not know. The schema, for
checking: [result.schema.json](result.schema.json).
"""


def page() -> str:
    """Return the page, Markdown."""
    schema = ResultFile.model_json_schema()
    sections = [HEAD, _table("", schema)]
    sections += [f"## {name.removesuffix('Entry')}\n\n{_table(entry.get('description', ''), entry)}"
                 for name, entry in schema["$defs"].items()]  # fmt: skip
    return "\n".join(sections)


def _table(text: str, schema: dict[str, Any]) -> str:
    rows = [
        f"| `{name}` | {_kind(entry)} | {entry.get('description', '')} |"
        for name, entry in schema["properties"].items()
    ]
    return "\n".join(([text, ""] if text else []) + ["| key | value | meaning |", "|---|---|---|", *rows, ""])


def _kind(entry: dict[str, Any]) -> str:
    if "$ref" in entry:
        name = entry["$ref"].rpartition("/")[2].removesuffix("Entry")
        return f"[{name}](#{name.lower()})"
    if "anyOf" in entry:
        return " or ".join(dict.fromkeys(_kind(one) for one in entry["anyOf"]))
    if "const" in entry:
        return f"`{entry['const']}`"
    if "enum" in entry:
        return ", ".join(f"`{one}`" for one in entry["enum"])
    if entry.get("type") == "array":
        return f"list of {_kind(entry['items'])}"
    return {"string": "text", "boolean": "yes or no", "object": "mapping"}.get(
        entry.get("type", ""), entry.get("type", "")
    )
