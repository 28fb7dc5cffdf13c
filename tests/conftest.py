from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator

import pytest
from hypothesis import settings

# Examples vary in cost with what else the machine does; a deadline would measure that. Every run draws the same ones;
# HYPOTHESIS_PROFILE=search draws others, and more.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


# Under nohup and in background jobs of a shell, Ctrl-C arrives ignored, and children of tests would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--no-skips", action="store_true", help="what skips itself fails: nothing may be missing")


def pytest_collection_finish() -> None:
    """Take what is imported out of what the garbage collector looks through, again and again."""
    gc.collect()
    gc.freeze()


def refuse_skip(report: pytest.TestReport | pytest.CollectReport, config: pytest.Config, reason: object) -> None:
    if report.skipped and config.getoption("--no-skips"):
        report.outcome = "failed"
        report.longrepr = f"skipped, with --no-skips: {reason or report.longrepr}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    refuse_skip(report, item.config, call.excinfo.value if call.excinfo else None)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Report a whole file that skips itself where a package is missing."""
    report = yield
    refuse_skip(report, collector.config, None)
    return report
