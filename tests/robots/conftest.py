from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # robot_fakes.py: importlib mode gives test folders no package

_numbers = itertools.count(2)


@pytest.fixture
def address() -> str:
    """A loopback address of its own: the ports are fixed, and tests may run side by side."""
    return f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250}.{next(_numbers) % 250}"


@pytest.fixture
def eventually() -> Callable[[Callable[[], bool]], None]:
    """Wait until something is so; generous, for a busy machine."""
    from uniforce_standins.fci.process import wait_until

    return lambda condition: wait_until(condition, 30.0) and None
