"""Processor time of each folder's fast tests, against the budgets that CONTRIBUTING.md names.

At the end of a run, folders above their budget are shown. Nothing fails: machines differ.
"""

import os
import re
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import pytest

from tests import command_server

BUDGET = re.compile(r"^\| `tests/(\w+)` \| (\d+) \|", re.MULTILINE)
ROOT = Path(__file__).parent.parent
spent: defaultdict[str, float] = defaultdict(float)


def _seconds() -> float:
    """Return the processor time of this process and of all its children that have ended, s."""
    return sum(os.times()[:4]) + command_server.spent()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Note what a test and its fixtures take."""
    begun = _seconds()
    item.user_properties.append(("begun", begun))
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Send the time with the report of the teardown, from whichever process ran the test."""
    report = yield
    if report.when == "teardown":
        report.user_properties = [("cpu", _seconds() - float(str(item.user_properties[0][1])))]
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up by folder."""
    if report.when == "teardown":
        folder = Path(report.nodeid.split("::")[0]).parent.name
        spent[folder] += float(str(dict(report.user_properties)["cpu"]))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show the folders above their budget."""
    if terminalreporter.config.option.markexpr != "not slow":
        return
    budgets = dict(BUDGET.findall((ROOT / "CONTRIBUTING.md").read_text("utf-8")))
    for folder, seconds in spent.items():
        if folder in budgets and seconds > float(budgets[folder]):
            terminalreporter.write_line(
                f"tests/{folder}: {seconds:.0f} s of CPU, its budget is {budgets[folder]} s"
            )
    if terminalreporter.config.option.verbose > 0:
        terminalreporter.write_line(f"{sum(spent.values()):.0f} s of CPU: {dict(spent)}")
