"""Installs sim_vehicle as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "sim_vehicle"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Dual-track car with Pacejka tyres, wind, actuator and driver.",
    author="AMPC for ROS 2 developers",
    author_email="maintainers@ampc-ros.example.org",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[f"{PACKAGE}*"]),
    package_dir={"": "."},
    package_data={PACKAGE: ["py.typed", "nodes/help/*.txt"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["simulator = sim_vehicle.nodes.simulator_node:main"]},
)
