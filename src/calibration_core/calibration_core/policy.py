"""Numbers that decide: each with its unit, its reason or source, and the case that it earns."""

from __future__ import annotations

# Chance that a two-sided test over whole configurations says something of noise: the usual level of "highly
# significant" (Fisher 1925, Statistical Methods for Research Workers).  Earns: 1.6 % on one axis of a force sensor is
# its own fault, and a gain common to all axes, which stiffer joints explain as well, is nobody's.
CERTAIN = 0.01

# Times.  Of two that are held against the same thing, the one that is so much farther off is at fault: nine tenths of
# its squares are its own.  Earns: a simulation of another robot, without weight, or with torques about another point.
CLEARLY = 3.0

# Standard deviations of an averaged reading of the force sensor, below which two wrenches are the same.  A strain-gauge
# sensor in order lags by 0.1 % of its range to either side: 2.4 deviations in the cells of the proof.  Earns: no
# witness is heard where the instruments err as they may.
BEYOND = 4.0

# Readings.  Two show the six numbers of a rigid motion and nothing more; twice as many show whether it fits.  Earns: a
# simulation with next to nothing in common is not compared, and says so.
FEWEST_READINGS = 4
