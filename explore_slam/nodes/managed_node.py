"""Managed nodes: unconfigured, inactive, active, as nav2 and slam_toolbox have them.

The transitions come from the services `<node>/change_state` and so on of rclpy's lifecycle nodes.
What a node creates while it is configured ends with `cleanup`, what it creates while it is
activated ends with `deactivate`: an inactive node has no subscription that could change it.
"""

from collections.abc import Callable, Generator, Iterable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from explore_slam.errors import ExploreSlamError
from explore_slam.messages.topics import GlobalTopic

_SUCCESS, _FAILURE, _ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


class ManagedNode(LifecycleNode):
    """A node with life cycle, whose subclass says what each transition does.

    starting: whether the node starts by itself, so that no caller waits for the answer of a
    transition.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.starting = False
        self._is_configured = False
        self._is_active = False
        self._is_ending = False  # nothing spins any more
        self._before: set[Any] = set()  # entities from before the configuration
        self._activated: set[Any] = set()  # entities of the activation
        self._before_activation: set[Any] = set()
        self._failure: Exception | None = None
        # rclpy answers a transition that the state does not have with an exception, which would
        # end the node
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    # -- what a subclass does --------------------------------------------------------------------

    def configure(self) -> None:
        """Create what the node holds and publishes; an ExploreSlamError leaves it unconfigured."""
        raise NotImplementedError

    def activate(self) -> None:
        """Subscribe, and begin to work; an ExploreSlamError leaves the node inactive."""
        raise NotImplementedError

    def deactivate(self) -> None:
        """Bring the vehicle to rest; from now on nothing is published or commanded."""
        raise NotImplementedError

    def clean_up(self) -> None:
        """Release what configure has created; publishers and the like are destroyed afterwards."""
        raise NotImplementedError

    # -- for main programs -----------------------------------------------------------------------

    def start(self, autostart: bool) -> None:
        """Configure and activate the node if it starts by itself; at the end of construction.

        Raises what the transitions raise: no manager would configure the node again.
        """
        self.add_on_set_parameters_callback(_refuse_autostart)  # it would be asked at declarations
        if autostart:
            self.starting = True
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() == _SUCCESS:
                    continue
                failure = self._failure
                self.stop()
                self.destroy_node()
                raise failure or RuntimeError(f'{transition.__name__} has failed')
            self.starting = False

    def stop(self) -> None:
        """Deactivate and clean up, in whatever state the node is; called before it ends."""
        self._is_ending = True
        self._tear_down()

    # -- transitions of rclpy --------------------------------------------------------------------

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Unconfigured to inactive."""
        self._before = _entities(self)
        return self._try('configure', self._configure)

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Inactive to active."""
        return self._try('activate', self._activate)

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Active to inactive."""
        return self._try('deactivate', self._deactivate)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Inactive to unconfigured."""
        return self._try('clean up', self._clean_up)

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Any state to finalized."""
        return self._try('shut down', self._tear_down)

    def on_error(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Leave an unexpected error behind: the node is unconfigured, and can be configured."""
        cause = self._failure
        result = self._try('clean up', self._tear_down)
        self._failure = cause or self._failure
        return result

    def _on_change_state(self, request: Any, response: Any) -> Any:
        try:
            return self._change_state(request, response)
        except rclpy_implementation.RCLError:
            _, state = self._state_machine.current_state
            wanted = request.transition.label or request.transition.id
            self.get_logger().error(f'there is no transition {wanted!r} from state {state}')
            response.success = False
            return response

    def _try(self, what: str, act: Callable[[], None]) -> TransitionCallbackReturn:
        """Carry out a transition; its failure is one line in the log."""
        self._failure = None
        try:
            act()
        except ExploreSlamError as error:
            self._failure = error
            if not self.starting:
                self.get_logger().error(f'cannot {what}: {error}')
            return _FAILURE
        except Exception as error:  # rclpy would swallow it
            self._failure = error
            if not self.starting:
                self.get_logger().error(f'cannot {what}: {type(error).__name__}: {error}')
            return _ERROR
        return _SUCCESS

    def _configure(self) -> None:
        try:
            self.configure()
        except BaseException:
            _destroy(self, _entities(self) - self._before)
            raise
        self._is_configured = True

    def _activate(self) -> None:
        self._before_activation = _entities(self)
        try:
            self.activate()
        except BaseException:
            _destroy(self, _entities(self) - self._before_activation)
            raise
        self._activated = _entities(self) - self._before_activation
        self._is_active = True

    def _deactivate(self) -> None:
        self._is_active = False
        self.deactivate()
        # subscriptions may have been added later, for what the node has found out; publishers
        # that were added later belong to what it holds
        later = _entities(self) - self._before_activation
        subscriptions = {item for item in later if isinstance(item, Subscription)}
        self._destroy_unused((self._activated & later) | subscriptions)
        self._activated = set()

    def _clean_up(self) -> None:
        self._is_configured = False
        try:
            self.clean_up()
        finally:
            self._destroy_unused(_entities(self) - self._before)

    def _destroy_unused(self, entities: set[Any]) -> None:
        """Destroy entities; services once the calls that were waiting have their answers."""
        services = {item for item in entities if isinstance(item, Service)}
        _destroy(self, entities - services)
        if self.executor is None or self._is_ending:
            _destroy(self, services)
        elif services:
            self.executor.create_task(_destroy_after_answers, self, services)

    def _tear_down(self) -> None:
        try:
            if self._is_active:
                self._deactivate()
        finally:
            if self._is_configured:
                self._clean_up()


def _refuse_autostart(parameters: list[Parameter]) -> SetParametersResult:
    if any(item.name == 'autostart' for item in parameters):
        reason = 'autostart: set at start only; use the service change_state'
        return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True)


def _entities(node: Node) -> set[Any]:
    """Return all that a node communicates with, but for its clock, which has its own life."""
    clock = GlobalTopic.CLOCK.value
    subscriptions = (item for item in node.subscriptions if item.topic_name != clock)
    actions = (item for item in node.waitables if isinstance(item, ActionClient))
    others = (node.publishers, node.services, node.clients, node.timers)
    return {*subscriptions, *actions, *(item for kind in others for item in kind)}


class _NextTurn:
    """Awaitable that lets an executor run its other tasks once."""

    def __await__(self) -> Generator[None]:
        yield


async def _destroy_after_answers(node: Node, services: Iterable[Any]) -> None:
    """Destroy services once the executor has sent the answers that are ready."""
    await _NextTurn()
    _destroy(node, services)


def _destroy(node: Node, entities: Iterable[Any]) -> None:
    """Destroy entities of a node."""
    destroyers: dict[type, Callable[[Any], Any]] = {
        Subscription: node.destroy_subscription,
        Timer: node.destroy_timer,
        Service: node.destroy_service,
        Client: node.destroy_client,
        Publisher: node.destroy_publisher,
        ActionClient: ActionClient.destroy,
    }
    for item in entities:
        destroy = next(act for kind, act in destroyers.items() if isinstance(item, kind))
        destroy(item)
