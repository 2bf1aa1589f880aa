"""What a checkpoint says of itself, and the text tokenizer it carries."""

from __future__ import annotations

import pytest
import torch

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, local_tokenizer
from lerobot_policy_pi05_uniforce.model_card import model_card
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import UniforceTokenizerProcessorStep
from lerobot_policy_pi05_uniforce.saved_tokenizer import SAVED
from uniforce_vtla.errors import CheckpointError, ContractError


def test_base_passes_the_gemma_terms_on_and_tiny_is_free() -> None:
    base = model_card(PI05UniforceConfig(size="base", device="cpu"))
    assert base.data.license == "gemma" and "ai.google.dev/gemma/terms" in base.text
    assert base.data.base_model == "lerobot/pi05_base"
    tiny = model_card(PI05UniforceConfig(size="tiny", device="cpu"))
    assert tiny.data.license == "apache-2.0" and "gemma/terms" not in tiny.text
    assert "Not scored" in tiny.text and "right finger" in tiny.text


def test_every_saved_policy_has_a_card(make_policy, tmp_path) -> None:
    policy = make_policy()
    policy.save_pretrained(tmp_path)
    assert policy.config.tokenizer_hash in (tmp_path / "README.md").read_text()
    assert "tactile" in policy.generate_model_card("x/y", "pi05_uniforce", None, None).data.tags


def test_scores_must_be_scores() -> None:
    with pytest.raises(ContractError, match="arms"):
        model_card(PI05UniforceConfig(size="tiny", device="cpu"), scores={"level": "easy"})


def test_a_tokenizer_of_ones_own_moves_with_the_preprocessor(tmp_path) -> None:
    local_tokenizer.build(tmp_path)
    own = UniforceTokenizerProcessorStep(tokenizer_name=str(tmp_path), max_length=16)
    assert own.get_config()["tokenizer_name"] == SAVED
    again = UniforceTokenizerProcessorStep(**own.get_config())
    with pytest.raises(CheckpointError, match="text tokenizer"):
        again._tokenize_text("wipe")
    again.load_state_dict(own.state_dict())
    assert torch.equal(*(step._tokenize_text("wipe it")["input_ids"] for step in (own, again)))
    assert again.get_config() == own.get_config() and again.state_dict().keys() == own.state_dict().keys()
    packaged = UniforceTokenizerProcessorStep(max_length=16)
    assert packaged.state_dict() == {} and packaged.get_config()["tokenizer_name"] != SAVED
