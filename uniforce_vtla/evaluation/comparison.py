"""The plan's questions, answered from paired rows: which arm is better, which swap costs nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.evaluation.plan import AS_GOOD, BETTER, SWAP_MARGIN
from uniforce_vtla.evaluation.statistics import anytime, holm, mcnemar, non_inferior

Pairs = Sequence[tuple[str, str]]


def paired_clean(first: ArmReport, second: ArmReport) -> tuple[list[bool], list[bool]]:
    """Return clean success of both arms on the seeds they share, in the order of the seeds."""
    one, two = ({row.seed: row.clean for row in report.rows} for report in (first, second))
    seeds = sorted(one.keys() & two.keys())
    return [one[s] for s in seeds], [two[s] for s in seeds]


def better(reports: Mapping[str, ArmReport], pairs: Pairs = BETTER) -> list[dict[str, Any]]:
    """Return, per pair scored on shared seeds, exact McNemar (Holm over the family) and the anytime test."""
    tests = []
    for first, second in pairs:
        if first not in reports or second not in reports:
            continue
        one, two = paired_clean(reports[first], reports[second])
        if one:
            found = {"arms": [first, second], "n": len(one), **asdict(mcnemar(one, two))}
            tests.append(found | {"points": 100 * (sum(one) - sum(two)) / len(one)} | _watched(one, two))
    for test, adjusted in zip(tests, holm([test["p_value"] for test in tests]), strict=True):
        test["p_holm"] = adjusted
    return tests


def _watched(one: list[bool], two: list[bool]) -> dict[str, Any]:
    test = anytime(one, two)
    return {"anytime_p": test.p_value, "anytime_decided_after": test.decided_after}


def as_good(
    reports: Mapping[str, ArmReport], pairs: Pairs = AS_GOOD, margin: float = SWAP_MARGIN
) -> list[dict[str, Any]]:
    """Return, per swap scored on shared seeds, whether it is non-inferior within ``margin``."""
    tests = []
    for first, second in pairs:
        if first not in reports or second not in reports:
            continue
        one, two = paired_clean(reports[first], reports[second])
        if one:
            found = non_inferior(one, two, margin)
            tests.append({"arms": [first, second], "n": len(one), **asdict(found), "shown": found.shown})
    return tests
