"""``python campaign.py GROUP INPUTS SEED [NAME …]``: injure inputs in a process that may die, hang
or be out of memory.

Prints a line of JSON per target when it is done with it. An unexpected error ends the process with
a traceback and leaves the input in the file ``$UNIFORCE_FUZZ_KEEP``, if that is set.
"""

import json
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mutations import is_json, mutate, mutate_json

SLOWEST_S = 20.0  # CPU time of one input; the kernel ends the process
KEPT_BYTES = 1 << 16  # the beginning of a larger input is enough to know it again
IN_MEMORY = Path("/dev/shm")  # thousands of small files, written twice each
WARM_UP = 20  # readings of what is right, before memory is counted
ROOM_BYTES = 3 << 30  # address space beyond what the imports took; more ends in an unexpected error


def status_kib(name):
    """Return a number of /proc/self/status: VmHWM, the peak of resident memory, or VmRSS,
    VmSize."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1])
    raise LookupError(name)


def forget_peak():
    """Let VmHWM begin anew from what is resident now."""
    Path("/proc/self/clear_refs").write_text("5")


def run(name, inputs, read, right, typed):
    """Return the counts of one target; ``read(i)`` reads the i-th injured input, ``right()`` the
    sound one."""
    for _ in range(WARM_UP):
        right()
    forget_peak()
    before_kib, refused, slowest_s, began_s = status_kib("VmRSS"), 0, 0.0, time.monotonic()
    for i in range(inputs):
        # its signal's default is to end the process
        signal.setitimer(signal.ITIMER_PROF, SLOWEST_S)
        cpu_s = time.process_time()
        try:
            read(i)
        except typed:
            refused += 1
        slowest_s = max(slowest_s, time.process_time() - cpu_s)
    signal.setitimer(signal.ITIMER_PROF, 0)
    right()
    return {
        "target": name,
        "inputs": inputs,
        "refused": refused,
        "accepted": inputs - refused,
        "slowest_cpu_s": round(slowest_s, 4),
        "grown_MB": round((status_kib("VmHWM") - before_kib) / 1024, 1),
        "seconds": round(time.monotonic() - began_s, 1),
    }


def byte_campaign(inputs, seed, names):
    """Yield each parser's counts."""
    from byte_targets import BYTE_TARGETS

    limit_memory()
    for name in names or BYTE_TARGETS:
        yield injure_bytes(name, BYTE_TARGETS[name], inputs, np.random.default_rng(seed))


def injure_bytes(name, target, inputs, rng):
    """Return a parser's counts: nine in ten inputs injured, one plain noise."""

    def read(i):
        noise = i % 10 == 9
        data = rng.bytes(int(rng.integers(0, 2000))) if noise else mutate(rng, target.seed)
        hold(name, data)
        target.feed(rng, data)

    calm = np.random.default_rng(0)
    return run(name, inputs, read, lambda: target.feed(calm, target.seed), target.typed)


def file_campaign(inputs, seed, names):
    """Yield each reader's counts."""
    import torch
    from file_targets import FILE_TARGETS, open_target

    torch.set_num_threads(1)
    for name in names or FILE_TARGETS:
        with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
            sound, files = open_target(name, Path(folder) / "data")
            yield injure_files(name, sound, files, inputs, np.random.default_rng(seed))


def injure_files(name, sound, files, inputs, rng):
    """Return a reader's counts: one file of its folder injured at a time, values of JSON as often
    as bytes."""
    from uniforce_vtla.errors import UniForceError

    whole = {file: file.read_bytes() for file in files}
    textual = {file for file, data in whole.items() if is_json(data)}

    def read(_):
        file = list(whole)[int(rng.integers(len(whole)))]
        if file in textual and rng.random() < 0.7:
            data = mutate_json(rng, whole[file])
        else:
            data = mutate(rng, whole[file], at_the_ends=True)
        hold(file.name, data)
        file.write_bytes(data)
        try:
            sound()
        finally:
            for path, content in whole.items():
                # written by one of the readers
                if path == file or path.name == "stats.json":
                    path.write_bytes(content)

    limit_memory()
    return run(name, inputs, read, sound, UniForceError)


def hold(name, data):
    """Keep the input that is read now: a process that dies can't tell what killed it."""
    note = f"{name}, {len(data)} bytes: ".encode() + data[:KEPT_BYTES]
    Path(os.environ.get("UNIFORCE_FUZZ_KEEP", os.devnull)).write_bytes(note)


def limit_memory():
    """Let the address space grow by ``ROOM_BYTES`` from here."""
    limit = status_kib("VmSize") * 1024 + ROOM_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))


def main():
    group, inputs, seed, *names = sys.argv[1:]
    campaign = {"bytes": byte_campaign, "files": file_campaign}[group]
    for counts in campaign(int(inputs), int(seed), names):
        sys.stdout.write(json.dumps(counts) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
