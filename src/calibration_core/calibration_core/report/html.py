"""The report as one HTML file that needs nothing else: figures, 3-D scene and its program are inside."""

from __future__ import annotations

import base64

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from calibration_core.identification.estimate import OperatingSpace
from calibration_core.report.document import Document
from calibration_core.report.space import plotly_script, space_scene


def render_html(document: Document, space: OperatingSpace) -> bytes:
    """Return the report as HTML, UTF-8.

    Every text is escaped; only the scene (JSON without `<`, `>` and `&`) and plotly.js are placed as they are.

    Args:
        document: What it says.
        space: The operating space, for the scene that can be turned.
    """
    environment = Environment(
        loader=PackageLoader("calibration_core.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["base64"] = _base64
    template = environment.get_template("report.html.j2")
    page = template.render(doc=document, scene=Markup(space_scene(space)), plotly=Markup(plotly_script()))
    return page.encode()


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")
