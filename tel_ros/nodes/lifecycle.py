"""Managed nodes that say why they refuse a transition.

To ROS 2's managed nodes (https://design.ros2.org/articles/node_lifecycle.html) this adds: a transition is
refused with a reason, an error in one is logged, and a request for one that does not exist in the present
state is answered. In rclpy 7.1 it would end the process, which may be holding an arm.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from tel_ros.core.errors import TelError


class TransitionRefusedError(TelError):
    """A managed node does not do a transition now; it stays in the state that it is in."""


def _transition(hook: str) -> Any:
    return lambda node, state: node._do(getattr(node, hook))


class ManagedNode(LifecycleNode):
    """A managed node whose hooks raise :class:`TransitionRefusedError` to refuse all but a shutdown."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.refusal = ""
        """Why the last transition that was asked for was refused; empty after one that was not."""
        change_state = self._service_change_state.callback

        def answer(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change_state(request, response)
            except rclpy_implementation.RCLError as error:
                self._refuse(f"transition {request.transition.id} does not start from {self.lifecycle_state}")
                self.get_logger().debug(str(error))
                response.success = False
                return response

        self._service_change_state.callback = answer

    @property
    def lifecycle_state(self) -> str:
        """The state that the node is in: ``unconfigured``, ``inactive``, ``active``, ``finalized``."""
        return str(self._state_machine.current_state[1])

    def configure(self) -> None:
        """Get ready, without any effect on the outside."""

    def activate(self) -> None:
        """Begin to act."""

    def deactivate(self) -> None:
        """Stop acting."""

    def cleanup(self) -> None:
        """Undo :meth:`configure`."""

    def shutdown(self) -> None:
        """Stop acting for good, in whatever state the node is."""

    def give_up(self) -> None:
        """Make safe whatever a failed transition may have left behind."""

    on_configure = _transition("configure")
    on_activate = _transition("activate")
    on_deactivate = _transition("deactivate")
    on_cleanup = _transition("cleanup")
    on_shutdown = _transition("shutdown")
    on_error = _transition("give_up")

    def _do(self, hook: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            hook()
        except TransitionRefusedError as refusal:
            self._refuse(f"{hook.__name__} is refused: {refusal}")
            return TransitionCallbackReturn.FAILURE
        except Exception:  # rclpy would swallow it without a word
            self.get_logger().error(f"{hook.__name__} failed:\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        self.refusal = ""
        self.get_logger().info(f"{hook.__name__}: done")
        return TransitionCallbackReturn.SUCCESS

    def _refuse(self, why: str) -> None:
        self.refusal = why
        self.get_logger().warning(why)
