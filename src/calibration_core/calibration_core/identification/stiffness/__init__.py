"""Joint stiffness from loaded steps: problem, fit, outlier rejection, proof on what was left out, prediction."""
