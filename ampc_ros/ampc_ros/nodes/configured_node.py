"""Configuration of the controller node: parameters, changes at run time, reload of files."""

from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ampc_msgs_config.nodes.base_node import declare
from ampc_ros.configuration import Choices, check_controller, configuration, gain_file
from ampc_ros.nodes.managed_node import ManagedNode
from ampc_ros.ros import Outputs
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.warm_up import warm_up

RUN_TIME = ("settings", "gain_table", "guard", "static_path")
"""Parameters that select files and may change while the controller runs."""


class ConfiguredNode(ManagedNode):
    """A managed node around a supervisor; a change of its configuration keeps the steering."""

    supervisor: Supervisor
    outputs: Outputs

    def declare_choices(self) -> None:
        """Declare the parameters that select the configuration."""
        default, offer = Choices(), partial(declare, self)
        check_controller(offer("controller", default.controller, "name, or FILE.py:CLASS"))
        offer("vehicle", default.vehicle, "shipped vehicle, or YAML file")
        offer("base_link_to_cg", -1.0, "odom to centre of gravity [m]; -1: rear axle", (-1, 20))
        offer = partial(declare, self, at_run_time=True)
        offer("settings", default.settings, "shipped limits, or YAML file")
        offer("gain_table", default.gain_table, "shipped gains, or YAML file")
        offer("guard", default.guard, "shipped limits of the guard, or YAML file")
        offer("static_path", self.lock_step, "the path is published once and does not grow old")
        offer("qp_fault", False, "fault injection: every solution fails")

    def choices(self, changed: dict[str, Any]) -> Choices:
        """Return the choices of the parameters, some of them changed."""
        values = {name: self.get_parameter(name).value for name in Choices._fields[:-1]}
        values |= {key: value for key, value in changed.items() if key in values}
        if values["base_link_to_cg"] < 0:
            values["base_link_to_cg"] = None
        simulated = self.lock_step or bool(self.get_parameter("use_sim_time").value)
        return Choices(**values, simulated_time=simulated)

    def load(self) -> None:
        """Load the configuration and warm up; a later one continues at the angle in force.

        Raises:
            ValueError: A file or value is wrong.
        """
        choices = self.choices({})
        config, source = configuration(choices), gain_file(choices)
        if hasattr(self, "supervisor"):
            self.supervisor.forget()
            self.supervisor.reconfigure(config, source)
        else:
            self.supervisor = Supervisor(config, source)
        self.supervisor.inject_qp_fault(self.get_parameter("qp_fault").value)
        warm_up(config)

    def offer_changes(self) -> None:
        """Accept new parameters and offer the service `~/reload` while configured."""
        reload = self.create_service(Trigger, "~/reload", self.on_reload)
        self.while_configured.callback(self.destroy_service, reload)
        self.add_on_set_parameters_callback(self.on_parameters)
        self.while_configured.callback(self.remove_on_set_parameters_callback, self.on_parameters)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Apply new values all at once, or reject them all; the steering continues."""
        changed = {each.name: each.value for each in parameters}
        try:
            if set(changed) & set(RUN_TIME):
                self.reconfigure(self.choices(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.supervisor.inject_qp_fault(changed.get("qp_fault", self.supervisor.qp_fault))
        return SetParametersResult(successful=True)

    def reconfigure(self, choices: Choices) -> None:
        """Switch to other choices; an error changes nothing.

        Raises:
            ValueError: A file or value is wrong, or the sample time differs.
        """
        config, running = configuration(choices), self.supervisor.config.settings.sample_time
        if config.settings.sample_time != running:
            raise ValueError(
                f"sample_time = {config.settings.sample_time:g} s must stay {running:g} s while "
                "the controller is configured"
            )
        self.supervisor.reconfigure(config, gain_file(choices))
        self.publish_configuration()

    def publish_configuration(self) -> None:
        """Publish the configuration in use."""
        self.outputs.publish_configuration(self.supervisor)
        self.get_logger().info(f"configuration {self.supervisor.number} in use")

    def on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Read gains, limits and guard from their files again; an error changes nothing."""
        try:
            self.reconfigure(self.choices({}))
        except ValueError as error:
            self.get_logger().error(f"not reloaded: {error}")
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"configuration {self.supervisor.number}"
        return response
