"""Install launch_scripts as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "launch_scripts"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="User commands of AMPC for ROS 2: set-up, start, report, replay, tuning.",
    author="AMPC for ROS 2 developers",
    author_email="maintainers@ampc-ros.example.org",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=[PACKAGE, *(f"{PACKAGE}.{name}" for name in find_packages())],
    package_dir={PACKAGE: "."},  # the commands are scripts in this folder
    package_data={"": ["*.css", "*.html", "*.js", "*.json", "*.txt", "*.xml", "*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "certify = launch_scripts.certify:main",
            "compare = launch_scripts.compare:main",
            "connect = launch_scripts.connect:main",
            "identify = launch_scripts.identify:main",
            "injector = launch_scripts.nodes.injector_node:main",
            "new_car = launch_scripts.new_car:main",
            "recover = launch_scripts.recover:main",
            "replay = launch_scripts.replay:main",
            "report = launch_scripts.report:main",
            "reproduce = launch_scripts.reproduce:main",
            "start = launch_scripts.start:main",
            "tune = launch_scripts.tune:main",
            "watch = launch_scripts.watch:main",
        ]
    },
)
