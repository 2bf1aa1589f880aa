"""How fast the scene runs on one core, once an episode has begun."""

import time

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contracts import FINGERS, Finger

LEVEL = "touch"
LOOKS_EVERY = 2  # steps, as `tiny` looks


def bench_env(seconds: float) -> dict[str, float]:
    """Let the expert wipe for ``seconds`` each and return steps per CPU second of one core.

    ``env_steps_per_s`` observes as `tiny` does: two 224×224 pictures and the raw path of one finger, every second step.
    ``direct`` looks alike at the drawing in place of the raw path, ``all`` at both fingers' raw paths at every step,
    ``physics`` at nothing.
    """
    one: tuple[Finger, ...] = ("right",)
    return {
        "env_steps_per_s": _rate(WipeEnv(LEVEL, drawn=one), seconds / 4, LOOKS_EVERY),
        "env_steps_direct_per_s": _rate(
            WipeEnv(LEVEL, right_sensor="tactip:drawing", drawn=one), seconds / 4, LOOKS_EVERY
        ),
        "env_steps_all_per_s": _rate(WipeEnv(LEVEL, drawn=FINGERS), seconds / 4, 1),
        "physics_steps_per_s": _rate(WipeEnv(LEVEL), seconds / 4, 0),
    }


def _rate(env: WipeEnv, seconds: float, every: int) -> float:
    steps, seed, spent = 0, 20_000, 0.0
    while spent < seconds:
        begun = None  # building the scene isn't a step
        for _ in walk(env, WipeExpert(), seed):
            spent += 0.0 if begun is None else time.process_time() - begun
            if spent >= seconds:
                break
            begun = time.process_time()
            steps += 1
            if every and steps % every == 0:
                env.observe()
        seed += 1
    env.close()
    return steps / spent
