"""A checkpoint of version 0.1.0, whose settings stood side by side, in today's groups: ``… .migration FOLDER…``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce.recipes import GRID, SCORED
from uniforce_vtla.errors import CheckpointError, UniForceError, expected
from uniforce_vtla.json_file import read_object

CONFIG, WEIGHTS, TOKENIZER = "config.json", "model.safetensors", "model.tactile_encoder."
MOVED = {
    "touch_slots": "touch.slots",
    "touch_input": "touch.input",
    "token_site": "touch.site",
    "start_at_base": "touch.start_at_base",
    "touch_directions": "touch.directions",
    "on_sensor_loss": "touch.on_sensor_loss",
    "next_force_weight": "touch.next_force_weight",
    "trained_sensors": "touch.trained_sensors",
    "tokenizer_path": "touch.tokenizer_path",
    "action_form": "action.form",
    "action_objective": "action.objective",
    "delta_scale": "action.delta_scale",
    "delta_knee": "action.delta_knee",
    "target_range": "action.target_range",
    "last_move_steps": "action.previous_steps",
    "last_move_axes": "action.previous_axes",
    "stop_outside_demos": "action.stop_outside_demos",
    "camera_variation": "augment.camera_variation",
    "touch_noise": "augment.touch_noise",
    "touch_dropout": "augment.touch_dropout",
    "state_noise": "augment.state_noise",
    "sensor_transfer": "augment.sensor_transfer",
    "tiny_width": "tiny.width",
    "tiny_depth": "tiny.depth",
    "tiny_mlp_dim": "tiny.mlp_dim",
    "sampling_noise": "sampler.noise_scale",
}
# what 0.1.0 stored and nothing reads any more: training-only numbers, and what follows from the rest
DROPPED = (
    *("sensor_transfer_doubt", "last_move_noise", "new_module_lr", "touch_gate_lr", "force_token_scale"),
    *("tokenizer_config", "tokenizer_hash", "num_patches", "latent_size", "cuda_graphs", "keep_inside_demos"),
    *("sampler", "state_token", "hear_whole_pad", "latent_grid", "tiny_head_dim", "tiny_vision_depth"),
)


def is_flat(saved: dict[str, Any]) -> bool:
    """Return whether these settings are of the form of 0.1.0."""
    return "touch_input" in saved


def grouped(saved: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a 0.1.0 ``config.json`` in today's form; others come back as they are.

    Raises:
        CheckpointError: a network that is built no more.
    """
    if not is_flat(saved):
        return saved
    _check_built(saved)
    new: dict[str, Any] = {k: v for k, v in saved.items() if k not in MOVED and k not in DROPPED}
    for old, path in MOVED.items():
        group, _, name = path.partition(".")
        if old in saved:
            new.setdefault(group, {})[name] = saved[old]
    facts = saved.get("tokenizer_config")
    new["touch"]["tokenizer"] = facts and {**facts, "hash": saved.get("tokenizer_hash", "")}
    if not saved.get("keep_inside_demos", True):
        new["action"]["target_range"] = []
    kind = saved.get("sampler", "fast")
    new["sampler"]["kind"] = "eager" if kind == "fast" and not saved.get("cuda_graphs", True) else kind
    scored = new["action"]["previous_steps"] == SCORED["action.previous_steps"]
    return new | {"recipe": "scored" if scored else "plain"}


def _check_built(saved: dict[str, Any]) -> None:
    """Raise CheckpointError for a network whose shape no setting gives any more."""
    tiny = saved["size"] == "tiny"
    maps = tiny and saved["touch_input"] == "latent" and not saved["touch_directions"]
    wanted = {"state_token": tiny, "latent_grid": GRID}
    wanted |= {"hear_whole_pad": True} if maps else {}
    wanted |= {} if tiny or saved["touch_input"] != "latent" else {"hear_whole_pad": False}
    if tiny:
        wanted |= {"tiny_head_dim": saved["tiny_width"] // 8, "tiny_vision_depth": saved["tiny_depth"] // 2}
    differing = {name: saved[name] for name, value in wanted.items() if saved[name] != value}
    if differing:
        do = "Run it with version 0.1.0, or train it again."
        raise CheckpointError(
            expected("network of a 0.1.0 checkpoint", {n: wanted[n] for n in differing}, differing, do)
        )


def migrate(folder: Path) -> bool:
    """Rewrite a checkpoint folder in place; return whether anything was to do.

    A tactile tokenizer that comes with the package leaves the weights: its hash is in the settings.

    Raises:
        CheckpointError: no checkpoint, or a network that is built no more.
    """
    from lerobot_policy_pi05_uniforce.touch.encode import packaged_hashes

    saved = read_object(folder / CONFIG, CheckpointError)
    if not is_flat(saved):
        return False
    new = grouped(saved)
    if (new["touch"]["tokenizer"] or {}).get("hash") in packaged_hashes():
        tensors = load_file(folder / WEIGHTS)
        kept = {name: value for name, value in tensors.items() if not name.startswith(TOKENIZER)}
        save_file(kept, folder / WEIGHTS, metadata={"format": "pt"})
        (folder / WEIGHTS).chmod(0o644)
    (folder / CONFIG).write_text(json.dumps(new, indent=4))
    return True


def main(argv: Sequence[str] | None = None) -> int:
    """Migrate the folders named on the command line."""
    try:
        for folder in sys.argv[1:] if argv is None else argv:
            done = migrate(Path(folder))
            sys.stdout.write(f"{folder}: {'rewritten' if done else 'of today already'}\n")
    except UniForceError as error:
        sys.stderr.write(f"migration: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
