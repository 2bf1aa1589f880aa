"""Names of a published π0.5's tensors → names in ours."""

from __future__ import annotations

from collections.abc import Iterable

# start fresh whatever the source had
TOUCH = tuple(f"model.{name}." for name in ("force_tokens", "touch_gate", "next_force", "tactile_encoder"))
FRESH = (*TOUCH, "model.state_token.")  # no other checkpoint has them
BACKBONE = "model.paligemma_with_expert."
EMBEDDING = f"{BACKBONE}paligemma.model.language_model.embed_tokens.weight"
HEADS = (f"{BACKBONE}paligemma.lm_head.weight", f"{BACKBONE}gemma_expert.lm_head.weight")
RENAMED = {
    "model.action_time_mlp_in.": "model.time_mlp_in.",
    "model.action_time_mlp_out.": "model.time_mlp_out.",
}


def own_names(stored: Iterable[str]) -> dict[str, str]:
    """Return stored name → ours; what isn't in the result isn't wanted.

    Both language heads are left out, since nothing reads them, and so is the touch of a pi05_uniforce. Where a file
    ties the input embedding to the VLM's head and stores it only there, the embedding is taken from it. openpi's names
    of the time MLP are understood. Nothing else is forgiven: a strange name stays and makes ``weights.fill`` raise.
    """
    names = {name: name if name.startswith("model.") else f"model.{name}" for name in stored}
    left_out = (*HEADS, *TOUCH)
    ours = {name: _renamed(full) for name, full in names.items() if not full.startswith(left_out)}
    if EMBEDDING not in ours.values():
        tied = [name for name, full in names.items() if full == HEADS[0]]
        ours |= dict.fromkeys(tied, EMBEDDING)
    return ours


def _renamed(name: str) -> str:
    for old, new in RENAMED.items():
        name = name.replace(old, new)
    return name
