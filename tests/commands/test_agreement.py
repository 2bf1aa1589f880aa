from __future__ import annotations

from uniforce_vtla.commands.agreement import main
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.agreement import Agreement


def test_grasps_are_drawn_and_the_file_lies_beside_the_weights(tmp_path, capsys):
    config = TokenizerConfig(side=64, patch=8, width=16, depth=1, decoder_depth=1, heads=2, embed_hidden=0)
    tokenizer = Tokenizer.random(config)
    folder = tokenizer.save(tmp_path / "tokenizer")
    assert main([f"tokenizer={folder}", "pairs=512", "grid=1"]) == 0
    found = Agreement.load(folder, tokenizer.hash)
    assert found.directions.shape == (6, 6) and found.grid == 1
    assert (found.ratio[:-1] >= found.ratio[1:]).all()
    assert "best directions first" in capsys.readouterr().out


def test_without_a_tokenizer_it_says_so(tmp_path, capsys):
    assert main([f"tokenizer={tmp_path}"]) == 2
    assert "checkpoint" in capsys.readouterr().out
