"""Injuries: to bytes, and to the values inside JSON."""

import copy
import itertools
import json

TRICKS = ("flip", "drop", "repeat", "insert", "cut", "swap", "digit", "extreme")
DIGITS = b"0123456789ABCDEF\r\n\x07-"
EXTREMES = (b"\xff" * 8, b"\x00" * 8, b"\x7f" + b"\xff" * 3, b"\x80" + b"\x00" * 3, b"\xff" * 2)
END = 2048  # bytes at either end of a file, where formats keep what everything else hangs on
STRANGE = (
    *(None, True, False, 0, -1, 1, 2, 255, 2**31, 2**63, 10**30),
    *(0.5, -0.0, 1e308, float("nan"), float("inf")),
    *(
        "",
        "x",
        "..",
        "../../x",
        "/etc/passwd",
        "9" * 40,
        "\0",
        "é" * 300,
        "{0}",
        "{video_key.__class__}",
    ),
    *([], [[]], [1, 2, 3], {}, {"a": {}}, [None] * 50, ["x"] * 3, [10**12], [[[[[[]]]]]]),
)


def mutate(rng, data, at_the_ends=False):
    """Return ``data`` after one to eight random injuries; ``at_the_ends`` most of them hit a file's
    two ends."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if not out:
            break
        at, size = _place(rng, len(out), at_the_ends), int(rng.integers(1, 24))
        trick = TRICKS[int(rng.integers(len(TRICKS)))]
        if trick == "flip":
            out[at] ^= 1 << int(rng.integers(8))
        elif trick == "drop":
            del out[at : at + size]
        elif trick == "repeat":
            out[at:at] = out[at : at + size] * int(rng.integers(1, 5))
        elif trick == "insert":
            out[at:at] = rng.bytes(size)
        elif trick == "cut":
            del out[at:]
        elif trick == "swap":
            out[at : at + size] = out[at : at + size][::-1]
        elif trick == "digit":
            out[at] = DIGITS[int(rng.integers(len(DIGITS)))]
        else:
            extreme = EXTREMES[int(rng.integers(len(EXTREMES)))]
            out[at : at + len(extreme)] = extreme
    return bytes(out)


def _place(rng, length, at_the_ends):
    if at_the_ends and length > 2 * END and rng.random() < 0.7:
        return int(rng.integers(END)) - (END if rng.random() < 0.5 else 0)
    return int(rng.integers(length))


def mutate_json(rng, data):
    """Return JSON in which one to three values are strange, gone, or elsewhere."""
    content = json.loads(data)
    for _ in range(int(rng.integers(1, 4))):
        holders = [node for node in _nodes(content) if node]
        if not holders:
            break
        node = holders[int(rng.integers(len(holders)))]
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[int(rng.integers(len(keys)))]
        choice = rng.random()
        if choice < 0.2:
            del node[key]
        elif choice < 0.3 and isinstance(node, dict):
            node[str(_strange(rng))] = node.pop(key)
        else:
            node[key] = _strange(rng)
    return json.dumps(content).encode()


def is_json(data):
    """Whether values inside can be injured, and not only bytes."""
    try:
        json.loads(data)
    except ValueError:
        return False
    return True


def _strange(rng):
    """Return a value of its own: the next injury may change it."""
    return copy.deepcopy(STRANGE[int(rng.integers(len(STRANGE)))])


def _nodes(content):
    if not isinstance(content, dict | list):
        return []
    children = content.values() if isinstance(content, dict) else content
    return [content, *itertools.chain.from_iterable(_nodes(child) for child in children)]


def chunks(rng, data):
    """Return ``data`` in up to six pieces."""
    cuts = sorted(int(cut) for cut in rng.integers(0, len(data) + 1, int(rng.integers(0, 6))))
    return [data[a:b] for a, b in itertools.pairwise([0, *cuts, len(data)])]
