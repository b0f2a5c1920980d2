"""Whether a calibration still holds, and what has changed since."""
