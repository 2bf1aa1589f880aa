"""Train a policy with LeRobot's trainer, in ``key=value`` form, on this project's views."""

import sys
from collections.abc import Sequence

from uniforce_cli.boundary import command

HELP = """\
Train a policy with LeRobot's trainer; everything after the verb is a setting of lerobot-train.

  uniforce train policy=pi05_uniforce dataset.repo_id=local/wipe dataset.root=outputs/wipe \\
      output_dir=outputs/train steps=6000 batch_size=32

  policy=NAME            becomes --policy.type=NAME
  policy.size=tiny|base  size of the policy (default: tiny without CUDA)
  policy.touch.slots="{touch0: right, touch1: left}"   finger of each touch slot; {} = none
  policy.touch.input=none                              train without touch
  resume=true config_path=outputs/train/checkpoints/last/pretrained_model/train_config.json
                         go on with a run
  policy.train_expert_only=true | policy.freeze_vision_encoder=true | --peft.method_type=LORA
                         train fewer weights
  accelerate launch --num_processes=4 scripts/train.py …
                         train on several devices
  verify=full|quick|off  check the dataset before (default: quick if its repo_id is local/…,
                         else full)
  more: lerobot-train --help (run with --policy.type=pi05_uniforce to see this policy's settings)

Added unless given: policy.push_to_hub=false, wandb.enable=false; num_workers=0, save_freq=1000 on a
CPU. A training view at the dataset root (uniforce_view.json: cached latents, small images) is read
instead of video, many times faster.
"""


@command(None)
def main(argv: Sequence[str]) -> int:
    if not argv or list(argv) in (["--help"], ["-h"]):
        print(HELP)
        return 0
    from uniforce_cli.lerobot_training import train  # torch and LeRobot: the help does without

    train(argv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
