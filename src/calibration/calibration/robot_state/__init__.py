"""The controller's state: what drivers say, in our own words, and what an operator confirms."""

from pathlib import Path

FOLDER = Path(__file__).with_name("drivers")  # config/drivers
GENERIC = "generic"  # a table of the user's own
NAMES = (*sorted(path.stem for path in FOLDER.glob("*.yaml")), GENERIC)
