"""The report as one HTML file that needs nothing else: figures, 3-D scene and its program are inside."""

from __future__ import annotations

import base64

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from calibration_core.report.document import Document, Figure
from calibration_core.report.figures.style import parts
from calibration_core.report.view3d import View, script, script_safe

MOST_SHRUNK = 0.75  # share of the text's width; a wider diagram would be illegible on a telephone, and scrolls
LAMPS = {"yes": "●", "with_reservations": "▲", "no": "■"}  # distinguished by their shape, not by colour alone


def render_html(document: Document, view: View | None) -> bytes:
    """Return the report as HTML, UTF-8.

    Every text is escaped; only the scene (JSON without `<`, `>` and `&`) and its program are placed as they are.

    Args:
        document: What it says.
        view: What is drawn in space, in the place of the figure that is `turnable`; None without such a figure.
    """
    template = templates().get_template("report.html.j2")
    if view is not None and any(figure.turnable for figure in document.figures()):
        scene, program = script_safe(view.json()), script()
    else:
        scene = program = ""
    page = template.render(doc=document, lamps=LAMPS, scene=Markup(scene), program=Markup(program))
    return page.encode()


def templates() -> Environment:
    """Return the environment of the reports' templates: every value is escaped, and has to be there."""
    environment = Environment(
        loader=PackageLoader("calibration_core.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["images"] = _images
    return environment


def _images(figure: Figure) -> list[dict[str, object]]:
    """Return the diagrams of a figure: content, what it shows, width in % of the text's, and whether it may shrink."""
    found = parts(figure.svg)
    words = [f"{figure.alt} ({number} of {len(found)})" for number in range(1, len(found) + 1)]
    return [
        {
            "content": base64.b64encode(svg).decode("ascii"),
            "alt": alt if len(found) > 1 else figure.alt,
            "percent": round(100 * share, 2),
            "wide": share > MOST_SHRUNK,
        }
        for (svg, share), alt in zip(found, words, strict=True)
    ]
