"""Installs launch_scripts as an ament_python package."""

from setuptools import setup

PACKAGE = "launch_scripts"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Where the parts meet: start script, set-up and tests of AMPC for ROS 2.",
    author="AMPC for ROS 2 developers",
    author_email="maintainers@ampc-ros.example.org",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=[PACKAGE],
    package_dir={PACKAGE: "."},  # the modules are plain scripts at the root of this folder
    package_data={
        PACKAGE: [
            *("fastdds.xml", "page.css", "compare.html", "reproduce.html", "thresholds.yaml"),
            *("report.html", "report.css", "report.js"),
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "acceptance = launch_scripts.acceptance:main",
            "compare = launch_scripts.compare:main",
            "endurance = launch_scripts.endurance:main",
            "fuzz = launch_scripts.fuzz:main",
            "guard_margins = launch_scripts.guard_margins:main",
            "inject = launch_scripts.inject:main",
            "injector = launch_scripts.inject_node:main",
            "prove_recording = launch_scripts.prove_recording:main",
            "prove_replay = launch_scripts.prove_replay:main",
            "recover = launch_scripts.recover:main",
            "replay = launch_scripts.replay:main",
            "report = launch_scripts.report:main",
            "reproduce = launch_scripts.reproduce:main",
            "start = launch_scripts.start:main",
            "tune = launch_scripts.tune:main",
        ]
    },
)
