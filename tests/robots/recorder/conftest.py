import pytest
from recording_fakes import Sway, SwayConfig


@pytest.fixture
def teleop(tmp_path):
    """One that leaves nothing in anybody's home."""
    return Sway(SwayConfig(id="test", calibration_dir=tmp_path))
