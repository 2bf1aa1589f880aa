"""Would the attack notice a broken guard? Each mutation breaks one place of a copy of the robot."""

import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.trust.broken_copy import Mutation, broken, try_all
from uniforce_cli.boundary import command

SEEDS = 8
EPISODES = 25
SEND = "uniforce_robots/franka/state_check.py"
GUARDS = "uniforce_robots/franka/guards.py"
STREAM = "uniforce_robots/franka/stream.py"
STATE = SEND
ROBOT = "uniforce_robots/franka/robot.py"
# A last check without its look at NaN is none of these: its box refuses NaN, too.
MUTATIONS: dict[str, Mutation] = {
    "sent: box unchecked": (SEND, "self._require_box(target, last, here)", "pass"),
    "sent: box 1 cm wider": (SEND, "self._low) - ROUNDING", "self._low) - 0.01"),
    "sent: rate unchecked": (SEND, "self._require_rate(target, last, here, elapsed_s)", "pass"),
    "sent: turn rate unchecked": (
        SEND,
        "_turn(target, last) <= limits.speed_rad_s * elapsed_s + ROUNDING",
        "True",
    ),
    "sent: distance unchecked": (SEND, "self._require_near(target, here)", "pass"),
    "sent: last pose forgotten": (
        SEND,
        "self._last = target\n        self._last_s = now_s",
        "pass",
    ),
    "sent: a pause buys a jump": (
        SEND,
        "min(max(now_s - self._last_s, 0.0), gap_s)",
        "now_s - self._last_s",
    ),
    "sent: refuses at half the speed": (
        SEND,
        "limits.speed_m_s * elapsed_s + R",
        "limits.speed_m_s * elapsed_s / 2 + R",
    ),
    "guards: no box": (
        GUARDS,
        "np.clip(\n            action, np.minimum(self.limits.low, start), "
        "np.maximum(self.limits.high, start)\n        )",
        "action",
    ),
    "guards: no step": (GUARDS, "self._step(boxed, measured)", "boxed"),
    "guards: no rate": (GUARDS, "self._rate(stepped, last, elapsed_s)", "stepped"),
    "guards: width at any speed": (GUARDS, "limits.speed_width_m_s * elapsed_s", "1.0"),
    "guards: last target forgotten": (
        GUARDS,
        "self._last = sent\n        self._last_s = now_s",
        "pass",
    ),
    "guards: a pause buys a jump": (
        GUARDS,
        "min(max(now_s - self._last_s, 0.0), gap_s)",
        "now_s - self._last_s",
    ),
    "guards: turns the long way": (
        GUARDS,
        "turn = shortest_turn(start_rad, goal_rad)",
        "turn = -goal_rad",
    ),
    "stream: sends unchecked": (
        STREAM,
        "self._check_sent(target, ToolPose.from_ee(state.ee_to_base), now)",
        "pass",
    ),
    "stream: readings unchecked": (
        STREAM,
        "        self._check_state(state)\n        self._refuse",
        "        self._refuse",
    ),
    "stream: first reading unchecked": (
        STREAM,
        "        self._check_state(state)\n        require",
        "        require",
    ),
    "stream: ramps unslowed": (
        STREAM,
        "self._slowed(goal, now_s)",
        "goal",
    ),
    "stream: begins at the goal": (
        STREAM,
        "            return self._measured()\n        limits",
        "            return goal\n        limits",
    ),
    "stream: no watchdog": (STREAM, "            self.hold()\n            log", "            log"),
    "stream: rest follows the arm": (
        STREAM,
        "self._hold_ordered, self._holding = False, True",
        "self._holding = True",
    ),
    "stream: moves a stopped arm": (STREAM, "        refuse_stopped(state)\n", ""),
    "stream: a halt ends nothing": (
        STREAM,
        "self.fault = self.fault or fault\n        self._ending.set()",
        "pass",
    ),
    "state: numbers unchecked": (
        STATE,
        "if not (whole and np.isfinite(state.robot_time_s)):",
        "if False:",
    ),
    "state: force unchecked": (STATE, "if not np.isfinite(state.wrench_N).all():", "if False:"),
    "state: speed unchecked": (
        STATE,
        "if (np.abs(state.dq_rad_s) > JOINT_SPEED_rad_s).any():",
        "if False:",
    ),
    "state: jumps pass": (STATE, "if far or turned or jumped.any():", "if False:"),
    "state: clocks run backwards": (STATE, "if elapsed_s < 0:", "if False:"),
    "state: mirrored poses pass": (STATE, " or np.linalg.det(rotation) < 0", ""),
    "robot: faults not latched": (
        ROBOT,
        "            self._fault = fault\n            self._stream.halt(fault)",
        "            pass",
    ),
    "robot: words are numbers": (ROBOT, "if isinstance(value, bool | str | bytes):", "if False:"),
    "robot: recovers with the old target": (
        ROBOT,
        "        self._fault = None\n        self.guards.reset()",
        "        self._fault = None",
    ),
    "robot: unguarded": (ROBOT, "self.guards(wanted, measured, self._clock())", "wanted"),
}


@dataclass
class MutationsConfig:
    """Break one guard at a time; count the breaks that the attack notices.

    Example: python -m benchmarks.trust.mutations out=docs/results/trust.json
    """

    out: str = "outputs/trust.json"  # the result file; only its key ``mutations`` changes


def notice(name: str) -> str:
    """Return the first violation found with this mutation, "" for a survivor; a fresh process."""
    with broken(name, MUTATIONS[name]):
        from benchmarks.trust.guard_cases import drive

        for seed in range(SEEDS):
            violations = drive(EPISODES, seed)["violations"]
            if violations:
                return str(violations[0])
    return ""


@command(MutationsConfig)
def main(config: MutationsConfig) -> int:
    """Try all, write the table, print the survivors; 1 where there are any."""
    from benchmarks.ledger import update

    table = try_all(notice, list(MUTATIONS))
    survivors = [name for name, seen in table.items() if not seen]
    noticed = len(table) - len(survivors)
    row = {"tried": len(table), "noticed": noticed, "survivors": survivors, "table": table}
    print(f"written to {update(Path(config.out), 'mutations', row)}")
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main())
