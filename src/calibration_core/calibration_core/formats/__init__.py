"""The calibrated robot in the formats of others: URDF, Denavit-Hartenberg rows, Universal Robots, MuJoCo, tables."""
