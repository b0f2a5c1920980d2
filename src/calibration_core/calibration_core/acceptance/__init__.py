"""Whether a calibration serves: against a tolerance, for how long, and beside another one."""
