"""Settings: groups on the command line and in files, what sizes set, and what doesn't go
together."""

import dataclasses
import sys

import draccus
import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.scripts import lerobot_train

from lerobot_policy_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import NOT_SERVED, REMOVED
from uniforce_vtla.errors import ContractError

GROUPS = ("touch", "action", "augment", "tiny", "sampler")


def parsed(*given):
    return draccus.parse(PI05UniforceConfig, args=["--size=tiny", "--device=cpu", *given])


def test_groups_are_set_one_by_one_and_the_rest_keeps_its_default():
    given = ("--touch.slots={touch1: left}", "--action.form=absolute", "--tiny.width=64")
    config = parsed(*given, "--swap=touch1:right")
    assert config.slots == ("touch1",) and config.finger_by_slot() == {"touch1": "right"}
    assert config.action.form == "absolute" and config.action.objective == "regression"
    assert (config.tiny.width, config.tiny.depth, config.augment.touch_dropout) == (64, 4, 0.0)


def test_lerobots_help_names_our_settings(monkeypatch, capsys):
    """Argparse chokes on a lone % in a comment."""
    monkeypatch.setattr(sys, "argv", ["lerobot-train", "--policy.type=pi05_uniforce", "--help"])
    with pytest.raises(SystemExit) as stop:
        lerobot_train.main()
    assert stop.value.code in (0, None) and "--policy.touch.slots" in capsys.readouterr().out


def test_a_config_survives_a_round_trip(make_config, tmp_path):
    config = make_config(swap="touch0:left", left_sensor="uskin")
    config._save_pretrained(tmp_path)
    again = PreTrainedConfig.from_pretrained(tmp_path)
    assert again == config
    given = ["--swap=touch0:right", "--touch.on_sensor_loss=mask"]
    later = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=given)
    assert later.swap == "touch0:right" and later.touch.slots == config.touch.slots
    assert later.touch.on_sensor_loss == "mask" and later.augment == config.augment


@pytest.mark.parametrize("path", REMOVED)
def test_what_was_removed_can_not_be_asked_for(path):
    with pytest.raises(SystemExit):
        parsed(f"--{path}={REMOVED[path]}")


def test_there_are_at_most_25_settings_of_our_own_at_the_top_and_35_in_groups():
    own = {f.name for f in dataclasses.fields(PI05UniforceConfig)}
    own -= {f.name for f in dataclasses.fields(PI05UniforceConfig.__base__)} | set(GROUPS)
    in_groups = [dataclasses.fields(getattr(parsed(), group)) for group in GROUPS]
    assert len(own) <= 25 and sum(map(len, in_groups)) <= 35


@pytest.mark.parametrize("name", NOT_SERVED)
def test_what_lerobots_main_adds_and_no_sampler_serves_is_refused(name, monkeypatch):
    monkeypatch.setattr(PI05UniforceConfig, name, NOT_SERVED[name] + 1, raising=False)
    settings = {}
    if name in PI05UniforceConfig.__dataclass_fields__:
        settings[name] = NOT_SERVED[name] + 1
    with pytest.raises(ContractError, match=f"{name}: expected {NOT_SERVED[name]}"):
        PI05UniforceConfig(size="tiny", device="cpu", **settings)


def test_auto_size_is_tiny_on_a_cpu_and_starts_from_no_base():
    assert parsed("--size=auto").size == "tiny"
    assert not parsed().touch.start_at_base and parsed("--size=base").touch.start_at_base


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"touch__slots": {"thumb": "left"}}, "touch slot"),
        ({"touch__slots": {"touch0": "middle"}}, "finger"),
        ({"swap": "touch9:left"}, "swap"),
        ({"swap": "touch0"}, "finger"),
        ({"touch__input": "video"}, r"touch\.input"),
        ({"action__form": "velocity"}, r"action\.form"),
        ({"action__objective": "diffusion"}, r"flow \| regression"),
        ({"dtype": "bfloat16"}, "float32"),
        ({"image_resolution": (28, 56)}, "square"),
        ({"touch__input": "wrench", "left_calibration": "map"}, "latents to map"),
    ],
)
def test_bad_settings_say_what_is_wrong(make_config, settings, said):
    with pytest.raises(ContractError, match=said):
        make_config(**settings)
