"""The robot as a mechanism: tree of links, MuJoCo model, static equilibrium."""
