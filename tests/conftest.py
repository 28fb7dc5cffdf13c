from __future__ import annotations

import signal
from collections.abc import Generator

import pytest
from hypothesis import settings

# Examples vary in cost with what else the machine does; a deadline would measure that.
settings.register_profile("house", deadline=None)
settings.load_profile("house")

# Under nohup and in background jobs of a shell, Ctrl-C arrives ignored, and children of tests would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--no-skips", action="store_true", help="a test that skips itself fails: nothing may be missing")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.skipped and item.config.getoption("--no-skips"):
        report.outcome = "failed"
        report.longrepr = f"skipped, with --no-skips: {call.excinfo.value if call.excinfo else report.longrepr}"
    return report
