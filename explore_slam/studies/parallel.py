"""The runs of a study on this machine or on a Dask cluster, by joblib.

A run is a call of a function with arguments that determine its result, seed included. Results
therefore do not depend on where, or how many times, a run is made.
"""

import gc
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from explore_slam.errors import EvaluationError

logger = logging.getLogger(__name__)

# how often the runs that are left are begun anew on this machine; Dask has a setting of its own,
# distributed.scheduler.allowed-failures, 3 by default
_ATTEMPTS = 3
_CONNECTION_TIMEOUT = 10.0  # s, to find the scheduler


class Workers(NamedTuple):
    """Where runs are made: in some processes of this machine, or on a cluster.

    processes: their number.
    cluster: address of the scheduler of a Dask cluster, such as 'tcp://host:8786'; '': none.
    """

    processes: int = 1
    cluster: str = ''


ALONE = Workers()


def make_runs[T](
    run: Callable[..., T], arguments: Sequence[tuple[Any, ...]], workers: Workers
) -> Iterator[T]:
    """Yield run(*arguments) for each of the arguments, in their order.

    A run whose worker has died is made again. EvaluationError if workers keep dying, if there is
    no such cluster, and without the packages that a cluster needs.
    """
    if workers.cluster:
        with _cluster(workers.cluster) as joblib:
            yield from _on_cluster(joblib, run, arguments)
    elif workers.processes <= 1 or len(arguments) <= 1:
        yield from (run(*one) for one in arguments)
    else:
        yield from _here(run, arguments, workers.processes)


def _here[T](
    run: Callable[..., T], arguments: Sequence[tuple[Any, ...]], count: int
) -> Iterator[T]:
    """Make runs in processes of this machine."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    done = 0
    for _ in range(_ATTEMPTS):
        # one run is a batch, however short; large arguments are copied, not mapped from a file
        parallel = joblib.Parallel(
            n_jobs=count, return_as='generator', batch_size=1, max_nbytes=None
        )
        try:
            for result in parallel(joblib.delayed(run)(*one) for one in arguments[done:]):
                done += 1
                yield result
        except TerminatedWorkerError:
            logger.warning(
                'a worker process has died (is the memory full?); %d of %d runs are begun anew',
                len(arguments) - done, len(arguments),
            )  # fmt: skip
        else:
            return
    raise EvaluationError(
        f'worker processes have died {_ATTEMPTS} times, {len(arguments) - done} of '
        f'{len(arguments)} runs are missing: use fewer workers (--workers)'
    )


def _on_cluster[T](
    joblib: Any, run: Callable[..., T], arguments: Sequence[tuple[Any, ...]]
) -> Iterator[T]:
    """Make runs on the cluster to which this process is connected."""
    with joblib.parallel_config(backend='dask'):
        parallel = joblib.Parallel(n_jobs=-1, return_as='generator', batch_size=1)
        yield from parallel(joblib.delayed(run)(*one) for one in arguments)


@contextmanager
def _cluster(address: str) -> Iterator[Any]:
    """Connect to a Dask cluster; the value is joblib, which then may use it."""
    try:
        import joblib
        from distributed import Client
    except ImportError as error:
        raise EvaluationError(
            f'--cluster needs the packages dask and distributed ({error}): '
            'pip install dask distributed'
        ) from error
    problem = ''
    try:
        client = Client(address, timeout=_CONNECTION_TIMEOUT, set_as_default=True)
    except (OSError, ValueError) as error:
        problem = str(error) or type(error).__name__
    if problem:
        # The client that could not connect closes itself when it is collected as garbage. That
        # must not happen while another one starts, since both take the same lock of Dask's.
        gc.collect()
        raise EvaluationError(
            f'no Dask scheduler at {address!r} ({problem}); expected an address such as '
            'tcp://host:8786, as the command dask scheduler prints it'
        )
    try:
        yield joblib
    finally:
        client.close()
