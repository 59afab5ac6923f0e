"""What processes of nodes are started and ended with."""

import signal
import threading

import pytest

from explore_slam.live.processes import interrupts_held


@pytest.fixture(autouse=True)
def interruptible():
    """A shell's background job ignores SIGINT: these tests need Python's own handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_comes_after_what_it_would_have_broken():
    done = []

    def spin():
        with interrupts_held():
            signal.raise_signal(signal.SIGINT)
            done.append('spun')

    with pytest.raises(KeyboardInterrupt):
        spin()
    assert done == ['spun']
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_within_leaves_the_handler_as_it_was():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match='broken'), interrupts_held():
        raise ValueError('broken')
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_may_spin_too():
    done = []

    def spin():
        with interrupts_held():
            done.append('spun')

    thread = threading.Thread(target=spin)
    thread.start()
    thread.join()
    assert done == ['spun']
