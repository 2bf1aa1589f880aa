"""``uniforce VERB key=value …``: one command, its verbs grouped by what a person wants."""

import difflib
import importlib
import sys
from collections.abc import Sequence
from importlib.metadata import version

# purpose of each verb; its module is loaded when the verb is called, so that help is quick
GROUPS = {
    "begin": {
        "doctor": "list what this machine has, what it lacks and what to do",
        "demo": "record, train, score and show in 4 minutes",
    },
    "see a sensor": {
        "touch": "show a tactile sensor live, or check its rate and orientation",
        "calibrate": "fit a new sensor to a known one from grasps, without force labels",
    },
    "record": {
        "record": "record demonstrations, in simulation or on a Franka",
        "pairs": "record equilibrium pairs: both fingers hold one object",
        "show": "show recorded episodes as pages",
        "verify": "check a dataset's content against its hashes, or write them anew",
    },
    "train": {
        "view": "cache latents and small images, so that the trainer never waits",
        "train": "train a policy with LeRobot's trainer",
        "pretrain": "pretrain the tactile tokenizer",
        "convert": "make a policy to start from of published pi0.5 weights",
    },
    "score": {
        "score": "roll a policy out on paired scenes and score it; sensors may be exchanged",
        "estimate": "score a robot's recorded rollouts from its own measurements",
    },
    "hand on": {
        "share": "check a policy, write its card, upload it when asked to",
    },
}
VERBS = [name for group in GROUPS.values() for name in group]


def overview() -> str:
    """Return the text of ``uniforce --help``."""
    lines = ["uniforce VERB key=value …    (uniforce VERB --help teaches a verb by example)"]
    for title, group in GROUPS.items():
        lines += ["", f"{title}:"]
        for name, does in group.items():
            lines.append(f"  {name:10} {does}")
    lines += [
        "",
        "Measure the project's figures: python -m benchmarks.NAME, see docs/benchmark.md.",
    ]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb; 2 with one line where there is no such verb."""
    if argv is None:
        argv = sys.argv[1:]
    given = list(argv)
    if not given or given[0] in ("--help", "-h", "help"):
        print(overview())
        return 0
    if given == ["--version"]:
        print(f"uniforce-vtla {version('lerobot_policy_pi05_uniforce')}")
        return 0
    name, *rest = given
    if name not in VERBS:
        hint = "See uniforce --help."
        for near in difflib.get_close_matches(name, VERBS, n=1):
            hint = f"Did you mean {near}?"
        verbs = " | ".join(VERBS)
        print(f"uniforce: expected a verb ({verbs}), got {name}. {hint}", file=sys.stderr)
        return 2
    return importlib.import_module(f"uniforce_cli.{name}").main(rest) or 0


if __name__ == "__main__":
    sys.exit(main())
