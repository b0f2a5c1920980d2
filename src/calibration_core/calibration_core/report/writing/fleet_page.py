"""The report of a fleet as one HTML file: the printed part, and a table of all robots to search and sort."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from calibration_core.report.document import Document
from calibration_core.report.view3d import script_safe
from calibration_core.report.writing.html import LAMPS, templates


def render_fleet_html(document: Document, data: Mapping[str, Any]) -> bytes:
    """Return the report as HTML, UTF-8, that needs nothing else.

    Args:
        document: The printed part.
        data: What the table of all robots shows; plain values for JSON.
    """
    text = script_safe(data)
    page = (
        templates()
        .get_template("fleet.html.j2")
        .render(doc=document, lamps=LAMPS, scene="", program="", data=Markup(text))
    )
    return page.encode()
