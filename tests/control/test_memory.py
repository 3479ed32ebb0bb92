"""A controller with a stored memory goes on bit for bit as the one that stored it."""

import json
import math
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Choices, configuration
from ampc_ros.supervision.memory import CHECKSUM_SIZE, restore, store
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor

TICK_NS = NANOSECONDS // 10
S = np.arange(0.0, 200.0, 1.0)


def state_at(tick: int) -> VehicleState:
    """Return a noisy state beside a slalom at 9 m/s."""
    rng = np.random.default_rng(tick)
    x = 0.9 * tick
    yaw = math.atan(0.1 * math.cos(x / 15.0))
    noise = rng.normal(0.0, 0.03, 4)
    y = 1.5 * math.sin(x / 15.0) + 0.1
    return VehicleState(
        tick * TICK_NS, x, y + noise[0], yaw + noise[1] / 5, 9.0, noise[2], noise[3]
    )


def points_at(tick: int, *, is_new: bool) -> Any:
    """Return the path, or a noisy window of it that moves with the car."""
    if not is_new:
        return np.column_stack((S, 1.5 * np.sin(S / 15.0)))
    s = S[: len(S) // 2] + 5.0 * (tick // 6) - 5.0
    noise = np.random.default_rng(tick // 6).normal(0.0, 0.02, len(s))
    return np.column_stack((s, 1.5 * np.sin(s / 15.0) + noise))


def answers(supervisor: Supervisor, ticks: range, *, is_new: bool) -> list[tuple[float, ...]]:
    """Return all quantities of the given ticks."""
    found = []
    for tick in ticks:
        now_ns = tick * TICK_NS + 10_000_000
        supervisor.take_path(points_at(tick, is_new=is_new), tick * TICK_NS, now_ns)
        state = state_at(tick - tick % 2 if 50 <= tick < 60 else tick)  # every second one is lost
        supervisor.replay_state(Received(state, state.stamp_ns, now_ns), supervisor.resets)
        supervisor.take_steering(0.01)
        record = supervisor.tick(now_ns)
        assert record is not None
        found.append((*record.quantities, *record.command.plan.diagnosis))
    return found


def unchanged(_: Supervisor) -> None:
    """Change nothing."""


def other_limits(supervisor: Supervisor) -> None:
    """Use other limits from now on."""
    settings = replace(supervisor.config.settings, max_increment=0.05)
    supervisor.reconfigure(supervisor.config._replace(settings=settings))


def failing_qp(supervisor: Supervisor) -> None:
    """Let every solution fail from now on."""
    supervisor.inject_qp_fault(True)


@pytest.mark.parametrize("controller", ["preview", "paper", "classic", "pure_pursuit"])
@pytest.mark.parametrize("is_new", [False, True], ids=["one path", "new paths"])
@pytest.mark.parametrize("change", [unchanged, other_limits, failing_qp])
def test_a_restored_controller_continues_bit_for_bit(
    controller: str, is_new: bool, change: Callable[[Supervisor], None]
) -> None:
    supervisor = Supervisor(configuration(Choices(controller=controller, static_path=not is_new)))
    config = {1: supervisor.config}
    answers(supervisor, range(1, 30), is_new=is_new)
    change(supervisor)
    config[supervisor.number] = supervisor.config
    answers(supervisor, range(30, 47), is_new=is_new)
    other = restore(store(supervisor), config)
    later = [answers(each, range(47, 75), is_new=is_new) for each in (supervisor, other)]
    np.testing.assert_array_equal(np.array(later[0]), np.array(later[1]))


@pytest.fixture(scope="module")
def driven() -> Supervisor:
    """Return a controller after some ticks."""
    supervisor = Supervisor(configuration(Choices(static_path=True)))
    answers(supervisor, range(1, 40), is_new=False)
    return supervisor


def test_damage_is_noticed(driven: Supervisor) -> None:
    data, rng = store(driven), np.random.default_rng(1)
    for _ in range(50):
        damaged = bytearray(data)
        damaged[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        with pytest.raises(ValueError, match="damaged"):
            restore(bytes(damaged), {1: driven.config})
    for size in (0, 3, 4, 100, len(data) - 1):
        with pytest.raises(ValueError, match=r"of another version|damaged"):
            restore(data[:size], {1: driven.config})


def changed(data: bytes, change: Callable[[dict[str, Any]], Any]) -> bytes:
    """Return a memory with another content, and the right checksum."""
    content = json.loads(data[CHECKSUM_SIZE:])
    change(content[1]["fields"])
    text = json.dumps(content).encode()
    return zlib.crc32(text).to_bytes(CHECKSUM_SIZE, "little") + text


@pytest.mark.parametrize(
    "change",
    [
        lambda fields: fields.pop("_guard"),
        lambda fields: fields["_guard"].update(object="Recording"),
        lambda fields: fields.update(_stop={"same": 10**6}),
        lambda fields: fields["_present"]["fields"]["_adaptation"]["fields"]["x"].update(shape=[4]),
        lambda fields: fields["_present"]["fields"]["_adaptation"]["fields"]["x"].update(type="O"),
    ],
)
def test_a_memory_of_another_version_is_refused(
    change: Callable[[dict[str, Any]], Any], driven: Supervisor
) -> None:
    with pytest.raises(ValueError, match="of another version"):
        restore(changed(store(driven), change), {1: driven.config})


def test_a_memory_whose_configuration_is_not_known_is_refused(driven: Supervisor) -> None:
    with pytest.raises(ValueError, match="of another version"):
        restore(store(driven), {2: driven.config})
