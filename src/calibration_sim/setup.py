from setuptools import setup

# The rest stands in pyproject.toml.  The two data files make the package known to ament.
setup(
    python_requires=">=3.11",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/calibration_sim"]),
        ("share/calibration_sim", ["package.xml"]),
    ],
)
