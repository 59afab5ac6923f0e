"""report.html: one self-contained page that shows a run."""

from explore_slam.evaluation.run_data import RunData


def render_report(data: RunData) -> str:
    """Return the page as text."""
    return f'<!doctype html><title>{data.title}</title>'
