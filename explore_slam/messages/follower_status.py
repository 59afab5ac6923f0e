"""The status of a path follower as a diagnostic_msgs/DiagnosticStatus.

Its message is one word of FollowerState; its values are `reason` (a sentence) and `since` (s, ROS
time), from when on the state holds.
"""

import math
from typing import Any

from explore_slam.data import FollowerReport, FollowerState
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory

# levels of DiagnosticStatus, one byte each
_OK, _WARN = b'\x00', b'\x01'
_FINE = (FollowerState.DRIVING, FollowerState.ARRIVED, FollowerState.TELEOPERATED)


def follower_status_message(factory: MessageFactory, vehicle: str, report: FollowerReport) -> Any:
    """Return a diagnostic_msgs/DiagnosticStatus of a report."""
    values = {'reason': report.reason, 'since': f'{report.since:.3f}'}
    return factory.make(
        'diagnostic_msgs/DiagnosticStatus',
        level=_OK if report.state in _FINE else _WARN,
        name=f'{vehicle}: path follower',
        message=report.state.value,
        hardware_id=vehicle,
        values=[
            factory.make('diagnostic_msgs/KeyValue', key=key, value=value)
            for key, value in values.items()
        ],
    )


def follower_report(message: Any) -> FollowerReport:
    """Return the report in a DiagnosticStatus; DataError for a word that is none of the states."""
    words = [state.value for state in FollowerState]
    if message.message not in words:
        raise DataError(f'follower status: {message.message!r}, expected one of {words}')
    values = {pair.key: pair.value for pair in message.values}
    try:
        since = float(values.get('since', 'nan'))
    except ValueError:
        since = math.nan
    return FollowerReport(FollowerState(message.message), values.get('reason', ''), since)
