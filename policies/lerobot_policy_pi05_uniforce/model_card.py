"""The model card of a checkpoint: its touch, its data, its scores, its licence."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from uniforce_vtla.errors import ContractError, expected

CARD = "README.md"
BASE_MODEL = {"base": "lerobot/pi05_base", "tiny": None}
LICENCE_TAG = {"base": "gemma", "tiny": "apache-2.0"}
LICENCE = {
    "base": "The weights derive from π0.5, which builds on PaliGemma: they are provided under and "
    "subject to the [Gemma Terms of Use](https://ai.google.dev/gemma/terms), passed on with every "
    "copy, and so is the text tokenizer in the preprocessor. The code is Apache-2.0.",
    "tiny": "Weights and code: Apache-2.0. Nothing of Gemma is inside.",
}
TEMPLATE = Path(__file__).parent / "assets" / "model_card.md"


def model_card(
    config: PI05UniforceConfig,
    training: Mapping[str, Any] | None = None,
    scores: Mapping[str, Any] | None = None,
) -> ModelCard:
    """Return a policy's card.

    Args:
        config: settings.
        training: ``train_config.json``.
        scores: of ``uniforce score``.

    Raises ContractError: scores without arms.
    """
    datasets = config.trained_on.get("repo_id") or None
    if datasets and datasets.startswith("local/"):  # no place on the hub
        datasets = None
    data = ModelCardData(
        license=config.license or LICENCE_TAG[config.size],
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted({*(config.tags or []), "robotics", "lerobot", "tactile", config.type}),
        datasets=datasets,
        base_model=BASE_MODEL[config.size],
    )
    facts = {}
    for name in ("steps", "batch_size", "seed"):
        if training and name in training:
            facts[name] = training[name]
    return ModelCard(
        TEMPLATE.read_text().format(
            data=data.to_yaml(),
            title=(config.repo_id or config.type).split("/")[-1],
            config=config,
            touch=_touch(config),
            data_text=_lines(config.trained_on),
            training=_lines(facts),
            scores=_scores(scores),
            licence=LICENCE[config.size],
        )
    )


def _touch(config: PI05UniforceConfig) -> str:
    if not config.slots:
        return "None: it was trained without."
    touch = config.touch
    facts = {}
    for slot in config.slots:
        sensor = touch.trained_sensors.get(slot) or "a sensor not stated"
        facts[f"slot `{slot}`"] = f"{touch.slots[slot]} finger, trained on {sensor}"
    facts["input"] = touch.input
    facts["tokens per slot"] = str(config.tokens_per_slot)
    facts["tactile tokenizer"] = config.tokenizer_hash or "none"
    return _lines(facts)


def _scores(scores: Mapping[str, Any] | None) -> str:
    if scores is None:
        return "Not scored."
    if not isinstance(scores.get("arms"), Mapping):
        do = "Give the wiping.json that uniforce score wrote."
        raise ContractError(expected("scores", "a table of arms", sorted(scores), do))
    level = scores.get("level", "not stated")
    rows = [f"Simulated wiping, level `{level}`:", ""]
    rows += ["| arm | clean | success |", "|---|---|---|"]
    for name, arm in scores["arms"].items():
        rows.append("| {0} | {clean}/{n} | {success}/{n} |".format(name, **arm))
    return "\n".join(rows)


def _lines(facts: Mapping[str, object]) -> str:
    return "\n".join(f"- {name}: {value}" for name, value in facts.items()) or "Not stated."
