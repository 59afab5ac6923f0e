"""The first start says that it compiles; later ones say nothing."""

import threading

from explore_slam import agent as package


def test_progress_is_told_only_while_kernels_are_compiled(monkeypatch):
    told = []
    package.warm_up()
    package.warm_up(told.append)  # all are compiled now: nothing to tell
    assert told == []
    # as if loading had taken too long: the announcement comes at once
    announced = threading.Event()
    monkeypatch.setattr(package, '_LOADING', 0.0)
    monkeypatch.setattr(package.registration, 'warm_up', lambda: announced.wait(10.0))

    def progress(text):
        told.append(text)
        announced.set()

    monkeypatch.setattr(package, '_NOTICEABLE', 0.0)
    package.warm_up(progress)
    assert told[0] == 'compiling kernels (once, about a minute) ...'
    assert told[1] == 'kernels of registration are ready (1 of 6)'
    assert told[-1] == 'kernels of exploration are ready (6 of 6)'
    assert len(told) == 7

    told.clear()
    announced.clear()
    monkeypatch.setattr(package, '_NOTICEABLE', 1e3)  # as if no part took any time
    package.warm_up(progress)
    assert told[1:] == ['kernels of exploration are ready (6 of 6)']
