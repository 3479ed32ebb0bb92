"""A managed node (ROS 2 life cycle) that nothing leaves half-made, and no request ends."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from ampc_msgs_config.nodes.base_node import BaseNode, declare

SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


class ManagedNode(BaseNode, LifecycleNodeMixin):
    """Configures and activates itself, unless told otherwise.

    A subclass sets up, begins and finishes. What it makes on the way it notes in `while_configured`
    or `while_active`, which take it away again, also after a transition that has failed midway.
    """

    def __init__(self, name: str) -> None:
        """Join the graph, unconfigured; a subclass then declares and calls `start`."""
        BaseNode.__init__(self, name)
        self.is_active = False
        self.wrong: Exception | None = None
        self.while_configured, self.while_active = ExitStack(), ExitStack()
        LifecycleNodeMixin.__init__(self)
        self._service_change_state.callback = self._refusing(self._service_change_state.callback)
        self.autostart: bool = declare(self, "autostart", True, "configure and activate at once")

    def start(self) -> None:
        """Configure and activate, where the node is to do so by itself.

        Raises:
            ValueError: The set-up is wrong.
        """
        for trigger in (self.trigger_configure, self.trigger_activate) if self.autostart else ():
            trigger()
            if self.wrong:
                raise self.wrong
        self.autostart = False

    def set_up(self) -> None:
        """Load, publish, subscribe.

        Raises:
            ValueError: The set-up is wrong; the node stays unconfigured.
        """

    def begin(self) -> None:
        """Begin to act."""

    def finish(self) -> None:
        """Say the last words, while all is still there."""

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Set up; where that is wrong, the node may be configured again."""
        return self._attempt(self.set_up, ValueError)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Begin to act."""
        return self._attempt(self._activate)

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Say the last words, and act no more."""
        return self._attempt(self._deactivate)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Take away what was set up."""
        return self._attempt(self.while_configured.close)

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Say the last words, and take away everything."""
        return self._attempt(self._leave)

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that has failed: the same; then the node may be configured again."""
        wrong, result = self.wrong, self._attempt(self._leave)
        self.wrong = wrong or self.wrong
        return result

    def _activate(self) -> None:
        self.begin()
        self.is_active = True

    def _deactivate(self) -> None:
        if self.is_active:
            self.finish()
        self.is_active = False
        self.while_active.close()

    def _leave(self) -> None:
        try:
            self._deactivate()
            self.flush()
        finally:
            self.is_active = False
            self.while_active.close()
            self.while_configured.close()

    def _attempt(
        self, what: Callable[[], None], refusal: type[Exception] | tuple[()] = ()
    ) -> TransitionCallbackReturn:
        """Do something; what goes wrong is said in one line, or raised by `start`."""
        self.wrong = None
        try:
            what()
            return SUCCESS
        except Exception as error:
            self.wrong = error
            refused = isinstance(error, refusal)
            if not self.autostart:
                kind = "" if refused else f"{type(error).__name__}: "
                self.get_logger().error(f"{what.__name__.strip('_')}: {kind}{error}")
            if refused:
                self.while_configured.close()
            return FAILURE if refused else ERROR

    def _refusing(self, change: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Refuse a transition that the present state does not have; rclpy would end the node."""

        def change_state(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> ChangeState.Response:
            try:
                return change(request, response)
            except RuntimeError:
                asked = request.transition.label or f"transition {request.transition.id}"
                state = self._state_machine.current_state[1]
                self.get_logger().warning(f"{asked} is not possible while {state}")
                response.success = False
                return response

        return change_state
