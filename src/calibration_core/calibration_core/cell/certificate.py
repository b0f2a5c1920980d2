"""Who calibrates for whom, and where: what a certificate states besides the result (ISO/IEC 17025, 7.8)."""

from __future__ import annotations

from calibration_core.cell.values import Strict


class Certificate(Strict):
    """Names on the certificate; all optional.

    Attributes:
        laboratory: Name and address of the laboratory.
        customer: Name and address of the customer.
        place: Where the robot stood when it was measured.
        operator: Who measured.
    """

    laboratory: str = ""
    customer: str = ""
    place: str = ""
    operator: str = ""
