"""Every named fault of the stand-in against both real clients, once; ``make faults`` runs each ten times."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from benchmarks.trust.hostile import CLIENTS, attack, is_right, summarise
from benchmarks.trust.hostile_trials import RIGHT_NAMES


def test_every_fault_holds_the_arm_and_is_named(tmp_path: Path) -> None:
    rows = attack(list(RIGHT_NAMES), 1, tmp_path)
    assert len(rows) == len(CLIENTS) * len(RIGHT_NAMES)
    assert [row for row in rows if not is_right(row)] == []


def test_a_wrong_name_a_late_hold_and_a_taken_action_are_seen() -> None:
    right = {
        "client": "franky",
        "fault": "reflex",
        "named": "reflex",
        "hold_s": 0.1,
        "learnt_s": 0.1,
        "sent_after": 0,
    }
    assert is_right(right)
    wrong = [
        right | {"named": ""},
        right | {"hold_s": 0.6},
        right | {"learnt_s": 0.6},
        right | {"sent_after": 1},
        right | {"named": "hang"},
    ]
    assert not any(is_right(row) for row in wrong)
    line = summarise([right, *wrong])["reflex franky"]
    assert (line["trials"], line["named_right"], line["held"], line["sent_after"]) == (6, 4, 5, 1)


PROGRAM = """
import sys
from pathlib import Path
from benchmarks.trust.hostile_trials import begun_trial
print(begun_trial("franky", "garbage_state", sys.argv[1], Path(sys.argv[2])).named)
"""


def test_a_program_whose_client_hangs_ends_by_itself(address: str, tmp_path: Path) -> None:
    words = [sys.executable, "-c", PROGRAM, address, str(tmp_path)]
    said = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    assert said.stdout.strip() in RIGHT_NAMES["garbage_state"] and "hangs" in said.stderr
