"""A managed node (ROS 2 life cycle) that cleans up after a failed transition and keeps running."""

from collections.abc import Callable
from contextlib import ExitStack

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from ampc_msgs_config.nodes.base_node import BaseNode, declare

SUCCESS, FAILURE, ERROR_RESULT = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)
ChangeStateCallback = Callable[[ChangeState.Request, ChangeState.Response], ChangeState.Response]


def lifecycle_state(node: LifecycleNodeMixin) -> str:
    """Return the label of the life-cycle state; rclpy has no public function for it."""
    return str(node._state_machine.current_state[1])


def wrap_change_state(
    node: LifecycleNodeMixin, wrap: Callable[[ChangeStateCallback], ChangeStateCallback]
) -> None:
    """Wrap the callback of the service `~/change_state`; rclpy has no public function for it."""
    service = node._service_change_state
    service.callback = wrap(service.callback)


class ManagedNode(BaseNode, LifecycleNodeMixin):
    """Configures and activates itself unless the parameter `autostart` is false.

    A subclass implements `set_up`, `begin` and `finish`. It registers the release of each resource
    in `while_configured` or `while_active`, which also run after a failed transition.
    """

    def __init__(self, name: str) -> None:
        """Create the node, unconfigured; a subclass then declares parameters and calls `start`."""
        BaseNode.__init__(self, name)
        self.is_active = False
        self.error: Exception | None = None
        self.while_configured, self.while_active = ExitStack(), ExitStack()
        LifecycleNodeMixin.__init__(self)
        wrap_change_state(self, self._reject_impossible)
        self.autostart: bool = declare(self, "autostart", True, "configure and activate at once")

    def start(self) -> None:
        """Configure and activate where `autostart` is true.

        Raises:
            ValueError: The configuration is wrong.
        """
        for trigger in (self.trigger_configure, self.trigger_activate) if self.autostart else ():
            trigger()
            if self.error:
                raise self.error
        self.autostart = False

    def set_up(self) -> None:
        """Load, publish, subscribe.

        Raises:
            ValueError: The configuration is wrong; the node stays unconfigured.
        """

    def begin(self) -> None:
        """Start to act."""

    def finish(self) -> None:
        """Publish the last messages, before anything is released."""

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Set up; after a ValueError the node can be configured again."""
        return self._attempt(self.set_up, "configured", ValueError)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Start to act."""
        return self._attempt(self._activate, "active")

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Publish the last messages and stop to act."""
        return self._attempt(self._deactivate, "inactive: no commands are published")

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Release what `set_up` created."""
        return self._attempt(self.while_configured.close, "unconfigured: all files are released")

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Publish the last messages and release everything."""
        return self._attempt(self._release, "finalized: only the end of the process is left")

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Release everything after a failed transition; the node can be configured again."""
        error, result = self.error, self._attempt(self._release, "unconfigured after the error")
        self.error = error or self.error
        return result

    def _activate(self) -> None:
        self.begin()
        self.is_active = True

    def _deactivate(self) -> None:
        if self.is_active:
            self.finish()
        self.is_active = False
        self.while_active.close()

    def _release(self) -> None:
        try:
            self._deactivate()
            self.flush()
        finally:
            self.is_active = False
            self.while_active.close()
            self.while_configured.close()

    def _attempt(
        self, action: Callable[[], None], done: str, expected: type[Exception] | tuple[()] = ()
    ) -> TransitionCallbackReturn:
        """Run a transition; an error is logged in one line, or raised by `start`.

        Args:
            action: Work of the transition.
            done: State after it, for the log.
            expected: Exception of a wrong configuration, which is a FAILURE and no ERROR.
        """
        self.error = None
        try:
            action()
            self.get_logger().info(done)
            return SUCCESS
        except Exception as error:
            self.error = error
            is_expected = isinstance(error, expected)
            if not self.autostart:
                kind = "" if is_expected else f"{type(error).__name__}: "
                self.get_logger().error(f"{action.__name__.strip('_')}: {kind}{error}")
            if is_expected:
                self.while_configured.close()
            return FAILURE if is_expected else ERROR_RESULT

    def _reject_impossible(self, change: ChangeStateCallback) -> ChangeStateCallback:
        """Reject a transition that the present state does not have; rclpy would end the node."""

        def change_state(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> ChangeState.Response:
            try:
                return change(request, response)
            except RuntimeError:
                transition = request.transition.label or f"transition {request.transition.id}"
                state = lifecycle_state(self)
                self.get_logger().warning(f"{transition} is not possible while {state}")
                response.success = False
                return response

        return change_state
