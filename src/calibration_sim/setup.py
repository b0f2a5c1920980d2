from setuptools import find_packages, setup

# The rest stands in pyproject.toml, which colcon does not read: what it needs stands here as well.  The two data files
# make the package known to ament.
setup(
    name="calibration_sim",
    version="0.1.0",
    packages=find_packages(include=["calibration_sim", "calibration_sim.*"]),
    entry_points={"console_scripts": ["simulated_cell = calibration_sim.executable:simulated_cell"]},
    python_requires=">=3.11",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/calibration_sim"]),
        ("share/calibration_sim", ["package.xml"]),
    ],
)
