"""Managed nodes: a base that says why it refuses a transition, and the client that brings one up.

To ROS 2's managed nodes (https://design.ros2.org/articles/node_lifecycle.html) this adds: a transition is
refused with a reason, an error in one is logged, and a request for one that does not exist in the present
state is answered. In rclpy 7.1 it would end the process, which may be holding an arm.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node

from tel_ros.core.errors import TelError
from tel_ros.nodes.waiting import AGAIN_S, DeclinedError, SilenceError, ask


class TransitionRefusedError(TelError):
    """A managed node does not do a transition now; it stays in the state that it is in."""


def _transition(hook: str) -> Any:
    return lambda node, state: node._do(getattr(node, hook))


class ManagedNode(LifecycleNode):
    """A managed node whose hooks raise :class:`TransitionRefusedError` to refuse a transition.

    A shutdown cannot be refused. After an unexpected error :meth:`give_up` is called, and the node is
    unconfigured.
    """

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


class LifecycleClient:
    """Asks a managed node for its state, and for transitions; another thread spins the asking node."""

    def __init__(self, node: Node, managed: str, group: CallbackGroup) -> None:
        self._managed = managed
        self._get = node.create_client(GetState, f"{managed}/get_state", callback_group=group)
        self._change = node.create_client(ChangeState, f"{managed}/change_state", callback_group=group)

    def bring_up(self, timeout_s: float, poll: Callable[[], None]) -> None:
        """Configure and activate the node, as far as it is not; time-out and ``poll`` as for :func:`ask`.

        Raises:
            NoAnswerError: the node does not answer.
            DeclinedError: it cannot be configured or activated.
        """
        steps = {
            State.PRIMARY_STATE_UNCONFIGURED: (Transition.TRANSITION_CONFIGURE, "configured"),
            State.PRIMARY_STATE_INACTIVE: (Transition.TRANSITION_ACTIVATE, "activated"),
        }
        end = time.monotonic() + timeout_s
        while True:
            state = ask(self._get, GetState.Request(), timeout_s, poll, AGAIN_S).current_state
            if state.id == State.PRIMARY_STATE_ACTIVE:
                return
            if state.id not in steps:
                raise DeclinedError(
                    f"{self._managed} is {state.label}; expected a node that can be activated"
                )
            transition, done = steps[state.id]
            request = ChangeState.Request(transition=Transition(id=transition))
            try:
                changed = ask(self._change, request, AGAIN_S, poll).success
            except SilenceError:
                if time.monotonic() > end:
                    raise
                continue  # the state tells whether it was only the answer that was lost
            if not changed:
                raise DeclinedError(f"{self._managed} could not be {done}; its log says why")
