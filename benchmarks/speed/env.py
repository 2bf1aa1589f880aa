"""How fast the scene runs with everything on: two cameras, two tactile fingers, one core."""

import time

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk


def bench_env(seconds: float) -> dict[str, float]:
    """Run expert episodes for ``seconds`` and return steps per CPU second of one core.

    Each step observes: two 224×224 pictures and both marker images. ``physics_steps_per_s`` is the fast path.
    """
    env, expert = WipeEnv(level="easy"), WipeExpert()
    rates = {
        "env_steps_per_s": _rate(env, expert, seconds / 2, observe=True),
        "physics_steps_per_s": _rate(env, expert, seconds / 2, observe=False),
    }
    env.close()
    return rates


def _rate(env: WipeEnv, expert: WipeExpert, seconds: float, observe: bool) -> float:
    steps, seed, start = 0, 0, time.process_time()
    while time.process_time() - start < seconds:
        for _ in walk(env, expert, seed):
            steps += 1
            if observe:
                env.observe()
            if time.process_time() - start >= seconds:
                break
        seed += 1
    return steps / (time.process_time() - start)
