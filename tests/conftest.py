"""What holds for all tests."""

import gc
import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from jezero.base import plugins
from jezero.base.config import WORLD_VARIABLE

plugins.GROUP = "jezero.actions.none"
"""The actions of packages that are installed beside jezero are left out of what runs in the tests' own process: each of
them would change the flights and missions of all seeds."""


settings.register_profile("jezero", deadline=None)
settings.load_profile("jezero")
"""An example may take any time: a busy machine makes each of them slow."""


def pytest_configure() -> None:
    """Let Ctrl+C reach the programs that tests start, also where the tests run in the background of a script.

    A shell without job control starts background commands with SIGINT ignored. Children inherit that, but no handler.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Leave all that exists before the first test out of garbage collection.

    Collections are then quicker and come more often. So the simulated worlds of ended flights are freed sooner: each
    holds some hundred megabytes in the physics engine, which Python doesn't count.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def no_world_chosen() -> Iterator[None]:
    """No world is chosen when a test begins: the option `--world` sets the environment of the whole process."""
    yield
    os.environ.pop(WORLD_VARIABLE, None)
