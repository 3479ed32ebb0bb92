"""Parameters and files that change while the car drives: all or nothing, and without a bump."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.paths.path import Path as Reference
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import Array, Command, VehicleState
from ampc_ros.configuration import Choices, Configuration, configuration, from_yaml
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.driver_of_nodes import Driver, largest_step
from tests.ros_nodes import ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")

CHANGES: dict[str, dict[str, Any]] = {
    "gain table": {"gain_table": "preview_ordinary"},
    "settings": {"settings": "careful.yaml"},
    "guard": {"guard": "track"},
    "all": {"gain_table": "preview", "settings": "careful.yaml", "guard": "track"},
}
CAREFUL = "max_angle: 0.4\nmax_increment: 0.2\nslack_weight: 1.0e+3\n"


class Changing:
    """A supervisor that is made anew in the middle of a drive."""

    def __init__(self, config: Configuration, other: Configuration, tick: int) -> None:
        """Change at a tick."""
        self.supervisor, self.other, self.tick = Supervisor(config), other, tick
        self.ticks = 0

    @property
    def period(self) -> float:
        """Time from one step to the next [s]."""
        return self.supervisor.period

    def step(self, state: VehicleState, path: Reference) -> Command:
        """Answer a state."""
        self.ticks += 1
        if self.ticks == self.tick:
            self.supervisor.reconfigure(self.other)
        return self.supervisor.step(state, path)


@cache
def steering_of(scenario: str, choices: Choices) -> Array:
    """Return the angles of a drive without a change [rad]."""
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    road = load_scenario(scenario, vehicle.size)
    return drive(Simulation(vehicle, road), Supervisor(configuration(choices))).steering


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("scenario", ["sc2", "sc3_wind", "circle"])
def test_a_change_in_a_bend_steps_no_farther_than_an_ordinary_tick(
    scenario: str, change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("careful.yaml").write_text(CAREFUL, encoding="utf-8")
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    drive_of = load_scenario(scenario, vehicle.size)
    before = Choices(static_path=True, simulated_time=True)
    after = before._replace(**CHANGES[change])
    config, other = configuration(before), configuration(after)
    ordinary, changed = steering_of(scenario, before), steering_of(scenario, after)
    most = max(largest_step(ordinary.tolist()), largest_step(changed.tolist()))
    for tick in np.argsort(-np.abs(ordinary))[:40:10]:
        changing = Changing(config, other, int(tick) + 1)
        until = min(drive_of.duration, (tick + 5.5) * changing.period)
        part = drive_of._replace(duration=until)
        steering = drive(Simulation(vehicle, part), changing).steering
        assert len(steering) >= min(tick + 5, len(ordinary))
        assert steering[:tick].tolist() == ordinary[:tick].tolist()
        assert changing.supervisor.number == 2
        near = steering[max(tick - 1, 0) : tick + 4].tolist()
        assert largest_step(near) <= most


def test_the_counts_of_the_guard_and_the_angle_in_force_outlive_a_change() -> None:
    narrow = configuration(Choices(static_path=True))
    supervisor = Supervisor(narrow)
    supervisor._clips["rate"] = 3
    supervisor._guard.steering = 0.3
    limits = {"max_angle": (0.1,) * len(narrow.guard.speed)}
    supervisor.reconfigure(narrow._replace(guard=replace(narrow.guard, **limits)))
    assert supervisor.clips["rate"] == 3
    assert supervisor.steering == 0.3


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Driver]:
    """A controller that steers, and copies of files to break."""
    monkeypatch.chdir(tmp_path)
    Path("careful.yaml").write_text(CAREFUL, encoding="utf-8")
    Path("broken.yaml").write_text("max_angle: -1.0\n", encoding="utf-8")
    Path("fast.yaml").write_text("sample_time: 0.05\n", encoding="utf-8")
    for folder, name in (("gains", "preview_paper"), ("guards", "road")):
        text = shipped(folder)[name].read_text(encoding="utf-8")
        Path(f"{folder}.yaml").write_text(text, encoding="utf-8")
    given = {"static_path": "true", "gain_table": "gains.yaml", "guard": "guards.yaml"}
    with ros_context(**given) as executor:
        steerer = Driver(executor, ControllerNode())
        steerer.drive_for(12)
        yield steerer


def requested(changes: dict[str, Any]) -> list[Any]:
    """Return values as a request takes them."""
    return [Parameter(name, value=value).to_parameter_msg() for name, value in changes.items()]


def set_together(driver: Driver, changes: dict[str, Any]) -> Any:
    """Set parameters as one set, by the service; return the result."""
    client = driver.create_client(SetParametersAtomically, "controller/set_parameters_atomically")
    request = SetParametersAtomically.Request(parameters=requested(changes))
    return driver.answer(client, request, driving=True).result


def trigger(driver: Driver, name: str) -> Any:
    """Call a service without arguments."""
    client = driver.create_client(Trigger, f"controller/{name}")
    return driver.answer(client, Trigger.Request())


def test_a_change_over_ros_is_told_once_and_steps_no_farther_than_an_ordinary_tick(
    driver: Driver,
) -> None:
    """Change to and fro: on a busy machine late states move the wheel around some changes."""
    back = {"gain_table": "gains.yaml", "settings": "table3", "guard": "guards.yaml"}
    excess: list[float] = []
    for changes in range(1, 13):
        ordinary = driver.drive_for(20)
        begin = len(driver.commands) - 1
        chosen = CHANGES["all"] if changes % 2 else back
        assert set_together(driver, chosen).successful
        driver.drive_for(6)
        spin_until(driver.executor_of_all, lambda: len(driver.config) > changes)  # noqa: B023
        config, number = from_yaml(driver.config[-1], "controller/configuration")
        assert (number, len(driver.config)) == (changes + 1, changes + 1)
        assert config == configuration(Choices(**chosen, static_path=True))
        during = [message.position[0] for message in driver.commands[begin:]]
        excess.append(largest_step(during) - max(largest_step(ordinary), 0.005))
        if excess[-1] <= 0.0:
            return
    assert min(excess) <= 0.0, excess


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "file": ({"guard": "track", "settings": "broken.yaml"}, "max_angle = -1.0 must lie in"),
    "name": ({"settings": "careful.yaml", "gain_table": "none"}, "'none' is neither a file nor"),
    "period": ({"guard": "track", "settings": "fast.yaml"}, "sample_time = 0.05 s must stay 0.1 s"),
    "type": ({"guard": "track", "qp_fault": "yes"}, "expected 'Type.BOOL' got"),
    "fixed": ({"guard": "track", "vehicle": "ordinary"}, "vehicle"),
    "with a fault": ({"qp_fault": True, "settings": "broken.yaml"}, "max_angle = -1.0"),
}


def test_a_set_with_one_wrong_value_changes_nothing(driver: Driver) -> None:
    config = driver.node.supervisor.config
    for case, (changes, sentence) in WRONG.items():
        before = {name: driver.node.get_parameter(name).value for name in changes}
        result = set_together(driver, changes)
        assert not result.successful, case
        assert sentence in result.reason, case
        assert {name: driver.node.get_parameter(name).value for name in changes} == before, case
        assert driver.node.supervisor.config is config, case
        assert not driver.node.supervisor.qp_fault, case
        driver.drive_for(2)
        assert len(driver.config) == 1, case


def test_parameters_set_one_by_one_are_judged_one_by_one(driver: Driver) -> None:
    client = driver.create_client(SetParameters, "controller/set_parameters")
    changes = {"guard": "track", "settings": "broken.yaml", "qp_fault": True}
    results = driver.answer(client, SetParameters.Request(parameters=requested(changes))).results
    assert [result.successful for result in results] == [True, False, True]
    assert driver.node.supervisor.number == 2
    assert driver.node.supervisor.qp_fault


def test_four_hundred_changes_at_once_leave_the_node_and_its_ticks(driver: Driver) -> None:
    """Requests beyond the depth of the service are lost by the middleware."""
    client = driver.create_client(SetParameters, "controller/set_parameters")
    spin_until(driver.executor_of_all, client.service_is_ready)
    sent = 0
    known = driver.node.commands

    def are_sent() -> bool:
        nonlocal sent
        request = SetParameters.Request(parameters=requested({"qp_fault": sent % 2 == 1}))
        client.call_async(request)
        sent += 1
        return sent >= 400

    driver.drive_until(are_sent)
    driver.drive_until(lambda: driver.node.commands > known + 10)
    result = driver.answer(client, SetParameters.Request(parameters=requested({"qp_fault": False})))
    assert result.results[0].successful
    driver.drive_until(lambda: not driver.node.supervisor.qp_fault)
    assert driver.node.failed.count == 0
    assert not driver.node.was_silent


def test_reload_reads_the_files_anew_and_refuses_broken_ones(driver: Driver) -> None:
    config = driver.node.supervisor.config
    for file in (Path("gains.yaml"), Path("guards.yaml")):
        text = file.read_text(encoding="utf-8")
        file.write_text(text + "nonsense: 1\n", encoding="utf-8")
        answer = trigger(driver, "reload")
        assert not answer.success
        assert file.name in answer.message
        assert "nonsense" in answer.message
        assert driver.node.supervisor.config is config
        file.write_text(text, encoding="utf-8")
    Path("guards.yaml").write_text(shipped("guards")["track"].read_text("utf-8"), "utf-8")
    answer = trigger(driver, "reload")
    assert (answer.success, answer.message) == (True, "configuration 2")
    assert driver.node.supervisor.config.guard == configuration(Choices(guard="track")).guard
    driver.drive_for(2)


def test_a_requested_stop_lasts_until_it_is_taken_back(driver: Driver) -> None:
    spin_until(driver.executor_of_all, lambda: driver.stops[-1])
    driver.drive_for(5)
    assert driver.stops == [False, True]
    assert trigger(driver, "reset_stop").success
    driver.drive_for(2)
    assert driver.stops == [False, True, False]


def test_a_fault_that_was_chosen_at_the_start_is_in_force() -> None:
    with ros_context(qp_fault="true", static_path="true") as executor:
        driver = Driver(executor, ControllerNode())
        driver.drive_for(1)
        assert driver.node.policy.record
        assert driver.node.policy.record.qp_fault == 1.0
