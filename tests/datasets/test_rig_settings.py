"""A dataset knows the settings of its rig, and nothing of the machine, the network or the
person."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.rig_settings import RIG, agreed_changes, plain_settings, stored_settings
from uniforce_datasets.synthetic import record_synthetic, synthetic_frame
from uniforce_vtla.errors import ContractError, DatasetError

CAMERA = {"type": "opencv", "index_or_path": "/dev/video0", "fps": 30, "token": "t0ken"}
ROBOT = {
    "id": "anna's",
    "address": "10.1.2.3",
    "calibration_dir": "/home/anna/x",
    "gains": {"stiffness": (800.0, 800.0)},
    "cameras": {
        "front": CAMERA,
        "wrist": CAMERA | {"index_or_path": 2, "source": "http://anna:s3cret@10.1.2.3/x"},
    },
    "resting_level": "~anna/rest.npy",
    "note": Path("/home/anna/y"),
}


def test_settings_are_stored_without_person_machine_or_network():
    plain = plain_settings("robot", ROBOT)
    text = json.dumps(plain)
    assert not re.search(r"anna|10\.1\.2\.3|/dev|s3cret|t0ken|/home", text)
    assert plain["robot.gains.stiffness"] == [800.0, 800.0]
    assert plain["robot.cameras.front.type"] == "opencv"
    other = {"cameras": {"front": CAMERA | {"index_or_path": "/dev/video1"}}}
    key = "robot.cameras.front.index_or_path"
    assert plain_settings("robot", other)[key] != plain[key] == plain_settings("robot", ROBOT)[key]


def test_a_session_with_other_settings_is_refused_by_name_unless_accepted(tmp_path):
    root = tmp_path / "data"
    first = {"turn": 0, "gains": [800.0], "left": "tactip"}
    now = {"turn": 180, "gains": [1200.0], "new": True}
    assert not agreed_changes(root, first, accept=False)
    record_synthetic(root, 1, 2)
    with EpisodeRecorder(root, "local/synthetic", "gelsight", "tactip") as recorder:
        for settings in (first, first, now):
            for step in range(2):
                recorder.add(synthetic_frame(step, np.random.default_rng(0)), "wipe")
            recorder.save(True, "success", 0, settings=settings)
    assert [stretch["from_episode"] for stretch in stored_settings(root)] == [1, 3]
    assert len(check_dataset(root, "full").episodes) == 4
    said = r"gains \[1200.0\] → \[800.0\], turn 180 → 0.*settings_changed=accept"
    with pytest.raises(ContractError, match=said):
        agreed_changes(root, first, accept=False)
    changed = {"turn": (180, 0), "gains": ([1200.0], [800.0])}
    assert agreed_changes(root, first, accept=True) == changed
    for damage in ("[]", '{"stretches": 3}', '{"stretches": [{"settings": 3}]}', "{"):
        (root / RIG).write_text(damage)
        with pytest.raises(DatasetError, match=r"rig\.json"):
            agreed_changes(root, first, accept=True)
