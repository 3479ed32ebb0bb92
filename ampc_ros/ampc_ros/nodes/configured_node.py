"""Configuration of the controller node: parameters, changes at run time, reload of files."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.task import Future
from std_srvs.srv import Trigger

from ampc_msgs_config.config import find, shipped_or_file
from ampc_msgs_config.nodes.base_node import declare
from ampc_msgs_config.nodes.failed_callbacks import shortened
from ampc_msgs_config.parameters import ASSUMED_LAG, REAR_AXLE
from ampc_msgs_config.vehicle_warnings import vehicle_warnings
from ampc_ros.certificate import certificate_problem
from ampc_ros.configuration import (
    CONTROLLERS,
    CarDifference,
    Choices,
    Configuration,
    check_controller,
    configuration,
    gain_file,
    to_yaml,
)
from ampc_ros.nodes.background import Background, Outcome
from ampc_ros.nodes.estimate_store import STORE_PERIOD, EstimateStore
from ampc_ros.nodes.fixed_frame import FRAME
from ampc_ros.nodes.managed_node import ManagedNode
from ampc_ros.ros import Outputs
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.warm_up import warm_up

RUN_TIME = ("settings", "gain_table", "guard", "static_path")
"""Parameters that select files and may change while the controller runs."""

RELOADED = "the files were read again"
"""Change of a configuration, for the log."""


class LoadedChoices(NamedTuple):
    """Configuration of the choices of a user, ready for use."""

    config: Configuration
    source: object
    """Origin of the gains."""
    number: int
    """Number of the configuration in its text."""
    text: str
    """Result of `to_yaml`."""
    uncertified: str
    """Why the gains are not certified; empty: they are."""


def load_choices(choices: Choices, number: int, require_certificate: bool) -> LoadedChoices:
    """Load choices, and write the configuration as it is to be published.

    Raises:
        ValueError: A file or value is wrong, or a required certificate is missing.
    """
    config = configuration(choices)
    uncertified = certificate_problem(choices, config, required=require_certificate)
    if uncertified and require_certificate:
        raise ValueError(f"require_certificate: {uncertified}")
    text = to_yaml(config, number)
    return LoadedChoices(config, gain_file(choices), number, text, uncertified)


def describe_values(changed: dict[str, Any]) -> str:
    """Return new values of parameters, for the log."""
    return ", ".join(f"{name} = {value!r}" for name, value in changed.items())


class ConfiguredNode(ManagedNode):
    """A managed node around a supervisor; a change of its configuration keeps the steering.

    In real time, files are loaded in another process while the controller steers on. The services
    that load files await it in a callback group of their own.
    """

    supervisor: Supervisor
    outputs: Outputs
    loader: Background | None = None
    warned: Sequence[str] = ()
    """Warnings about the vehicle that have been reported."""
    loaded: tuple[Choices, Outcome] | None = None
    """Choices that were loaded before the callback of their parameters."""
    uncertified = ""
    """Why the gains in use are not certified; empty: they are."""

    def declare_choices(self) -> None:
        """Declare the parameters that select the configuration."""
        default, offer = Choices(), partial(declare, self)
        names = f"{', '.join(CONTROLLERS)}, or FILE.py:CLASS"
        check_controller(offer("controller", default.controller, "kind of controller", names))
        offer("vehicle", default.vehicle, "car", shipped_or_file("vehicles"))
        text = "odom to centre of gravity [m], negative ahead of it; -1: odom of the rear axle"
        offer("base_link_to_cg", REAR_AXLE, text, (-20, 20))
        offer("fixed_frame", "", "frame of path and odom", FRAME)
        text = "start with the estimates of the last drive, in real time"
        self.estimates = EstimateStore(
            self.get_logger(),
            is_used=offer("store_estimates", True, text) and not self.is_simulated,
        )
        text = "reject a gain table without a valid certificate"
        self.require_certificate: bool = offer("require_certificate", False, text)
        offer = partial(declare, self, at_run_time=True)
        offer("settings", default.settings, "limits and solver", shipped_or_file("controllers"))
        gains = shipped_or_file("gains", "a YAML file; empty: those of the controller")
        offer("gain_table", default.gain_table, "gains", gains)
        offer("guard", default.guard, "limits of every command", shipped_or_file("guards"))
        offer("static_path", self.lock_step, "the path is published once and does not grow old")
        offer("qp_fault", False, "fault injection: every solution fails")
        self.file_group = MutuallyExclusiveCallbackGroup()
        for service in list(self.services):
            name = service.srv_name.rpartition("/")[2]
            if name == "set_parameters":
                self.move(service, self.one_by_one(service.callback))
            elif name == "set_parameters_atomically":
                self.move(service, self.all_at_once(service.callback))

    def move(self, service: Service, callback: Callable[..., Any]) -> None:
        """Replace the callback of a service by one that loads files without delaying others."""
        service.callback, service.callback_group = callback, self.file_group
        self.file_group.add_entity(service)

    def one_by_one(self, set_parameters: Callable[..., Any]) -> Callable[..., Any]:
        """Load the files of each parameter before it is set."""

        async def load_and_set(request: Any, response: Any) -> Any:
            for each in request.parameters:
                await self.preload([each])
                response = set_parameters(SetParameters.Request(parameters=[each]), response)
            return response

        return load_and_set

    def all_at_once(self, set_parameters: Callable[..., Any]) -> Callable[..., Any]:
        """Load the files of all parameters before they are set."""

        async def load_and_set(request: Any, response: Any) -> Any:
            await self.preload(request.parameters)
            return set_parameters(request, response)

        return load_and_set

    async def preload(self, messages: Sequence[ParameterMessage]) -> None:
        """Load the choices of new parameters; `on_parameters` uses the result."""
        changed = {each.name: Parameter.from_parameter_msg(each) for each in messages}
        right = {
            name: each.value
            for name, each in changed.items()
            if name in RUN_TIME and each.type_ == self.get_parameter(name).type_
        }
        if right and self.loads_elsewhere:
            choices = self.choices(right)
            self.loaded = (choices, await self.load_elsewhere(choices))

    @property
    def loads_elsewhere(self) -> bool:
        """Whether files are loaded in another process."""
        return self.is_active and not self.lock_step

    def load_elsewhere(self, choices: Choices) -> Future:
        """Load choices in another process; the future holds the outcome."""
        future = Future()
        self.loader = Background(self.files_ready.trigger)
        number = self.supervisor.number + 1
        self.loader.submit(future, load_choices, choices, number, self.require_certificate)
        return future

    def on_files(self) -> None:
        """Pass on the outcome of the other process, and end it."""
        for future, outcome in self.loader.take() if self.loader else ():
            future.set_result(outcome)
            self.stop_loader()

    def stop_loader(self) -> None:
        """End the process that loads files."""
        if self.loader:
            self.loader.close()
        self.loader = None

    def choices(self, changed: dict[str, Any]) -> Choices:
        """Return the choices of the parameters, some of them changed."""
        values = {name: self.get_parameter(name).value for name in Choices._fields[:-1]}
        values |= {key: value for key, value in changed.items() if key in values}
        if values["base_link_to_cg"] == REAR_AXLE:
            values["base_link_to_cg"] = None
        return Choices(**values, simulated_time=self.is_simulated)

    def load(self) -> None:
        """Load the configuration and warm up; a later one continues at the angle in force.

        Raises:
            ValueError: A file or value is wrong.
        """
        choices = self.choices({})
        config, source, _, _, uncertified = load_choices(choices, 1, self.require_certificate)
        config = self.estimates.with_stored(config)
        if not config.steering.is_lag_configured:
            what = f"steering.lag is not configured: {ASSUMED_LAG:g} s is assumed at first"
            file = find("vehicles", choices.vehicle)
            self.get_logger().warning(f"vehicle file {file}: {what}")
        if hasattr(self, "supervisor"):
            self.supervisor.forget()
            self.supervisor.reconfigure(config, source)
        else:
            self.supervisor = Supervisor(config, source)
        self.supervisor.inject_qp_fault(self.get_parameter("qp_fault").value)
        self.warn_uncertified(uncertified)
        warm_up(config)

    @property
    def is_simulated(self) -> bool:
        """Whether time is simulated."""
        return self.lock_step or bool(self.get_parameter("use_sim_time").value)

    def store(self) -> None:
        """Store the estimates of the car."""
        self.estimates.store(self.supervisor)

    def on_forget(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Forget the estimates of the car, also the stored ones."""
        config = self.supervisor.config._replace(difference=CarDifference())
        self.supervisor.reconfigure(config)
        self.publish_configuration("the estimates are forgotten")
        response.success, response.message = True, "the car is assumed to be as configured"
        try:
            self.estimates.remove(config)
        except OSError as error:
            response.success, response.message = False, str(error)
        return response

    def warn_uncertified(self, uncertified: str) -> None:
        """Log once per configuration that its gains are not certified, and remember the reason."""
        self.uncertified = uncertified
        if uncertified:
            self.get_logger().warning(uncertified)

    def offer_changes(self) -> None:
        """Accept new parameters and offer the service `~/reload` while configured."""
        group = self.file_group
        self.files_ready = self.create_guard_condition(self.on_files)
        self.while_configured.callback(self.destroy_guard_condition, self.files_ready)
        self.while_configured.callback(self.stop_loader)
        forget = self.create_service(Trigger, "~/forget", self.on_forget)
        self.while_configured.callback(self.destroy_service, forget)
        if self.estimates.is_used:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            storing = self.create_timer(STORE_PERIOD, self.store, clock=clock)
            self.while_configured.callback(self.destroy_timer, storing)
        reload = self.create_service(Trigger, "~/reload", self.on_reload, callback_group=group)
        self.while_configured.callback(self.destroy_service, reload)
        self.add_on_set_parameters_callback(self.on_parameters)
        self.while_configured.callback(self.remove_on_set_parameters_callback, self.on_parameters)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Apply new values all at once, or reject them all; the steering continues."""
        changed = {each.name: each.value for each in parameters}
        try:
            if set(changed) & set(RUN_TIME):
                choices, (loaded, self.loaded) = self.choices(changed), (self.loaded, None)
                outcome = loaded[1] if loaded and loaded[0] == choices else None
                loaded_choices = outcome.result() if outcome else self.load_here(choices)
                self.reconfigure(loaded_choices, describe_values(changed))
        except Exception as error:  # the request is answered, whatever a file contains
            return SetParametersResult(successful=False, reason=shortened(str(error)))
        self.supervisor.inject_qp_fault(changed.get("qp_fault", self.supervisor.qp_fault))
        return SetParametersResult(successful=True)

    def load_here(self, choices: Choices) -> LoadedChoices:
        """Load choices at once.

        Raises:
            ValueError: A file or value is wrong.
        """
        return load_choices(choices, self.supervisor.number + 1, self.require_certificate)

    def reconfigure(self, loaded: LoadedChoices, change: str) -> None:
        """Switch to another configuration; an error changes nothing.

        Args:
            loaded: Configuration.
            change: What has changed, for the log.

        Raises:
            ValueError: The sample time differs, or the gains are numerically singular.
        """
        config, running = loaded.config, self.supervisor.config.settings.sample_time
        if config.settings.sample_time != running:
            raise ValueError(
                f"sample_time = {config.settings.sample_time:g} s must stay {running:g} s while "
                "the controller is configured"
            )
        self.supervisor.reconfigure(config, loaded.source)
        self.warn_uncertified(loaded.uncertified)
        fits = loaded.number == self.supervisor.number
        self.publish_configuration(change, loaded.text if fits else "")

    def publish_configuration(self, change: str = "", text: str = "") -> None:
        """Publish the configuration in use, and log what has changed.

        Args:
            change: What has changed; empty: it is the first configuration.
            text: Text of the configuration, where it is already written.
        """
        self.outputs.publish_configuration(self.supervisor, text)
        self.warn_of_vehicle()
        in_use = f"configuration {self.supervisor.number} in use"
        self.get_logger().info(f"{in_use}: {change}" if change else in_use)

    def warn_of_vehicle(self) -> None:
        """Log implausible values of the vehicle, and report them once in the diagnostics."""
        config = self.supervisor.config
        found = vehicle_warnings(config.chassis, config.steering)
        for sentence in (each for each in found if each not in self.warned):
            self.trouble = "; ".join(filter(None, (self.trouble, sentence)))
            self.get_logger().warning(f"vehicle {self.get_parameter('vehicle').value}: {sentence}")
        self.warned = found

    async def on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Read gains, limits and guard from their files again; an error changes nothing."""
        choices = self.choices({})
        try:
            if self.loads_elsewhere:
                self.reconfigure((await self.load_elsewhere(choices)).result(), RELOADED)
            else:
                self.reconfigure(self.load_here(choices), RELOADED)
        except Exception as error:  # the request is answered, whatever a file contains
            response.success, response.message = False, shortened(str(error))
            self.get_logger().error(f"not reloaded: {response.message}")
            return response
        response.success, response.message = True, f"configuration {self.supervisor.number}"
        return response
