"""A report as files: the same document as HTML and as PDF."""

from __future__ import annotations

import hashlib

from calibration_core.identification.estimate import OperatingSpace
from calibration_core.report.document import Document
from calibration_core.report.html import render_html
from calibration_core.report.output import REPORT_HTML, REPORT_PDF, Content
from calibration_core.report.pdf import render_pdf


def rendered(document: Document, space: OperatingSpace) -> dict[str, Content]:
    """Return `report.html` and `report.pdf`: file name -> content.

    Args:
        document: What it says.
        space: The operating space, for the scene that can be turned.
    """
    return {REPORT_HTML: render_html(document, space), REPORT_PDF: render_pdf(document)}


def document_number(result: bytes) -> str:
    """Return a report's number: a short digest of its result.json; the same for the same result."""
    digest = hashlib.sha256(result).hexdigest()
    return f"{digest[:4]}-{digest[4:8]}-{digest[8:12]}".upper()
