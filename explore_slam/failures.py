"""What ends a command or a node: one line that names the cause, and where the full trace lies."""

import contextlib
import errno
import os
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from explore_slam.environment import scratch_folder
from explore_slam.errors import ExploreSlamError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # disk, quota, limit of a file's size
INTERRUPTED = 130  # exit code of what Ctrl-C has ended


def cause(error: BaseException) -> str:
    """Return one line that names what has gone wrong."""
    text = ' '.join(str(error).split())
    if isinstance(error, ExploreSlamError):
        return text
    if isinstance(error, OSError):
        where = ' and '.join(str(n) for n in (error.filename, error.filename2) if n is not None)
        reason = error.strerror or text or type(error).__name__
        return f'{where}: {reason}' if where else reason
    if isinstance(error, ModuleNotFoundError):
        return f'{text}; is the environment set up (make setup, or the setup file of ROS)?'
    if isinstance(error, MemoryError):
        return f'out of memory{": " + text if text else ""}'
    return f'{type(error).__name__}: {text}' if text else type(error).__name__


def described(program: str, error: BaseException) -> str:
    """Return one line: the cause, and the file that has the trace of an unforeseen error."""
    if isinstance(error, ExploreSlamError):
        return f'{program}: {cause(error)}'
    if is_full(error):  # there is nothing to be found in a trace
        return f'{program}: {cause(error)}; what was written before stays'
    return f'{program}: {cause(error)} (full trace: {save_trace(program, error)})'


def is_full(error: BaseException) -> bool:
    """Return whether an error says that nothing more can be written: disk, quota or limit."""
    return isinstance(error, OSError) and error.errno in _FULL


def save_trace(program: str, error: BaseException) -> str:
    """Write the traceback of an error to a file; return its path, or why there is none."""
    lines = [
        f'{time.strftime("%Y-%m-%d %H:%M:%S%z")}  {" ".join(sys.orig_argv)}\n',
        f'Python {sys.version}\n\n',
        *traceback.format_exception(error),
    ]
    try:
        descriptor, path = tempfile.mkstemp(
            prefix=f'{program.replace(" ", "_")}_', suffix='.trace', dir=scratch_folder()
        )
        with open(descriptor, 'w', encoding='utf-8', errors='replace') as file:
            file.writelines(lines)
    except OSError as lost:
        return f'not written, {lost.strerror or lost}'
    return str(Path(path))


def run_guarded(program: str, run: Callable[[], int]) -> int:
    """Run a command or a node; return its exit code.

    Whatever it raises is one line on stderr, and the exit code is 1; 130 after Ctrl-C. The same
    holds for what an own thread raises, which does not end the process.
    """
    threading.excepthook = lambda lost: _report_thread(program, lost)
    code = 1
    try:
        code = run()
        sys.stdout.flush()
    except KeyboardInterrupt:
        _say('interrupted')
        code = INTERRUPTED
    except BrokenPipeError:  # the reader of our output has ended
        _discard_output()
    except Exception as error:
        _say(described(program, error))
        if is_full(error):
            _discard_output()  # the output itself may be what is full
    return code


def _report_thread(program: str, lost: threading.ExceptHookArgs) -> None:
    if lost.exc_value is not None and not issubclass(lost.exc_type, SystemExit):
        _say(described(program, lost.exc_value))


def _discard_output() -> None:
    """Let what is left of the output be lost in silence when the interpreter flushes it."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        return
    with contextlib.suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)


def _say(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed, or full
        sys.stderr.write(f'{line}\n')
        sys.stderr.flush()
