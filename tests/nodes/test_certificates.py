"""The controller node with certified and uncertified gain tables."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ampc_msgs_config.config import shipped
from ampc_msgs_config.types import WARN
from ampc_ros.configuration import Choices
from ampc_ros.nodes import controller_node
from ampc_ros.nodes.controller_node import ControllerNode
from tests.certificates import write_certificate
from tests.driver_of_nodes import Driver
from tests.ros_nodes import ros_context

pytestmark = pytest.mark.usefixtures("own_domain")
COMMAND = "python launch_scripts/certify.py --vehicle car.yaml --gain-table t.yaml"
CHOICES = Choices(vehicle="car.yaml", gain_table="t.yaml")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with a vehicle and a certified gain table."""
    monkeypatch.chdir(tmp_path)
    Path("car.yaml").write_text("same_as: paper\n", encoding="utf-8")
    Path("t.yaml").write_bytes(shipped("gains")["preview_paper"].read_bytes())
    Path("other.yaml").write_bytes(shipped("gains")["preview"].read_bytes())
    write_certificate(CHOICES)


@contextmanager
def driving(**parameters: str) -> Iterator[Driver]:
    """Drive with the table and return the driver."""
    fixed = {"vehicle": "car.yaml", "gain_table": "t.yaml", "static_path": "true"}
    with ros_context(**fixed, **parameters) as executor:
        driver = Driver(executor, ControllerNode())
        driver.drive_for(5)
        yield driver


def report_of(node: Any) -> tuple[int, str]:
    """Return level and message of the diagnostics that the node would publish."""
    caught: list[DiagnosticArray] = []
    publisher, node.diagnostics = node.diagnostics, SimpleNamespace(publish=caught.append)
    node.on_diagnostics()
    node.diagnostics = publisher
    status = caught[0].status[0]
    return status.level[0], status.message


@pytest.fixture
def logged(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Collect the lines about certificates."""
    lines: list[str] = []
    warn = ControllerNode.warn_uncertified

    def collect(node: ControllerNode, uncertified: str) -> None:
        lines.extend([uncertified] * bool(uncertified))
        warn(node, uncertified)

    monkeypatch.setattr(ControllerNode, "warn_uncertified", collect)
    return lines


def set_gain_table(driver: Driver, name: str) -> Any:
    """Set the gain table by the service, and return the result."""
    client = driver.create_client(SetParametersAtomically, "controller/set_parameters_atomically")
    parameter = Parameter("gain_table", value=name).to_parameter_msg()
    request = SetParametersAtomically.Request(parameters=[parameter])
    return driver.answer(client, request, driving=True).result


def test_a_certified_table_is_used_without_a_warning(logged: list[str]) -> None:
    with driving() as driver:
        assert "certified" not in report_of(driver.node)[1]
        assert set_gain_table(driver, "other.yaml").successful
        driver.drive_for(12)
        level, message = report_of(driver.node)
        assert level >= WARN
        assert "gain table other is not certified for this vehicle" in message
        assert COMMAND.replace("t.yaml", "other.yaml") in message
        assert set_gain_table(driver, "t.yaml").successful
        driver.drive_for(5)
        assert "certified" not in report_of(driver.node)[1]
    assert len(logged) == 1


def test_a_car_with_another_mass_gets_a_warning_with_the_command(logged: list[str]) -> None:
    Path("car.yaml").write_text("same_as: paper\nchassis: {mass: 1700}\n", encoding="utf-8")
    with driving() as driver:
        level, message = report_of(driver.node)
        assert level >= WARN
        assert "t.car.certificate.json is of another vehicle" in message
        assert COMMAND in message
        driver.drive_for(20)
    assert len(logged) == 1


def test_where_a_certificate_is_required_an_uncertified_table_is_rejected_at_run_time() -> None:
    with driving(require_certificate="true") as driver:
        config = driver.node.supervisor.config
        result = set_gain_table(driver, "other.yaml")
        assert not result.successful
        assert result.reason.startswith("require_certificate: gain table other is not certified")
        assert driver.node.get_parameter("gain_table").value == "t.yaml"
        Path("t.car.certificate.json").write_bytes(b"\x00" * 99)
        client = driver.create_client(Trigger, "controller/reload")
        answer = driver.answer(client, Trigger.Request(), driving=True)
        assert not answer.success
        assert "t.car.certificate.json: " in answer.message
        assert driver.node.supervisor.config is config
        driver.drive_for(5)
        assert "certified" not in report_of(driver.node)[1]


REJECTED = {
    "other table": ["gain_table:=other.yaml", "gain table other is not certified"],
    "failing table": ["gain_table:=fails.yaml", "fails: delay margin = 0.01 s"],
    "no table": ["controller:=pure_pursuit", "controller pure_pursuit has no certificate"],
}


@pytest.mark.parametrize("case", REJECTED)
def test_where_a_certificate_is_required_a_node_without_one_ends_with_2_and_one_line(
    case: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    Path("fails.yaml").write_bytes(shipped("gains")["preview"].read_bytes())
    write_certificate(CHOICES._replace(gain_table="fails.yaml"), ("delay margin = 0.01 s",))
    parameter, sentence = REJECTED[case]
    values = ["vehicle:=car.yaml", "require_certificate:=true", parameter]
    options = [text for value in values for text in ("-p", value)]
    monkeypatch.setattr(sys, "argv", ["controller", "--ros-args", *options])
    assert controller_node.main() == 2
    (line,) = [each for each in capfd.readouterr().err.splitlines() if each.startswith("error")]
    assert line.startswith("error: require_certificate: ")
    assert sentence in line
