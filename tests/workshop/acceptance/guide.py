"""Follow `ampc_ros/doc/my_car.md` with CommonRoad vehicle 2 over ROS as the real car.

`python -m tests.workshop.acceptance.guide` executes every command of the guide with only mass and
wheelbase of the car known, drives in wall time, and prints how long each step takes.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from launch_scripts.reporting.pages import markdown_table
from launch_scripts.run.processes import Processes
from tests.workshop.acceptance.independent_plant import assumed_parameters
from tests.workshop.acceptance.trials import INDEPENDENT

SCRIPTS = Path("launch_scripts")
DRIVE_TIME_OUT = 400.0
"""Wall time of a drive, with compilation [s]."""


def script(name: str, *arguments: str, allowed: Sequence[int] = (0,)) -> None:
    """Run a command of the guide.

    Raises:
        RuntimeError: Its exit code is not allowed.
    """
    done = subprocess.run([sys.executable, str(SCRIPTS / f"{name}.py"), *arguments], check=False)
    if done.returncode not in allowed:
        raise RuntimeError(f"{name}: exit code {done.returncode}")


def drive(folder: Path, control: dict[str, object], route: dict[str, object]) -> None:
    """Drive the real car with recorder, planner and controller until it stands.

    Raises:
        RuntimeError: The car does not end its drive in time.
    """
    vehicle = {"vehicle": control["vehicle"]}
    with Processes(folder / "log") as nodes:
        nodes.start(
            "recorder", "ampc_msgs_config.nodes.recorder_node", {"output": str(folder / "bag")}
        )
        waits = {"wait_for_recorder": True}
        nodes.start("planner", "ampc_ros.nodes.planner_node", waits | vehicle | route)
        settings = {"static_path": True, "store_estimates": False}
        nodes.start("controller", "ampc_ros.nodes.controller_node", waits | settings | control)
        nodes.start("car", "tests.workshop.acceptance.real_car_node", vehicle | route)
        until = time.monotonic() + DRIVE_TIME_OUT
        while not (ended := nodes.ended()):
            if time.monotonic() > until:
                raise RuntimeError(f"{folder}: the drive has not ended after {DRIVE_TIME_OUT:g} s")
            time.sleep(0.2)
        if ended.get("car") != 0:
            raise RuntimeError(f"{folder}: {[nodes.last_line(name) for name in ended]}")


def errors_of(folder: Path) -> str:
    """Return RMS and largest cross-track error of a drive."""
    script("report", str(folder / "bag"), "--output", str(folder / "report.html"))
    (found,) = json.loads((folder / "report.json").read_text(encoding="utf-8"))["drives"]
    metrics = found["summary"]
    rms, most = (metrics[f"{name}_cross_track_error"] for name in ("rms", "max"))
    return f"RMS {rms:.3f} m, largest {most:.3f} m"


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow the guide and print the table of times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/guide"), help="new folder")
    folder = parser.parse_args(arguments).output
    folder.mkdir(parents=True)
    rows, console = list[tuple[str, str, str]](), Console(soft_wrap=True, highlight=False)
    begin = time.monotonic()

    def step(name: str, result: str = "") -> None:
        nonlocal begin
        rows.append((name, f"{time.monotonic() - begin:.0f}", result))
        console.print(f"{name}: {rows[-1][1]} s {result}", markup=False)
        begin = time.monotonic()

    car, _ = assumed_parameters(INDEPENDENT)
    template, path = folder / "my_car.yaml", folder / "manoeuvre.csv"
    sheet = ["--mass", f"{car.mass:.0f}", "--wheelbase", f"{car.wheelbase:.3f}"]
    script("new_car", *sheet, "--output", str(template))
    step("Data sheet: `new_car.py`")

    manoeuvre = ["--manoeuvre", "identification", "--vehicle", str(template)]
    script("start", *manoeuvre, "--write-path", str(path))
    control: dict[str, object] = {
        "vehicle": str(template),
        "controller": "pure_pursuit",
        "settings": "identification",
    }
    drive(folder / "manoeuvre", control, {"path": str(path)})
    step("Drive: the manoeuvre, recorded")

    identified = folder / "identified"
    bag = str(folder / "manoeuvre" / "bag")
    script("identify", bag, "--vehicle", str(template), "--output", str(identified))
    step("Identify: `identify.py`")

    vehicle = str(identified / "identified.yaml")
    script("tune", "--vehicle", vehicle, "--output", str(folder / "my_gains.yaml"))
    table = str(folder / "my_gains.yaml")
    step("Tune: `tune.py`")

    options = ["--vehicle", vehicle, "--gain-table", table]
    script("certify", *options, allowed=(0, 1))
    certificate = json.loads(next(Path(table).parent.glob("*.certificate.json")).read_text())
    failures = "; ".join(certificate["failures"])
    step("Certify: `certify.py`", failures or "certified")

    control = {"vehicle": vehicle, "gain_table": table, "guard": "track"}
    route: dict[str, object] = {"scenario": "sc1_falcone", "speed": 13.0}
    drive(folder / "drive", control, route)
    step("Drive: double lane change at 13 m/s", errors_of(folder / "drive"))
    total = sum(float(row[1]) for row in rows)
    rows.append(("total", f"{total:.0f}", ""))
    text = "\n".join(markdown_table(("step", "time [s]", "result"), rows, "lrl"))
    (folder / "guide.md").write_text(text + "\n", encoding="utf-8")
    console.print(text, markup=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
