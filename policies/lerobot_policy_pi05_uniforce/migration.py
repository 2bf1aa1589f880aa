"""A checkpoint of version 0.1.0, whose settings stood side by side, in today's groups: ``… .migration FOLDER…``."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lerobot.policies.pi05.configuration_pi05 import PI05Config

from lerobot_policy_pi05_uniforce.recipes import SCORED
from uniforce_vtla.errors import CheckpointError, UniForceError
from uniforce_vtla.file_hashes import HASHES, check_hashes, write_hashes
from uniforce_vtla.json_file import read_object

FLAT = "touch_input"  # a setting of the form of 0.1.0 alone
OWN = ("size", "swap", "left_sensor", "right_sensor", "text_tokenizer_name", "trained_on")
NAMES = {  # group → old name: new one; a name alone stays
    "touch": "touch_slots:slots touch_input:input token_site:site start_at_base touch_directions:directions "
    "on_sensor_loss next_force_weight trained_sensors tokenizer_path",
    "action": "action_form:form action_objective:objective delta_scale delta_knee target_range "
    "last_move_steps:previous_steps last_move_axes:previous_axes stop_outside_demos",
    "augment": "camera_variation touch_noise touch_dropout state_noise sensor_transfer",
    "tiny": "tiny_width:width tiny_depth:depth tiny_mlp_dim:mlp_dim",
    "sampler": "sampling_noise:noise_scale",
}


def grouped(saved: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a 0.1.0 ``config.json`` in today's form; others come back as they are.

    A network that no setting gives any more (a grid of latents other than 4×4, say) is named by the strict load.
    """
    if FLAT not in saved:
        return saved
    kept = {"type", *OWN, *PI05Config.__dataclass_fields__}
    new: dict[str, Any] = {name: value for name, value in saved.items() if name in kept}
    for group, names in NAMES.items():
        pairs = [name.partition(":") for name in names.split()]
        new[group] = {later or old: saved[old] for old, _, later in pairs if old in saved}
    facts = saved.get("tokenizer_config")
    new["touch"]["tokenizer"] = facts and {**facts, "hash": saved.get("tokenizer_hash", "")}
    if not saved.get("keep_inside_demos", True):
        new["action"]["target_range"] = []
    kind = saved.get("sampler", "fast")
    new["sampler"]["kind"] = "eager" if kind == "fast" and not saved.get("cuda_graphs", True) else kind
    scored = new["action"]["previous_steps"] == SCORED["action.previous_steps"]
    return new | {"recipe": "scored" if scored else "plain"}


def migrate(folder: Path) -> bool:
    """Rewrite a checkpoint's ``config.json`` in place, and its hashes; return whether anything was to do.

    Raises:
        CheckpointError: no checkpoint, or files that don't have the hashes they were saved with.
    """
    saved = read_object(folder / "config.json", CheckpointError)
    if FLAT not in saved:
        return False
    if (folder / HASHES).is_file():
        check_hashes(folder, CheckpointError)
    (folder / "config.json").write_text(json.dumps(grouped(saved), indent=4))
    write_hashes(folder)
    return True


def main(argv: Sequence[str] | None = None) -> int:
    """Migrate the folders named on the command line."""
    for folder in sys.argv[1:] if argv is None else argv:
        try:
            done = migrate(Path(folder))
        except UniForceError as error:
            sys.stderr.write(f"migration: {error}\n")
            return 2
        sys.stdout.write(f"{folder}: {'rewritten' if done else 'of today already'}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
