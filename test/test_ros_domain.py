"""No two test modules may share a domain: they run at the same time."""

import re
from pathlib import Path

import pytest
from ros_domain import default_domain, own_domain

TESTS = Path(__file__).parent


def test_every_module_has_a_number_of_its_own():
    numbers = {}  # of each, the modules that have it
    for path in {*TESTS.rglob('test_*.py')} - {Path(__file__)}:
        for number in re.findall(r'own_domain\((\d+)\)', path.read_text(encoding='utf-8')):
            numbers.setdefault(int(number), set()).add(path.relative_to(TESTS))
    assert len(numbers) > 15
    assert all(16 <= number < 100 for number in numbers)
    assert {n: names for n, names in numbers.items() if len(names) > 1} == {}


def test_domains_of_one_run_differ_and_are_known_to_all_its_processes(monkeypatch):
    monkeypatch.setenv('PYTEST_XDIST_TESTRUNUID', 'a run')
    domains = [own_domain(number) for number in range(100)]
    assert sorted(domains) == list(range(1, 101))
    monkeypatch.setenv('PYTEST_XDIST_WORKER', 'gw1')
    assert default_domain() == own_domain(1)
    monkeypatch.setenv('PYTEST_XDIST_TESTRUNUID', 'the next run')
    assert own_domain(1) != domains[1]


@pytest.mark.parametrize('text', ["'ROS_DOMAIN_ID': '", 'domain_id=7', 'domain_id=9'])
def test_no_test_has_a_domain_that_is_the_same_in_all_runs(text):
    own = Path(__file__).name
    found = [path.name for path in TESTS.rglob('*.py') if text in path.read_text('utf-8')]
    assert [name for name in found if name != own] == []
