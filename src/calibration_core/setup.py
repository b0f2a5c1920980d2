from setuptools import find_packages, setup

# The rest stands in pyproject.toml, which colcon does not read: what it needs stands here as well.  The two data files
# make the package known to ament.
setup(
    name="calibration_core",
    version="0.1.0",
    packages=find_packages(include=["calibration_core", "calibration_core.*"]),
    python_requires=">=3.11",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/calibration_core"]),
        ("share/calibration_core", ["package.xml"]),
    ],
)
