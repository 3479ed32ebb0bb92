"""What the controller node is made of: parameters, also at run time, and files read anew."""

from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ampc_msgs_config.nodes.base_node import declare
from ampc_ros.configuration import CONTROLLERS, Choices, configuration, gain_file
from ampc_ros.controller import warm_up
from ampc_ros.nodes.managed_node import ManagedNode
from ampc_ros.ros import Outputs
from ampc_ros.supervision.rehearsal import rehearse
from ampc_ros.supervision.supervisor import Supervisor

RUN_TIME = ("settings", "gain_table", "guard", "static_path")
"""What a running controller may exchange."""


class ConfiguredNode(ManagedNode):
    """A managed node around a supervisor; it exchanges what that is made of without a bump."""

    supervisor: Supervisor
    outputs: Outputs

    def declare_choices(self) -> None:
        """Declare the parameters that say what the controller is made of."""
        default, offer = Choices(), partial(declare, self)
        offer("controller", default.controller, "which one", list(CONTROLLERS))
        offer("vehicle", default.vehicle, "shipped vehicle, or YAML file")
        offer("base_link_to_cg", -1.0, "odom to centre of gravity [m]; -1: rear axle", (-1, 20))
        offer = partial(declare, self, at_run_time=True)
        offer("settings", default.settings, "shipped limits, or YAML file")
        offer("gain_table", default.gain_table, "shipped gains, or YAML file")
        offer("guard", default.guard, "shipped limits of the guard, or YAML file")
        offer("static_path", self.lock_step, "the path is published once and does not grow old")
        offer("qp_fault", False, "let every solution fail, to see what happens")

    def choices(self, changed: dict[str, Any]) -> Choices:
        """Give what the parameters choose, some of them changed."""
        chosen = {name: self.get_parameter(name).value for name in Choices._fields[:-1]}
        chosen |= {key: value for key, value in changed.items() if key in chosen}
        if chosen["base_link_to_cg"] < 0:
            chosen["base_link_to_cg"] = None
        simulated = self.lock_step or bool(self.get_parameter("use_sim_time").value)
        return Choices(**chosen, simulated_time=simulated)

    def load(self) -> None:
        """Load and compile all; a later configuration goes on from the angle in force.

        Raises:
            ValueError: A file or value is wrong.
        """
        choices = self.choices({})
        config, source = configuration(choices), gain_file(choices)
        if hasattr(self, "supervisor"):
            self.forget_inputs()
            self.supervisor.reconfigure(config, source)
        else:
            self.supervisor = Supervisor(config, source)
        ladder = self.supervisor.ladder
        warm_up(ladder.controller)
        ladder.restart(self.supervisor.steering)
        ladder.qp_fault = self.get_parameter("qp_fault").value
        rehearse(config)

    def forget_inputs(self) -> None:
        """Wait for new inputs: those of an earlier configuration are of another drive."""
        supervisor = self.supervisor
        supervisor.filter.reset()
        supervisor.state = supervisor.path = supervisor.points = None
        supervisor.stop_requested = False
        supervisor.restart()

    def offer_changes(self) -> None:
        """Take new parameters, and offer to read files anew, while configured."""
        reload = self.create_service(Trigger, "~/reload", self.on_reload)
        self.while_configured.callback(self.destroy_service, reload)
        self.add_on_set_parameters_callback(self.on_parameters)
        self.while_configured.callback(self.remove_on_set_parameters_callback, self.on_parameters)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Use new values, all at once, or refuse them all; the steering goes on where it is."""
        changed = {each.name: each.value for each in parameters}
        try:
            if set(changed) & set(RUN_TIME):
                self.reconfigure(self.choices(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        ladder = self.supervisor.ladder
        ladder.qp_fault = changed.get("qp_fault", ladder.qp_fault)
        return SetParametersResult(successful=True)

    def reconfigure(self, choices: Choices) -> None:
        """Go on with what was chosen; where that is wrong, with what there was."""
        config, period = configuration(choices), self.supervisor.period
        if config.settings.sample_time != period:
            raise ValueError(
                f"sample_time = {config.settings.sample_time:g} s must stay {period:g} s while the "
                "controller is configured"
            )
        self.supervisor.reconfigure(config, gain_file(choices))
        self.publish_configuration()

    def publish_configuration(self) -> None:
        """Say what the controller is made of now."""
        self.outputs.configuration(self.supervisor)
        self.get_logger().info(f"configuration {self.supervisor.number} in use")

    def on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Read gains, limits and guard from their files again; a bad one changes nothing."""
        try:
            self.reconfigure(self.choices({}))
        except ValueError as error:
            self.get_logger().error(f"not reloaded: {error}")
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"configuration {self.supervisor.number}"
        return response
