import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from uniforce_robots.standins.fci.process import StandIn

_numbers = itertools.count(2)


@pytest.fixture
def address() -> str:
    """A loopback address of its own: the ports are fixed, and tests may run side by side."""
    return f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250}.{next(_numbers) % 250}"


@pytest.fixture
def fci(address: str, tmp_path: Path) -> Iterator[StandIn]:
    with StandIn(address, log=tmp_path / "wire.jsonl") as standin:
        yield standin
