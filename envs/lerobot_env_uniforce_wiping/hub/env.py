"""The wiping scene for LeRobot's EnvHub: ``make_env("NAME/REPO", trust_remote_code=True)``."""

from dataclasses import replace

from lerobot.envs.configs import EnvConfig

from lerobot_env_uniforce_wiping import UniforceWipingConfig

BENCHMARK = UniforceWipingConfig(level="touch")


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: EnvConfig | None = None) -> dict:
    """Return {"uniforce_wiping": {0: gymnasium VectorEnv of ``n_envs`` scenes}}.

    Args:
        n_envs: scenes side by side.
        use_async_envs: a process for each.
        cfg: gives level, sensors and episode_length; None: the benchmark's own.
    """
    settings = {}
    for name in (*BENCHMARK.gym_kwargs, "episode_length"):
        if hasattr(cfg, name):
            settings[name] = getattr(cfg, name)
    return replace(BENCHMARK, **settings).create_envs(n_envs=n_envs, use_async_envs=use_async_envs)
