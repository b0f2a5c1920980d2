"""A report as files: the same document as HTML and as PDF."""

from __future__ import annotations

import hashlib

from calibration_core.report.document import Document
from calibration_core.report.view3d import View
from calibration_core.report.writing.html import render_html
from calibration_core.report.writing.output import REPORT_HTML, REPORT_PDF, Content
from calibration_core.report.writing.pdf import render_pdf


def rendered(document: Document, view: View | None) -> dict[str, Content]:
    """Return `report.html` and `report.pdf`: file name -> content.

    Args:
        document: What it says.
        view: What is drawn in space, in the place of the figure that is `turnable`; None without such a figure.
    """
    return {REPORT_HTML: render_html(document, view), REPORT_PDF: render_pdf(document)}


def document_number(result: bytes) -> str:
    """Return a report's number: a short digest of its result.json; the same for the same result."""
    digest = hashlib.sha256(result).hexdigest()
    return f"{digest[:4]}-{digest[4:8]}-{digest[8:12]}".upper()
