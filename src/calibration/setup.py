from glob import glob

from setuptools import find_packages, setup

NODES = (
    "compensation",
    "force_torque",
    "guard",
    "identification",
    "manager",
    "panel",
    "recorder",
    "sequencer",
    "tracker",
)
CONFIG = [f"../../config/{name}" for name in ("simulation.yaml", "cell.rviz", "foxglove.json")]

setup(
    name="calibration",
    version="0.1.0",
    description="Runs an elastostatic calibration in a robot cell.",
    license="Apache-2.0",
    maintainer="The calibration authors",
    maintainer_email="maintainers@users.noreply.github.com",
    python_requires=">=3.11",
    packages=find_packages(include=["calibration", "calibration.*"]),
    package_data={"calibration": ["py.typed", "loopback.xml", "web/static/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/calibration"]),
        ("share/calibration", ["package.xml"]),
        ("share/calibration/launch", sorted(glob("launch/*.launch.py"))),  # noqa: PTH207
        ("share/calibration/security", sorted(glob("security/*.xml"))),  # noqa: PTH207
        ("share/calibration/config", CONFIG),
        ("share/calibration/config/drivers", sorted(glob("../../config/drivers/*.yaml"))),  # noqa: PTH207
        ("share/calibration/config/trackers", sorted(glob("../../config/trackers/*.yaml"))),  # noqa: PTH207
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={"console_scripts": [f"{name} = calibration.executables:{name}" for name in NODES]},
)
