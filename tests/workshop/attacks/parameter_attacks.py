"""Requests that no user sends, for the services of controller and gate while they drive."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)

from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.attacks.live import Session, attacks_on, parameters_of
from tests.workshop.fuzz.fuzz_parameters import FILES, Requests, hostile_folder

PAUSE = 0.3
"""Time for which the commands are watched after each request [s]."""
FLOOD, FLOOD_RATE = 400, 200
"""Requests, and requests per second [Hz]."""
RANDOM = 8
"""Attacks by ten random requests each."""
SERVICES = {
    "set_parameters": SetParameters,
    "set_parameters_atomically": SetParametersAtomically,
    "get_parameters": GetParameters,
    "get_parameter_types": GetParameterTypes,
    "describe_parameters": DescribeParameters,
    "list_parameters": ListParameters,
}
LIFE_CYCLE = {
    "deactivate, activate": (
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_ACTIVATE,
    ),
    "cleanup while active": (Transition.TRANSITION_CLEANUP,),
    "configure while active": (Transition.TRANSITION_CONFIGURE,),
    "unknown transition": (255, 99),
    "ten restarts": (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE) * 10,
}


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Send all kinds of requests."""
    before = Path.cwd()
    with hostile_folder():
        folder = Path.cwd()
        os.chdir(before)
        attacks = single_requests(folder) | floods(choice)
        yield from attacks_on(choice, attacks, parameters_of())


def single_requests(folder: Path) -> dict[str, Callable[[Session], object]]:
    """Return attacks by one parameter, by name."""
    attacks: dict[str, Callable[[Session], object]] = {}
    for key in ("gain_table", "guard", "settings"):
        names = {"x" * 300: "300 letters", "a/" * 3000: "6000 letters", "": "empty"}
        for name, title in names.items():
            attacks[f"{key} {title}"] = setting(key, text(name))
    for name in (*FILES, "loop.yaml", "folder", "nowhere.yaml"):
        if name != "careful.yaml":
            key = "gain_table" if name in ("huge.yaml", "large.yaml", "nested.yaml") else "guard"
            attacks[f"{key} {name}"] = setting(key, text(str(folder / name)))
    for name in ("/dev/zero", "/proc/self/mem"):
        attacks[f"settings {name}"] = setting("settings", text(name))
    for number in (99, 255, 10):
        attacks[f"type {number}"] = setting("guard", ParameterValue(type=number))
    attacks["use_sim_time"] = setting("use_sim_time", ParameterValue(type=1, bool_value=True))
    attacks["vehicle"] = setting("vehicle", text("ordinary"))
    attacks["lock_step"] = setting("lock_step", ParameterValue(type=1, bool_value=True))
    attacks["not declared"] = setting("\u00c4" * 300, text("x"))
    attacks["wrong type"] = setting("guard", ParameterValue(type=3, double_value=float("nan")))
    for name in ("track", "road"):
        attacks[f"guard {name}"] = setting("guard", text(name))
    for title, transitions in LIFE_CYCLE.items():
        attacks[f"life cycle: {title}"] = change_state(transitions)
    attacks["life cycle: queries"] = queries
    return attacks


def floods(choice: Choice) -> dict[str, Callable[[Session], object]]:
    """Return attacks by many requests, by name."""
    attacks: dict[str, Callable[[Session], object]] = {"flood": flood}
    for number in range(RANDOM):
        name = f"random {number}"
        attacks[name] = random_requests(choice, name, ("controller", "gate")[number % 2])
    return attacks


def text(name: str) -> ParameterValue:
    """Return a text as the value of a parameter."""
    return ParameterValue(type=4, string_value=name)


def setting(key: str, value: ParameterValue) -> Callable[[Session], object]:
    """Return an attack that sets a parameter of both nodes."""

    def attack(live: Session) -> None:
        for node in ("controller", "gate"):
            for service in ("set_parameters", "set_parameters_atomically"):
                request(live, node, service, [Parameter(name=key, value=value)])

    return attack


def request(live: Session, node: str, service: str, parameters: list[Any]) -> None:
    """Send parameters to a service, and wait for a while for the answer."""
    kind = SERVICES[service]
    send(live, kind, f"{node}/{service}", kind.Request(parameters=parameters))


def send(live: Session, kind: Any, name: str, message: Any, pause: float = PAUSE) -> None:
    """Send a request and wait for its answer, at most for a pause [s]."""
    client = live.auditor.create_client(kind, name)
    live.auditor.run(2.0, client.service_is_ready)
    future = client.call_async(message)
    live.auditor.run(pause, future.done)
    live.auditor.destroy_client(client)


def change_state(transitions: tuple[int, ...]) -> Callable[[Session], object]:
    """Return an attack by transitions of the life cycle."""

    def attack(live: Session) -> None:
        for number in transitions:
            message = ChangeState.Request(transition=Transition(id=number))
            send(live, ChangeState, "controller/change_state", message, 3.0)

    return attack


def queries(live: Session) -> None:
    """Ask for states and transitions, many times."""
    for _ in range(10):
        send(live, GetState, "controller/get_state", GetState.Request())
        kind = GetAvailableTransitions
        send(live, kind, "controller/get_available_transitions", kind.Request())


def flood(live: Session) -> None:
    """Change a parameter 400 times at 200 Hz, without waiting for answers."""
    client = live.auditor.create_client(SetParameters, "controller/set_parameters")
    live.auditor.run(2.0, client.service_is_ready)
    for number in range(FLOOD):
        value = ParameterValue(type=1, bool_value=bool(number % 2))
        parameter = Parameter(name="qp_fault", value=value)
        client.call_async(SetParameters.Request(parameters=[parameter]))
        live.auditor.run(1.0 / FLOOD_RATE)
    value = ParameterValue(type=1, bool_value=False)
    client.call_async(SetParameters.Request(parameters=[Parameter(name="qp_fault", value=value)]))
    live.auditor.run(2.0)
    live.auditor.destroy_client(client)


def random_requests(choice: Choice, name: str, node: str) -> Callable[[Session], object]:
    """Return an attack by ten random requests for the services of a node."""

    def attack(live: Session) -> None:
        rng = choice.rng(name)
        requests = Requests([rng.randrange(2**31)], ["guard", "settings", "gain_table", "rate"])
        for _ in range(10):
            service = rng.choice(list(SERVICES))
            kind = SERVICES[service]
            stand_in: Any = type("Service", (), {"srv_type": kind})
            send(live, kind, f"{node}/{service}", requests.fill(stand_in))
        for key, value in (("guard", "road"), ("gain_table", "preview"), ("settings", "table3")):
            request(live, node, "set_parameters", [Parameter(name=key, value=text(value))])

    return attack
