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

# Standard deviations per median absolute deviation of normally distributed numbers, 1 / quantile(3/4) (Rousseeuw and
# Croux 1993).  Earns: a scale that one gross error in four readings leaves as it is.
MAD = 1.4826

# Readings.  Two show the six numbers of a rigid motion and nothing more; twice as many show whether it fits.  Earns: a
# simulation with next to nothing in common is not compared, and says so.
FEWEST_READINGS = 4

# Nats of log Bayes factor, 150-fold odds.  Explanations that come so near to each other are not distinguishable:
# evidence is "very strong" from there on (Kass and Raftery 1995).  Earns: a bearing and what imitates it are named
# together.
EQUIVALENT = 5.0

# Typical sizes.  An explanation that must be larger to do as well is none beside one that need not.  Earns: an alias of
# a hundred times the usual size is not listed.
PLAUSIBLE = 6.0

# Standard deviations of a prior per typical size (`config/priors.yaml`): so much do robots of one class differ.
# Earns: an effect of three times the typical size is fitted as it is.
PRIOR_WIDTH = 3.0

# Chance that a recording in which nothing is missing holds a finding, of all hypotheses together (Westfall and Young
# 1993).  Earns: nothing is named in 134 recordings of the proof but one.
FALSE_ALARM = 0.01

# Findings and explanations that are listed beside one; more are no help to a reader.
LISTED = 5

# Chance, over all places, that noise alone looks like a fault of the set-up: a target or tracker that moved, a loose
# target, an arm that swings.  Earns: noise of any size shows none; a simulation's wild reading is no moved target.
FAULT_CHANCE = 1e-6

# Chance that errors of the geometry leave as much of a change that is certain without them.  Earns: geometric errors
# that go up and down over the configurations are no tracker that moved.
CONFIRMED = 1e-3

# Probability that a clean recording loses any of its readings to a rule for gross errors. Earns: gross errors of 0.5 mm
# are set aside by name, and nothing of a recording without them.
FALSE_EXCLUSION = 0.01

# Share of the readings that a rule for gross errors sets aside at most; where more would go, the model is wrong. Earns:
# gross errors of loaded recordings, judged beside the others of their configuration.
MOST_EXCLUDED = 0.05

# The same of postures at rest, which nothing but the model judges.  Earns: with 0.05 the readings that a spring of an
# arm moves most are set aside, and two springs of the proof keep the wrong law.
MOST_EXCLUDED_AT_REST = 0.02

# Share of the limit, of squares, below which a reading that was set aside is used again.  Earns: of two equal gross
# errors that hide each other's neighbours, the neighbours come back.
TAKEN_BACK = 0.5

# m.  A certain step of all points that is smaller is no tracker that was moved: so much do arms grow as they warm up.
# Earns: in one of 47 recordings under load an arm that grows with its temperature is named, and no tracker that moved.
SLIGHT_STEP = 3e-4

# Times the claimed noise of a reading.  Beside errors of the geometry, a tracker that moved is believed where no more
# than this is left of the averages: missing physics goes up and down as well.  Earns: a gravity compensator in one of
# 60 recordings is no tracker that moved.
NOTHING_ELSE = 3.0

# Configurations over which glue that creeps has come to 63 % of where it ends.  Earns: a target that creeps by 0.3 mm
# over the first 2 to 10 configurations is named; in steps alone it is not.
CREEP = (2.0, 5.0, 10.0)

# Points of the same step against which a reading must stand wrong to be the one at fault, and times the usual change of
# a distance between points.  Earns: six of 150 readings at rest that are 2 mm off are set aside, whatever the share.
OTHERS, UNUSUAL = 2, 6.0

# Standard deviation of the rate of a clock against another, before anything is seen.  Quartz clocks differ by 2e-4,
# time servers slew one by up to 5e-4.  Earns: an optical tracker whose clock gains 1.1e-3 (AUBO i5, public recording).
CLOCK_RATE = 1e-3

# Standard deviation of what that rate changes by, per square root of s.  In an hour 6e-5: a quartz that warms up by
# tens of degrees (2e-6 to 2e-5).  Earns: what an hour of motions has shown does not hide what the next one shows.
CLOCK_WANDER = 1e-6

# s, standard deviation of the offset, from which a tracker's clock counts as known.  A reading begins when everything
# has stood for 1.5 s: fifteen of these.  Earns: a long reading after one motion is taken, a guessed clock is none.
CLOCK_KNOWN = 0.1

# Share of the motion, of robot or tracker, that both must have seen at an offset.  Earns: ends of two recordings that
# resemble each other are no offset.
CLOCK_COMMON = 0.6

# Share of the squares that may be left of speeds or distances.  Earns: a clock that was set by 3 s is found anew.
CLOCK_UNLIKE = 0.1

# Standard deviations between a clock that is known and what a motion shows, from which it was set.  Earns: one that was
# set by 0.1 s is found anew, and not averaged with what it was.
CLOCK_ANEW = 5.0

# s, that a sample takes to arrive at most: stamps farther from the times of receipt are another clock's.  Earns: a
# tracker that was started again is noticed before the next motion.
CLOCK_LATE = 10.0

# Largest speed of a motion from rest to rest over its mean speed: 2 where it speeds up for half of the time and slows
# down for the other.  Earns: pendant programs that state durations (RAPID, TP) keep the bound of 250 mm/s.
MOTION_PEAK = 2.0
