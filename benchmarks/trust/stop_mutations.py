"""Would the sessions notice a broken stop? Each mutation breaks one place of a copy."""

import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.trust.broken_copy import Mutation, broken, try_all
from uniforce_cli.boundary import command

SESSIONS = 250  # at most; most breaks are seen within ten
HAND = "uniforce_vtla/hand.py"
STREAM = "uniforce_robots/franka/stream.py"
ROBOT = "uniforce_robots/franka/robot.py"
POSES = "uniforce_robots/franka/poses.py"
GUARDS = "uniforce_robots/franka/guards.py"
BASE = "uniforce_robots/teleop/base.py"
INTEGRATOR = "uniforce_robots/teleop/integrator.py"
SESSION = "uniforce_robots/recorder/session.py"
EPISODE = "uniforce_robots/recorder/episode.py"
# Left out, since another layer does the same and nothing moves either way: keys that are not
# forgotten at a start (a deflected device is refused there), letters of a note that steer (a note
# holds, and its end is a start), and a hand that is levelled at once (what is sent is checked for
# its speed).
MUTATIONS: dict[str, Mutation] = {
    "hand: goes on after a stop": (HAND, "self._stop_wanted = True", "pass"),
    "hand: keeps the wish over a stop": (
        HAND,
        "        self._wish_m = None\n        self._stop_wanted",
        "        self._stop_wanted",
    ),
    "hand: goes on at the end of a stream": (
        STREAM,
        'self._stop_one("hand", self._hand.halt)',
        "pass",
    ),
    "hand: a hold is the arm's alone": (
        STREAM,
        "            self._hand.stop()\n",
        "            pass\n",
    ),
    "stream: no watchdog": (STREAM, "            self.hold()\n            log", "            log"),
    "stream: keeps the target over a hold": (STREAM, "        self._hold_ordered = True\n", ""),
    "stream: moves a stopped arm": (STREAM, "        refuse_stopped(state)\n", ""),
    "tilt: levelled fast": (STREAM, "LEVEL_rad_m * way_m)", "0.01)"),
    "tilt: not measured": (POSES, "yaw_rad, _tilt(rotation))", "yaw_rad)"),
    "box: stay drives back": (
        GUARDS,
        "np.minimum(self.limits.low, start), np.maximum(self.limits.high, start)",
        "self.limits.low, self.limits.high",
    ),
    "robot: faults not latched": (
        ROBOT,
        "            self._fault = fault\n            self._stream.halt(fault)",
        "            pass",
    ),
    "robot: a hold does nothing": (
        ROBOT,
        "            self._stream.hold()\n",
        "            pass\n",
    ),
    "teleop: begins with a pushed cap": (
        BASE,
        "is_at_rest = not self.is_deflected()",
        "is_at_rest = True",
    ),
    "teleop: a plug that came back is none": (
        BASE,
        "self._refuse_lost()\n            with",
        "with",
    ),
    "teleop: the last target goes on": (
        INTEGRATOR,
        "self._target = np.array(measured, dtype=np.float64)\n        self._low",
        'self._target = getattr(self, "_target", np.array(measured, dtype=np.float64))\n'
        "        self._low",
    ),
    "session: a fault is forgotten at once": (SESSION, "        self._is_off = True\n", ""),
    "session: begins without a hold": (
        SESSION,
        "            driving = self._drive(driving)\n        self._parts.rig.hold()",
        "            driving = self._drive(driving)",
    ),
    "episode: a pause holds nothing": (
        EPISODE,
        "        self._pauses += 1\n        parts.rig.hold()",
        "        self._pauses += 1",
    ),
    "episode: an end holds nothing": (
        EPISODE,
        "        self._parts.rig.hold()\n        if fault",
        "        if fault",
    ),
    "episode: goes on where it paused": (
        EPISODE,
        "            self._parts.steering.start_from(axes)",
        "            pass",
    ),
}


@dataclass
class StopMutationsConfig:
    """Break one place of the stop logic at a time; count the breaks that the sessions notice.

    Example: python -m benchmarks.trust.stop_mutations out=docs/results/trust.json
    """

    only: str = ""  # part of the names to try; all when empty
    out: str = "outputs/trust.json"  # the result file; only its key ``sessions`` changes


def notice(name: str) -> str:
    """Return what moved first with this mutation, "" for a survivor; in a fresh process."""
    with broken(name, MUTATIONS[name]):
        from benchmarks.trust.stop_sessions import explore
        from benchmarks.trust.stop_world import SimWorld

        try:
            explore(SESSIONS, SimWorld)
        except AssertionError as error:
            return str(error).partition("\n")[0]
    return ""


@command(StopMutationsConfig)
def main(config: StopMutationsConfig) -> int:
    """Try all, write the table, print the survivors; 1 where there are any."""
    # imports the package, which a mutation must do first
    from benchmarks.trust.stop_sessions import store

    table = try_all(notice, [name for name in MUTATIONS if config.only in name])
    noticed = sum(bool(seen) for seen in table.values())
    found = {"mutations": [noticed, len(table)], "mutation_table": table}
    print(f"written to {store(Path(config.out), found)}")
    return int(noticed < len(table))


if __name__ == "__main__":
    sys.exit(main())
