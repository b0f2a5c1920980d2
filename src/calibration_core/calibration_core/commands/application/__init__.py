"""A calibrated robot put to use: deflection under load, corrected targets, other formats."""
