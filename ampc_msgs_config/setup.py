"""Installs ampc_msgs_config as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "ampc_msgs_config"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Types, paths, scenarios, topics and recordings that car and controller share.",
    author="AMPC for ROS 2 developers",
    author_email="maintainers@ampc-ros.example.org",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[f"{PACKAGE}*"]),
    package_dir={"": "."},
    package_data={
        PACKAGE: ["py.typed", "nodes/help/*.txt", "config/**/*.yaml", "config/**/*.json"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "markers = ampc_msgs_config.nodes.marker_node:main",
            "recorder = ampc_msgs_config.nodes.recorder_node:main",
        ]
    },
)
