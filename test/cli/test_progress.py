"""The progress bar."""

from explore_slam.cli.progress import progress_bar


def test_nothing_is_drawn_where_stderr_is_no_terminal(capsys):
    with progress_bar('bag') as show:
        show(0.5)
    assert capsys.readouterr().err == ''


def test_the_bar_ends_at_the_whole(capsys, monkeypatch):
    monkeypatch.setattr('sys.stderr.isatty', lambda: True)
    with progress_bar('bag') as show:
        show(0.5)
        show(7.0)  # past the end counts as the end
    drawn = capsys.readouterr().err
    assert 'bag   0 %' in drawn
    assert 'bag 100 %' in drawn
    assert '700 %' not in drawn


def test_the_bar_can_be_switched_off(capsys, monkeypatch):
    monkeypatch.setattr('sys.stderr.isatty', lambda: True)
    with progress_bar('bag', enabled=False) as show:
        show(0.5)
    assert capsys.readouterr().err == ''
