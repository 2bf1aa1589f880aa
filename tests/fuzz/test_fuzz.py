"""Injured inputs into everything that reads what others send or wrote: no hang, no crash, no
untyped error, no flood.

Each group runs in a process of its own, whose address space is limited and whose peak of memory is
counted. Variables of the environment:

- ``UNIFORCE_FUZZ_INPUTS`` and ``UNIFORCE_FUZZ_FILES``: inputs for each parser of bytes and for each
  reader of files; few in the suite, 100,000 and 2,000 by ``make fuzz``.
- ``UNIFORCE_FUZZ_RESULTS``: file that keeps the counts, beside those kept before.
- ``UNIFORCE_FUZZ_TARGETS``: some of the targets instead of all, comma between them.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from byte_targets import BYTE_TARGETS
from file_targets import FILE_TARGETS

from uniforce_vtla.results_file import provenance, write_json

HERE = Path(__file__).parent
SHARE = {
    "bytes": os.environ.get("UNIFORCE_FUZZ_INPUTS", "1500"),
    "files": os.environ.get("UNIFORCE_FUZZ_FILES", "25"),
}
SEED = os.environ.get("UNIFORCE_FUZZ_SEED", "0")
RESULTS = os.environ.get("UNIFORCE_FUZZ_RESULTS", "")
ASKED = set(filter(None, os.environ.get("UNIFORCE_FUZZ_TARGETS", "").split(",")))
EVERY = {"bytes": tuple(BYTE_TARGETS), "files": tuple(FILE_TARGETS)}
TARGETS = {
    group: [name for name in names if not ASKED or name in ASKED] for group, names in EVERY.items()
}
MOST_MB = {"bytes": 64, "files": 512}  # of resident memory beyond what the sound inputs took


@pytest.fixture(scope="module", params=["bytes", pytest.param("files", marks=pytest.mark.thorough)])
def campaign(request, tmp_path_factory):
    """(group, counts by target) of a process that went through every target of a group."""
    group, folder = request.param, tmp_path_factory.mktemp("input")
    last, said = folder / "last", folder / "stderr"
    if not TARGETS[group]:
        pytest.skip(f"none of {sorted(ASKED)} reads {group}")
    command = [sys.executable, HERE / "campaign.py", group, SHARE[group], SEED, *TARGETS[group]]
    paths = os.pathsep.join(filter(None, sys.path))
    how = {"text": True, "env": os.environ | {"PYTHONPATH": paths, "UNIFORCE_FUZZ_KEEP": str(last)}}
    found = []
    with (
        said.open("w") as stderr,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, **how) as process,
    ):
        for line in process.stdout:
            found.append(json.loads(line))
            keep(group, found)
    over = last.read_bytes()[:500] if last.exists() else b""
    tail = said.read_text(errors="replace")[-3000:]
    assert process.returncode == 0, f"{process.returncode}, over {over!r}:\n{tail}"
    return group, {counts["target"]: counts for counts in found}


def keep(group, found):
    """Put what a group has counted so far in place of earlier counts of the same targets, where
    results are wanted."""
    if not RESULTS:
        return
    path = Path(RESULTS)
    earlier = json.loads(path.read_text()) if path.exists() else {}
    groups = earlier.get("groups", {})
    counts = {count["target"]: count for count in [*groups.get(group, []), *found]}
    content = {
        "what": "injured inputs: refused with a typed error, or read; "
        "a hang or a crash would have ended the run",
        "seed": int(SEED),
        "groups": groups | {group: [counts[name] for name in EVERY[group] if name in counts]},
    }
    write_json(path, content | provenance())


def test_every_target_survives(campaign):
    """Sound inputs are read, too, before the injured ones and after them."""
    group, counts = campaign
    assert counts.keys() == set(TARGETS[group])
    for name, count in counts.items():
        assert count["inputs"] == int(SHARE[group]) == count["refused"] + count["accepted"]
        assert count["grown_MB"] < MOST_MB[group], name
        if group == "files" or BYTE_TARGETS[name].refuses:
            assert count["refused"], name
        if group == "bytes":
            assert count["accepted"], f"{name}: nothing was tested if nothing makes sense"


@pytest.mark.parametrize(
    "crime, says",
    [
        ("raise ValueError('untyped')", "untyped"),
        ("os.abort()", "-6"),
        ("exec('while True: pass')", "-27"),  # SIGPROF: too much CPU time for one input
        ("np.ones(4 << 30, np.uint8)", "Unable to allocate"),
    ],
)
def test_the_campaign_sees_what_it_looks_for(crime, says):
    program = (
        "import os, numpy as np, campaign\n"
        "campaign.SLOWEST_S, campaign.WARM_UP = 0.5, 1\n"
        "campaign.limit_memory()\n"
        f"def read(i): {crime}\n"
        "campaign.run('x', 1, read, lambda: None, (KeyError,))\n"
    )
    environment = os.environ | {"PYTHONPATH": str(HERE)}
    how = {"capture_output": True, "text": True, "env": environment, "timeout": 120}
    done = subprocess.run([sys.executable, "-c", program], **how)
    assert done.returncode != 0 and says in f"{done.returncode} {done.stderr}"
