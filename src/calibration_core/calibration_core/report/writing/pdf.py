"""The report as PDF, set by Typst with the fonts that it brings along; nothing is read from system or network."""

from __future__ import annotations

import dataclasses
import json
from importlib import resources
from typing import Any

import typst

from calibration_core.report.document import Document


def render_pdf(document: Document) -> bytes:
    """Return the report as PDF; the same bytes for the same document.

    The content is handed over as data and never becomes source text of the typesetter.
    """
    template = resources.files("calibration_core.report").joinpath("templates/report.typ").read_bytes()
    inputs = {"document": json.dumps(_data(document), ensure_ascii=False)}
    pdf: bytes = typst.compile(template, sys_inputs=inputs, ignore_system_fonts=True, format="pdf")
    return pdf


def _data(document: Document) -> dict[str, Any]:
    content = dataclasses.asdict(document, dict_factory=_decoded)
    content["robot"] = dict(document.facts.rows).get("Industrial robot", "")
    return content


def _decoded(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {key: value.decode() if isinstance(value, bytes) else value for key, value in items}
