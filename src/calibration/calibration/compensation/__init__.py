"""Corrected targets for a calibrated, loaded robot, as services."""
