"""The controller's state: what drivers say, in our own words, and what an operator confirms."""

from calibration.tables import shipped

FOLDER = shipped("drivers")
GENERIC = "generic"  # a table of the user's own
NAMES = (*sorted(path.stem for path in FOLDER.glob("*.yaml")), GENERIC)
