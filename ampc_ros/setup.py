"""Installs ampc_ros as an ament_python package."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "ampc_ros"
VIEWERS = ["viewers/ampc.rviz", "viewers/foxglove.json", "viewers/plotjuggler.xml"]

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Adaptive model predictive control of a car's lateral motion.",
    author="AMPC for ROS 2 developers",
    author_email="maintainers@ampc-ros.example.org",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[f"{PACKAGE}*"]),
    package_dir={"": "."},
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/security", ["security/policy.xml"]),
        (f"share/{PACKAGE}/viewers", VIEWERS),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "controller = ampc_ros.nodes.controller_node:main",
            "gate = ampc_ros.nodes.gate_node:main",
            "planner = ampc_ros.nodes.planner_node:main",
        ]
    },
)
