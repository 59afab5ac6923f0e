"""Nodes as processes: started together and ended together, without orphans."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from explore_slam.environment import one_machine
from explore_slam.errors import ExploreSlamError

# signals to end a process, in this order, and the time (s) after which the next one follows
END_SIGNALS = {signal.SIGINT: 6.0, signal.SIGTERM: 3.0, signal.SIGKILL: 2.0}
PR_SET_PDEATHSIG = 1  # of linux/prctl.h


def config_folder() -> Path:
    """Return the folder of configuration files, in the sources or installed."""
    sources = Path(__file__).resolve().parents[2] / 'config'
    if sources.is_dir():
        return sources
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        return Path(get_package_share_directory('explore_slam')) / 'config'
    except PackageNotFoundError:
        installed = Path(sys.prefix) / 'share' / 'explore_slam' / 'config'
        if installed.is_dir():
            return installed
        raise ExploreSlamError(
            f'configuration files are neither in {sources} nor in {installed}; '
            'source the workspace (install/setup.bash) or reinstall the package'
        ) from None


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Delay a KeyboardInterrupt until after the block: within rclpy it may turn into any error."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda received, _frame: asked.append(received))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked:
        signal.raise_signal(signal.SIGINT)


def one_machine_environment(log_folder: Path | None = None) -> dict[str, str]:
    """Return the environment for nodes that communicate on this machine only (`one_machine`).

    log_folder: of ROS; by default the usual one, or a temporary one if that cannot be written.
    """
    profile = config_folder() / 'fastdds_one_machine.xml'
    return one_machine(os.environ, profile, log_folder)


def use_one_machine(log_folder: Path) -> dict[str, str]:
    """Give this process, too, the environment of its nodes; return it."""
    environment = one_machine_environment(log_folder)
    for name in set(os.environ) - set(environment):
        del os.environ[name]
    os.environ.update(environment)
    return environment


def _die_with_parent() -> None:
    """Have the kernel end this process when its parent ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


@dataclass
class NodeProcess:
    """One node to start: name of its log, module below explore_slam.nodes, ROS arguments."""

    name: str
    module: str
    arguments: Sequence[str] = ()
    process: 'subprocess.Popen[bytes] | None' = field(default=None, repr=False)

    def command(self) -> list[str]:
        """Return the command line."""
        start = ('-m', 'explore_slam.nodes.executables', self.module)
        return [sys.executable, *start, *self.arguments]


class NodeProcesses:
    """Starts nodes and, as a context manager, ends them: SIGINT, then SIGTERM, then SIGKILL."""

    def __init__(
        self, nodes: Sequence[NodeProcess], logs: Path, environment: Mapping[str, str]
    ) -> None:
        self.nodes = list(nodes)
        self._logs = logs
        self._environment = dict(environment)

    def __enter__(self) -> 'NodeProcesses':
        self.start(self.nodes)
        return self

    def start(self, nodes: Sequence[NodeProcess]) -> None:
        """Start nodes, also later ones, which are ended with the others."""
        self._logs.mkdir(parents=True, exist_ok=True)
        self.nodes += [node for node in nodes if node not in self.nodes]
        try:
            for node in nodes:
                with self.log_of(node).open('wb') as log:
                    node.process = subprocess.Popen(
                        node.command(),
                        stdin=subprocess.DEVNULL,
                        stdout=log,
                        stderr=subprocess.STDOUT,
                        env=self._environment,
                        start_new_session=True,  # we pass on a terminal's Ctrl-C once
                        preexec_fn=_die_with_parent,  # noqa: PLW1509 -- a single system call
                    )
        except OSError as error:
            self._end_all()
            raise ExploreSlamError(f'a node cannot be started: {error}') from error

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end_all()

    def log_of(self, node: NodeProcess) -> Path:
        """Return the file of a node's output."""
        return self._logs / f'{node.name}.log'

    def check(self) -> None:
        """Raise ExploreSlamError if a node has ended, with the last lines of its log."""
        for node in self.nodes:
            if node.process is not None and (code := node.process.poll()) is not None:
                log = self.log_of(node)
                lines = log.read_text(errors='replace').strip().splitlines()[-4:]
                raise ExploreSlamError(
                    f'node {node.name} has ended with code {code}: '
                    + (' | '.join(lines) or 'it printed nothing')
                    + f' (see {log})'
                )

    def _running(self) -> 'list[subprocess.Popen[bytes]]':
        started = [node.process for node in self.nodes if node.process is not None]
        return [process for process in started if process.poll() is None]

    def _end_all(self) -> None:
        for number, timeout in END_SIGNALS.items():
            for process in self._running():
                process.send_signal(number)
            deadline = time.monotonic() + timeout
            while self._running() and time.monotonic() < deadline:
                time.sleep(0.05)
