"""Support for all nodes: parameters from settings, time, diagnostics, logging, the main loop."""

import contextlib
import dataclasses
import difflib
import faulthandler
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from explore_slam.environment import prepare_ros
from explore_slam.errors import ConfigError, ExploreSlamError
from explore_slam.failures import cause, save_trace
from explore_slam.messages.vehicle_settings import VehicleConfig, vehicle_settings
from explore_slam.settings import (
    Section,
    Setting,
    settings_of,
    unknown_name,
    values_of,
    with_values,
)

_END_TIMEOUT = 20.0  # s from the end of a node to that of its process, which takes well below 1 s
_NICENESS = -10  # granted to root, and where limits.conf allows it
_MISSPELT = 0.85  # similarity (difflib) from which a name is a misspelling of another
_REFUSED_ARGUMENTS = (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError)
SILENCE = 5.0  # s without a message after which its possible causes are logged
REPORT_PERIOD = 1.0  # s between diagnostics
WARNING_PERIOD = 5.0  # s between warnings of the same place in the code
OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


def _descriptor(info: Setting, note: str = '') -> ParameterDescriptor:
    text = f'{info.doc} [{info.unit}]' if info.unit else info.doc
    text += f' ({note})' if note else ''
    # dynamic typing: `speed: 1` in a YAML file is meant as 1.0; Setting.check names errors
    descriptor = ParameterDescriptor(description=text, dynamic_typing=True)
    descriptor.additional_constraints = ' | '.join(info.choices)
    low = -sys.float_info.max if info.low is None else info.low
    high = sys.float_info.max if info.high is None else info.high
    bounded = info.low is not None or info.high is not None
    if bounded and isinstance(info.default, float):
        limits = FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)
        descriptor.floating_point_range = [limits]
    elif bounded and isinstance(info.default, int):
        bounds = (int(max(low, -(2**63))), int(min(high, 2**63 - 1)))
        descriptor.integer_range = [IntegerRange(from_value=bounds[0], to_value=bounds[1], step=0)]
    return descriptor


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def declare_settings[S: Section](
    node: Node,
    tree: S,
    notes: Mapping[str, str] | None = None,
    vehicle: str = '',
    names: Collection[str] | None = None,
) -> S:
    """Declare every leaf of the tree as a parameter; return the tree with the node's values.

    notes: name -> when a change takes effect, for the description.
    vehicle: of a node that lives in its namespace; '<vehicle>.<name>' goes before '<name>', as in
    the agent, so that one parameter file serves all nodes.
    names: of the leaves that are declared; None: all.
    Raises ConfigError naming the parameter, its value and what was expected.
    """
    when = notes or {}
    values = {
        info.name: declare_setting(node, info, value, when.get(info.name, ''), vehicle)
        for info, value in settings_of(tree)
        if names is None or info.name in names
    }
    return with_values(tree, values)


def warn_of_unknown_parameters(node: Node, others: Iterable[str] = ()) -> None:
    """Log the parameters of the command line and of parameter files that the node does not have.

    others: names of parameters of other nodes of the package, which may share a file.
    """
    # rclpy has no public way to read what was given but not declared
    given, known = sorted(node._parameter_overrides), sorted(node._parameters)
    foreign = set(others)
    for name in given:
        if not node.has_parameter(name) and name not in foreign:
            text = unknown_name(name, known).replace('setting', 'parameter')
            node.get_logger().warning(text)


def warn_of_unknown_vehicle_parameters(node: Node, vehicle: str, others: Iterable[str]) -> None:
    """Log what the node of a vehicle does not have, of what it was given.

    A file may be shared with the agent, whose settings a vehicle need not have installed: only
    names that resemble one of the vehicle's are warned of, the rest is one line of information.

    others: names of parameters of the other nodes of a vehicle.
    """
    known = sorted({*node._parameters, *others, *values_of(VehicleConfig())})
    rest = []
    for name in sorted(node._parameter_overrides):
        owner, dot, leaf = name.partition('.')
        own = dot and owner == vehicle
        leaf = leaf if dot else name
        if leaf in known:
            continue
        if difflib.get_close_matches(leaf, known, n=1, cutoff=_MISSPELT):
            prefix = f'{vehicle}.' if own else ''
            names = [f'{prefix}{item}' for item in known]
            text = unknown_name(name, names).replace('setting', 'parameter')
            node.get_logger().warning(text)
        else:
            rest.append(name)
    if rest:
        node.get_logger().info(
            f'parameters that this node does not have (the agent may): {", ".join(rest)}'
        )


def declare_setting(
    node: Node, info: Setting, value: Any, note: str = '', vehicle: str = ''
) -> Any:
    """Declare one setting with its default; return the value that the node has.

    vehicle: whose '<vehicle>.<name>' goes before '<name>'.
    ConfigError for a number out of range.
    """
    own = node._parameter_overrides.get(f'{vehicle}.{info.name}') if vehicle else None
    given = _plain(value) if own is None else own.value
    try:
        node.declare_parameter(
            info.name, given, _descriptor(info, note), ignore_override=own is not None
        )
    except InvalidParameterValueException as error:  # rclpy checks the range first
        raise ConfigError(str(error)) from error
    return _plain(node.get_parameter(info.name).value)


def declare_vehicle_settings(
    node: Node, team: VehicleConfig, vehicles: Iterable[str]
) -> dict[str, VehicleConfig]:
    """Declare '<vehicle>.<setting>' of every vehicle, by default the team's; return the values.

    ConfigError naming the parameter, its value and what was expected.
    """
    names = list(vehicles)
    values: dict[str, Any] = {}
    for vehicle in names:
        for info, default in settings_of(team):
            name = f'{vehicle}.{info.name}'
            values[name] = declare_setting(node, dataclasses.replace(info, name=name), default)
    return vehicle_settings(team, values, names)


def changed_settings[S: Section](
    tree: S, parameters: list[Parameter]
) -> tuple[S, SetParametersResult]:
    """Return the tree with the parameters applied, and the answer to their sender."""
    known = {info.name for info, _ in settings_of(tree)}
    values = {item.name: item.value for item in parameters if item.name in known}
    try:
        return with_values(tree, values), SetParametersResult(successful=True)
    except ConfigError as error:
        return tree, SetParametersResult(successful=False, reason=str(error))


def now_seconds(node: Node) -> float:
    """Return the node's time (s); 0 while no simulated time has been received."""
    return float(node.get_clock().now().nanoseconds) * 1e-9


def diagnostics_message(
    node: Node, parts: Mapping[str, tuple[bytes, str, Mapping[str, Any]]], hardware: str = ''
) -> DiagnosticArray:
    """Return a DiagnosticArray of parts: name -> (level, message, values)."""
    message = DiagnosticArray()
    message.header.stamp = node.get_clock().now().to_msg()
    for name, (level, text, values) in parts.items():
        pairs = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
        message.status.append(
            DiagnosticStatus(
                level=level,
                name=f'{node.get_fully_qualified_name().lstrip("/")}: {name}',
                message=text,
                hardware_id=hardware,
                values=pairs,
            )
        )
    return message


def _text(value: Any) -> str:
    return f'{value:.4g}' if isinstance(value, float) else str(value)


class RosLogHandler(logging.Handler):
    """Forwards the log records of the package to the node's logger."""

    def __init__(self, node: Node) -> None:
        super().__init__(logging.INFO)
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        """Log one record at its level."""
        text = record.getMessage()
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)


def explain_silence(node: Node, name: str, waited: float) -> str:
    """Return the possible causes of silence on a topic (its name in the node) after a time (s)."""
    topic = node.resolve_topic_name(name)
    publishers = node.get_publishers_info_by_topic(topic)
    text = f'nothing on {topic} after {waited:.0f} s: '
    if not publishers:
        return text + (
            'no publisher found; is the vehicle running, in this ROS_DOMAIN_ID, '
            'and is the namespace right?'
        )
    found = ', '.join(
        f'{info.node_namespace.rstrip("/")}/{info.node_name} '
        f'({info.topic_type}, {info.qos_profile.reliability.name}, '
        f'{info.qos_profile.durability.name})'
        for info in publishers
    )
    return text + f'publishers {found}; they do not send, or type or QoS do not match'


def vehicle_name(node: Node) -> str:
    """Return the vehicle's name: the last part of the node's namespace.

    An agent in the namespace `fleet` calls the vehicle in `fleet/robot1` by this name, too.
    """
    return str(node.get_namespace()).rpartition('/')[2] or 'robot'


class _EndSignals:
    """SIGINT, SIGTERM and SIGHUP as a node takes them: they are noted, and it ends in its turn.

    Within `interruptible`, the first of them ends the process at once.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self._at_once = False

    def install(self) -> None:
        """Take the signals of this process from now on."""
        self.received.clear()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, _frame: Any) -> None:
        self.received.append(number)
        if self._at_once:
            _end_at_once()

    @contextlib.contextmanager
    def interruptible(self) -> Iterator[None]:
        """Let a signal that came, or comes within the block, end this process at once."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        self._at_once = True
        try:
            if self.received:
                _end_at_once()
            yield
        finally:
            self._at_once = False


def _end_at_once() -> None:
    """End this process without any clean-up.

    The compiler of the kernels calls back from C: an exception in there is lost or, in one case of
    ten, takes the process down.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(ValueError, OSError, RuntimeError):
            stream.flush()
    os._exit(0)


_end_signals = _EndSignals()


def interruptible() -> contextlib.AbstractContextManager[None]:
    """Return a context in which a signal ends the process at once.

    For long computations before anything is open that has to be closed in order.
    """
    return _end_signals.interruptible()


class StoppableNode(Protocol):
    """A node that brings its vehicle to rest before it ends."""

    executor: Any

    def stop(self) -> None:
        """Stop the vehicle; called once, whatever ended the node."""

    def destroy_node(self) -> Any:
        """Release the resources of rclpy."""

    def get_logger(self) -> Any:
        """Return the node's logger."""


def ask_for_priority() -> None:
    """Raise the priority of this process where permitted: stopping in time comes first."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)


def run_node(make: Callable[[], StoppableNode], arguments: list[str] | None = None) -> int:
    """Spin a node until SIGINT or SIGTERM, stop its vehicle, return the exit code.

    Signals are handled here and not by rclpy, whose handler shuts the context down before the
    last commands are sent; the second of two SIGINTs (terminal and launcher) is ignored. A process
    that has not ended a while later, whatever holds it, prints where it is and ends.
    """
    _end_signals.install()
    try:
        prepare_ros(os.environ)
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except _REFUSED_ARGUMENTS as error:
        # what is wrong comes first, then the places in the source of rcl
        what = str(error).partition('. Error: ')[0].partition(', at ')[0]
        logging.getLogger(__name__).error('ROS cannot start: %s', what)
        return 1
    except ExploreSlamError as error:
        logging.getLogger(__name__).error('%s', error)
        return 1
    with contextlib.ExitStack() as ending:  # each step is taken, whatever another one raises
        ending.callback(_end_in_time)
        ending.callback(rclpy.try_shutdown)
        # a node whose construction has failed is garbage, but with references in circles: left
        # to the interpreter, its threads of DDS would meet what is being destroyed at the exit
        ending.callback(gc.collect)
        try:
            node = make()
        except Exception as error:
            logging.getLogger(__name__).error('%s', _described(error))
            return 1
        ending.callback(node.destroy_node)
        ending.callback(node.stop)
        return _spin(node)


def _spin(node: StoppableNode) -> int:
    """Run a node until a signal comes or a callback fails; return the exit code."""
    try:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not _end_signals.received:
            executor.spin_once(timeout_sec=0.05)
    except ExploreSlamError as error:
        logging.getLogger(__name__).error('%s', error)
        return 1
    except Exception as error:  # the vehicle must be stopped first, whatever the error
        node.get_logger().fatal(f'stopping the vehicle: {_described(error)}')
        return 1
    finally:
        node.executor = None  # nothing spins any more: callbacks that remain run at once
    return 0


def _described(error: Exception) -> str:
    """Return one line: what is wrong, and of an unforeseen error where its trace lies."""
    if isinstance(error, ExploreSlamError):
        return str(error)
    trace = save_trace(Path(sys.argv[0]).stem, error)
    return f'{cause(error)} (full trace: {trace})'


def _end_in_time() -> None:
    """End this process after a while if it has not ended by itself, and print where it was."""
    with contextlib.suppress(ValueError, OSError):  # stderr without a file descriptor
        faulthandler.dump_traceback_later(_END_TIMEOUT, exit=True)
