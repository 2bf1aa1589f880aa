"""Would the attack notice a broken guard? Each mutation breaks one place of a copy of the package."""

import importlib.util
import logging
import multiprocessing
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

import uniforce_robots
from benchmarks.ledger import update
from uniforce_cli.boundary import command
from uniforce_vtla.errors import ContractError, expected

PACKAGE = Path(str(importlib.util.find_spec("uniforce_robots.franka").origin)).parent  # type: ignore[union-attr]
SEEDS, EPISODES = 8, 25
SEND, GUARDS, STREAM, STATE, ROBOT = (
    "state_check.py",
    "guards.py",
    "stream.py",
    "state_check.py",
    "robot.py",
)
# A last check without its look at NaN is none of these: its box refuses NaN, too.
# name: file, what stands there, what is put in its place
MUTATIONS: dict[str, tuple[str, str, str]] = {
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
        "self._rest_wanted, self._holding = False, True",
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
# once, they take seconds; never the package itself
PRELOAD = ["lerobot.robots", "uniforce_robots.sensors"]


@dataclass
class MutationsConfig:
    """Break one guard at a time; count the breaks that the attack notices.

    Example: python -m benchmarks.trust.mutations out=docs/results/trust.json
    """

    out: str = "outputs/trust.json"  # the result file; only its key ``mutations`` changes


def notice(name: str) -> str:
    """Return the first violation found on a package with this mutation, "" for a survivor; needs a fresh process."""
    file, old, new = MUTATIONS[name]
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(PACKAGE, Path(folder) / PACKAGE.name))
        text = (copy / file).read_text()
        if text.count(old) != 1:
            raise ContractError(
                expected(name, f"{old!r} once in {file}", text.count(old), "Mend the table.")
            )
        (copy / file).write_text(text.replace(old, new))
        uniforce_robots.__path__.insert(0, folder)  # the copy is found before the package itself
        from benchmarks.trust.guard_cases import drive

        tried = sys.modules["uniforce_robots.franka"].__file__ or ""
        if not tried.startswith(folder):
            raise ContractError(
                expected(name, f"cases on the copy in {folder}", tried, "Is it preloaded?")
            )
        return next(
            (found[0] for seed in range(SEEDS) if (found := drive(EPISODES, seed)["violations"])),
            "",
        )


@command(MutationsConfig)
def main(config: MutationsConfig) -> int:
    """Try all, write the table, print the survivors; 1 where there are any."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    with ProcessPoolExecutor(2, mp_context=context, max_tasks_per_child=1) as pool:
        found = tqdm(pool.map(notice, MUTATIONS), total=len(MUTATIONS), desc="mutations")
        table = dict(zip(MUTATIONS, found, strict=True))
    survivors = [name for name, found in table.items() if not found]
    row = {
        "tried": len(table),
        "noticed": len(table) - len(survivors),
        "survivors": survivors,
        "table": table,
    }
    path = update(Path(config.out), "mutations", row)
    print(
        f"{row['noticed']} of {row['tried']} noticed; survivors: {survivors or 'none'}; written to {path}"
    )
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main())
