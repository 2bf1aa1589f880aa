"""The model card of a checkpoint: its touch, its data, its scores, its licence."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from uniforce_vtla.errors import ContractError, expected

CARD = "README.md"
BASE_MODEL = "lerobot/pi05_base"
LICENCE = {
    "base": "The weights derive from π0.5, which builds on PaliGemma: they are provided under and subject to the "
    "[Gemma Terms of Use](https://ai.google.dev/gemma/terms), passed on with every copy, and so is the text tokenizer "
    "in the preprocessor. The code is Apache-2.0.",
    "tiny": "Weights and code: Apache-2.0. Nothing of Gemma is inside.",
}
TEMPLATE = Path(__file__).parent / "assets" / "model_card.md"


def model_card(
    config: PI05UniforceConfig,
    training: Mapping[str, Any] | None = None,
    scores: Mapping[str, Any] | None = None,
) -> ModelCard:
    """Return the card of a policy, trained with ``train_config.json``'s settings, scored by ``uniforce score``.

    Raises ContractError: scores without arms.
    """
    base, asked = config.size == "base", ("steps", "batch_size", "seed")
    trained_on = config.trained_on.get("repo_id") or ""
    data = ModelCardData(
        license=config.license or ("gemma" if base else "apache-2.0"),
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted({*(config.tags or []), "robotics", "lerobot", "tactile", config.type}),
        # local: no place on the hub
        datasets=None if trained_on.startswith("local/") else trained_on or None,
        base_model=BASE_MODEL if base else None,
    )
    return ModelCard(
        TEMPLATE.read_text().format(
            data=data.to_yaml(),
            title=(config.repo_id or config.type).split("/")[-1],
            config=config,
            touch=_touch(config),
            data_text=_lines(config.trained_on),
            training=_lines(
                {name: str(training[name]) for name in asked if training and name in training}
            ),
            scores=_scores(scores),
            licence=LICENCE[config.size],
        )
    )


def _touch(config: PI05UniforceConfig) -> str:
    if not config.slots:
        return "None: it was trained without."
    touch, known = config.touch, config.touch.trained_sensors
    worn = {slot: known.get(slot) or "a sensor not stated" for slot in config.slots}
    facts = {f"slot `{s}`": f"{touch.slots[s]} finger, trained on {worn[s]}" for s in config.slots}
    facts |= {
        "input": touch.input,
        "token site": touch.site,
        "tokens per slot": str(config.tokens_per_slot),
    }
    return _lines(facts | {"tactile tokenizer": config.tokenizer_hash or "none"})


def _scores(scores: Mapping[str, Any] | None) -> str:
    if scores is None:
        return "Not scored."
    if not isinstance(scores.get("arms"), Mapping):
        do = "Give the wiping.json that uniforce score wrote."
        raise ContractError(expected("scores", "a table of arms", sorted(scores), do))
    level = scores.get("level", "not stated")
    head = [f"Simulated wiping, level `{level}`:", "", "| arm | clean | success |", "|---|---|---|"]
    rows = [(name, arm["n"], arm["clean"], arm["success"]) for name, arm in scores["arms"].items()]
    return "\n".join(
        [*head, *(f"| {name} | {clean}/{n} | {done}/{n} |" for name, n, clean, done in rows)]
    )


def _lines(facts: Mapping[str, str]) -> str:
    return "\n".join(f"- {name}: {value}" for name, value in facts.items()) or "Not stated."
