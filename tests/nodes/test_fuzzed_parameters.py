"""Requests of any type, size and value to the services of every node."""

from typing import Any

import pytest

from ampc_msgs_config.nodes.base_node import BaseNode
from tests.workshop.fuzz import fuzz_parameters
from tests.workshop.fuzz.fuzz_guard import Violation
from tests.workshop.fuzz.fuzz_parameters import Requests, parameter_drive

pytestmark = pytest.mark.usefixtures("own_domain")


def test_no_request_ends_a_node_changes_what_is_fixed_or_stops_the_commands() -> None:
    done = parameter_drive(seed=7, drive=0, count=200)
    sent = sum(number for kind, number in done.items() if kind.startswith("request"))
    assert sent == 200
    assert done["answered"] > 100
    services = ("get_parameters", "list_parameters", "set_parameters", "set_parameters_atomically")
    assert all(done[f"request {name}"] > 3 for name in services)
    failures = {kind for kind in done if kind.startswith("failed")}
    assert failures <= {"failed ValueError", "failed TypeError"}  # of rclpy's own services


def test_the_same_seed_gives_the_same_requests() -> None:
    def drawn(seed: int) -> str:
        requests = Requests([seed], ["guard"])
        return str([requests.value() for _ in range(20)])

    assert drawn(1) == drawn(1) != drawn(2)


def test_a_node_that_changes_a_fixed_parameter_is_detected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    values = iter(["before", *["after"] * 1000])
    monkeypatch.setattr(fuzz_parameters, "fixed_values", lambda _: next(values))

    def make() -> Any:
        return BaseNode("changing", owns_time=True)

    monkeypatch.setattr(fuzz_parameters, "NODES", [make])
    with pytest.raises(Violation, match="changed after from before"):
        parameter_drive(seed=1, drive=0, count=3)
