"""`calibration plan`: what is to be measured, with which loads, and what may be expected of it."""
